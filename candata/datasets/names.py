"""Names that may become files: strict, so that no name of someone else's leads out of a folder."""

from __future__ import annotations

import re
from collections.abc import Iterable

from candata.errors import DataError, UsageError, Where

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
_SEGMENT = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_PART = re.compile(r"[0-9a-f]{32}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_DEPTH = 8

#: Names that are devices on Windows, whatever their suffix.
#: Source: learn.microsoft.com, "Naming Files, Paths, and Namespaces".
_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}


def is_name(text: str) -> bool:
    """Return whether `text` may name a dataset, a remote, a tag or a split."""
    return bool(_NAME.fullmatch(text)) and _is_file_name(text)


def require_name(kind: str, text: str) -> str:
    """Return `text`, which may name a thing of this kind.

    Raises
    ------
    UsageError
        When it may not.
    """
    if not is_name(text):
        raise UsageError(
            f"not a name for a {kind}", expected="letters, digits, - _ . (100 at most)", found=repr(text)[:200]
        )
    return text


def require_hash(kind: str, text: str, location: str) -> str:
    """Return `text`, which is a sha256 in hex.

    Raises
    ------
    DataError
        When it is not.
    """
    return _require(_SHA256, f"the sha256 of {kind}", text, location)


def require_part(text: str, location: str) -> str:
    """Return `text`, which is the id of a part.

    Raises
    ------
    DataError
        When it is not.
    """
    return _require(_PART, "the id of a part", text, location)


def _require(pattern: re.Pattern[str], kind: str, text: str, location: str) -> str:
    """Return `text`, which matches."""
    if not pattern.fullmatch(text):
        raise DataError(
            f"not {kind}", expected="hexadecimal digits", found=repr(text)[:200], where=Where(path=location)
        )
    return text


def require_files(paths: Iterable[str], location: str) -> None:
    """Return nothing; the relative paths are plain, different in more than case, and no file is a folder too.

    Raises
    ------
    DataError
        When one is absolute, has `..`, backslashes, odd characters or a device's name, or two collide.
    """
    lower_names: set[str] = set()
    folders: set[str] = set()
    for path in paths:
        segments = path.split("/")
        is_plain = len(segments) <= _DEPTH and all(_SEGMENT.fullmatch(s) and _is_file_name(s) for s in segments)
        lower = path.lower()
        if not is_plain or lower in lower_names:
            raise DataError(
                "a file of the dataset has a name that cannot be kept" if not is_plain else "two files have one name",
                expected="plain relative names, different in more than case",
                found=repr(path)[:200],
                where=Where(path=location),
                fix="do not trust this copy; ask who made it",
            )
        lower_names.add(lower)
        folders.update("/".join(lower.split("/")[:depth]) for depth in range(1, len(segments)))
    for path in lower_names & folders:
        raise DataError("a file of the dataset is a folder too", found=repr(path)[:200], where=Where(path=location))


def _is_file_name(segment: str) -> bool:
    """Return whether a segment is a file's name on every system."""
    return not segment.endswith(".") and segment.split(".")[0].lower() not in _DEVICES
