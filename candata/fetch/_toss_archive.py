"""Tosses in an archive of DAIRLab/dair_pll: a folder of torch files, one toss each, and the licence beside it."""

from __future__ import annotations

import hashlib
import io
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.fetch._files import download, git_tree_hash

#: sha256 of the repository's licence file.
LICENCE_SHA256 = "ed2d040c164ceff95257da3b9c4e2a7134c93310488947871b95e8ac90f91b52"
RATE_HZ = 148.0


def checked_tosses(archive: Path, folder: str, tree: str, licence_sha256: str) -> tuple[dict[str, bytes], str]:
    """Return the files of a folder of the archive, by toss, and the licence's text; both checked.

    Raises
    ------
    DataError
        When the archive is damaged, lacks the licence, or holds other data.
    """
    location = Where(path=str(archive))
    tosses, licence = _members(archive, folder)
    tree_hash = git_tree_hash(tosses)
    if tree_hash != tree:
        raise DataError(
            f"{folder} is not the published folder",
            expected=f"git tree {tree}",
            found=f"git tree {tree_hash}, {len(tosses)} files",
            where=location,
            fix="delete the file and fetch again",
        )
    if hashlib.sha256(licence).hexdigest() != licence_sha256:
        raise DataError("the licence file is missing or another one", expected="LICENSE", where=location)
    return {name.removesuffix(".pt"): content for name, content in tosses.items()}, licence.decode()


def archive_of(cache: Path, revision: str, say: Callable[[str], None], url: str) -> Path:
    """Return the archive of a revision, downloaded unless it is in the cache.

    Raises
    ------
    SetupError
        When the repository cannot be reached.
    """
    archive = Path(cache) / f"dair_pll-{revision[:12]}.tar.gz"
    if archive.is_file():
        say(f"using {archive}")
    else:
        download(url, archive, say)
    return archive


def columns_of(tosses: Mapping[str, bytes], names: Sequence[str]) -> dict[str, NDArray]:
    """Return the columns of the original files, one toss a file, in the order of their numbers.

    A file is a torch archive of one contiguous `(T, C) float64` tensor whose first four numbers are the orientation;
    its bytes are read as they are, so neither torch nor a pickle is needed. Orientations start with w >= 0 and keep
    the recorded continuity.

    Raises
    ------
    DataError
        When a file is no such archive.
    """
    frames = [(int(name), _frames(name, tosses[name], len(names))) for name in sorted(tosses, key=int)]
    columns = {name: np.concatenate([f[:, k] for _, f in frames]) for k, name in enumerate(names)}
    columns["episode"] = np.concatenate([np.full(len(f), number) for number, f in frames])
    columns["t"] = np.concatenate([np.arange(len(f)) / RATE_HZ for _, f in frames])
    return columns


def _frames(name: str, content: bytes, width: int) -> NDArray[np.float64]:
    """Return `(T, C) float64`: the frames of one toss."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            frames = np.frombuffer(archive.read("archive/data/0"), "<f8").reshape(-1, width).copy()
    except (zipfile.BadZipFile, KeyError, ValueError, zlib.error) as error:
        raise DataError("a toss cannot be read", found=str(error), where=Where(episode=name)) from None
    if frames[0, 0] < 0:
        frames[:, :4] *= -1
    return frames


def _members(archive: Path, folder: str) -> tuple[dict[str, bytes], bytes]:
    """Return the files of the data folder and the licence; nothing is unpacked to the disk."""
    tosses, licence = {}, b""
    try:
        with tarfile.open(archive, "r:gz") as tar:
            for member in tar:
                path = member.name.partition("/")[2]
                if member.isfile() and path.rpartition("/")[0] == folder:
                    tosses[path.rpartition("/")[2]] = tar.extractfile(member).read()  # type: ignore[union-attr]
                elif member.isfile() and path == "LICENSE":
                    licence = tar.extractfile(member).read()  # type: ignore[union-attr]
    except (tarfile.TarError, EOFError, OSError, zlib.error) as error:
        raise DataError(
            "the archive cannot be read",
            found=str(error),
            where=Where(path=str(archive)),
            fix="delete the file and fetch again",
        ) from None
    return tosses, licence
