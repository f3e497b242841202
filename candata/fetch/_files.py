"""Checked files: sha256 of a file, the hash git gives a folder, a download that ends whole or not at all."""

from __future__ import annotations

import hashlib
import http.client
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path

from candata.datasets.writing import replacing
from candata.errors import DataError, SetupError, Where

_CHUNK_BYTES = 1 << 16
_SAY_EVERY_BYTES = 1 << 20


def require_sha256(path: Path, sha256: str, fix: str) -> None:
    """Raise unless the file is there and has this sha256.

    Raises
    ------
    DataError
        When it is missing, unreadable or another file; `fix` says what to do.
    """
    location = Where(path=str(path))
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(f"{path.name} is missing", found=error.strerror, where=location, fix=fix) from None
    if digest != sha256:
        raise DataError(
            f"{path.name} is not the published file",
            expected=f"sha256 {sha256}",
            found=f"sha256 {digest}",
            where=location,
            fix=fix,
        )


def git_tree_hash(files: Mapping[str, bytes]) -> str:
    r"""Return the name git gives a flat folder of plain files: one hash over all names and contents.

    Source: git-scm.com/book, "Git Internals - Git Objects": sha1 over `tree <size>\0` and an entry
    `100644 <name>\0<sha1 of the blob>` a file, sorted by name.
    """
    entries = b"".join(
        b"100644 " + name.encode() + b"\0" + _git_object(b"blob", files[name]).digest()
        for name in sorted(files, key=str.encode)
    )
    return _git_object(b"tree", entries).hexdigest()


def _git_object(kind: bytes, content: bytes) -> hashlib._Hash:
    """Return the sha1 of a git object."""
    return hashlib.sha1(kind + b" %d\0" % len(content) + content, usedforsecurity=False)


def download(url: str, target: Path, say: Callable[[str], None], timeout_s: float = 30.0) -> Path:
    """Return `target`, downloaded from `url`; a file appears under that name only when it is whole.

    Parameters
    ----------
    url : str
        Address.
    target : Path
        File to write; its folder is made.
    say : callable
        Takes a line about the progress.
    timeout_s : float
        Longest silence of the server.

    Raises
    ------
    SetupError
        When the address cannot be reached or the connection breaks.
    """
    say(f"downloading {url}")
    with replacing(target, "download") as draft:
        try:
            with urllib.request.urlopen(url, timeout=timeout_s) as answer, draft.open("wb") as file:
                _copy(answer, file, say)
        except (OSError, http.client.HTTPException) as error:
            raise SetupError(
                "the download failed",
                expected=f"an answer from {url}",
                found=str(error) or type(error).__name__,
                fix="connect to the network and run it again, or read a prepared copy: --from FOLDER",
            ) from None
    return target


def _copy(answer, file, say: Callable[[str], None]) -> None:  # type: ignore[no-untyped-def]
    """Copy an answer to a file, with a line every MiB."""
    byte_count = 0
    while chunk := answer.read(_CHUNK_BYTES):
        file.write(chunk)
        if (byte_count + len(chunk)) // _SAY_EVERY_BYTES > byte_count // _SAY_EVERY_BYTES:
            say(f"  {(byte_count + len(chunk)) / 1e6:.1f} MB")
        byte_count += len(chunk)
    content_length = answer.headers.get("Content-Length")
    if content_length is not None and byte_count < int(content_length):
        raise http.client.IncompleteRead(b"", int(content_length) - byte_count)
