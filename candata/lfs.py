"""Git LFS pointers: the short texts that a clone made without git-lfs holds in place of files."""

from __future__ import annotations

import re
from pathlib import Path

from candata.errors import DataError, Where

#: How a pointer begins. Source: git-lfs, docs/spec.md; hawser was its name before the first release.
_BEGINNINGS = (b"version https://git-lfs.github.com/spec/", b"version https://hawser.github.com/spec/")
#: Pointers are shorter than this [bytes]. Source: git-lfs, docs/spec.md.
_LARGEST_BYTES = 1024


def refuse_pointer(path: Path) -> None:
    """Raise if a file is a Git LFS pointer; a path without a file passes, as its reader says what is wrong.

    Raises
    ------
    DataError
        Says what the file is, and how to get the one that it stands for.
    """
    error = pointer_error(path)
    if error is not None:
        raise error


def pointer_error(path: Path) -> DataError | None:
    """Return the error of a file that is a Git LFS pointer, None where it is anything else or cannot be read."""
    try:
        if not path.is_file() or path.stat().st_size >= _LARGEST_BYTES:
            return None
        text = path.read_bytes()
    except (OSError, ValueError):
        return None
    if not text.startswith(_BEGINNINGS):
        return None
    size = re.search(rb"^size (\d{1,18})\s*$", text, re.MULTILINE)
    return DataError(
        f"{path.name} is a Git LFS pointer, which stands in place of the file",
        expected=f"the file itself, of {int(size.group(1)):,} bytes" if size else "the file itself",
        found=f"{len(text)} bytes that name it",
        where=Where(path=str(path)),
        fix="run `git lfs pull` in that clone, or download the file itself",
    )
