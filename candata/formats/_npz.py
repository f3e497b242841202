"""Checks of an npz file before numpy reads it: its arrays hold numbers or texts, and fit into memory."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from candata.errors import DataError, Where
from candata.formats._memory import require_memory


def require_arrays(path: Path, array_names: Iterable[str]) -> None:
    """Raise unless a file is an npz whose wanted arrays can be read without unpickling; others are not looked at.

    Raises
    ------
    DataError
        When the file is no npz, a wanted array holds Python objects, or claims more than fits into memory.
    """
    if not zipfile.is_zipfile(path):
        with path.open("rb") as file:
            start = file.read(8)
        raise _unreadable(path, _kind(start), "save it with numpy.savez, a name an array; a cut file must be got again")
    with zipfile.ZipFile(path) as archive:
        members = archive.namelist()
        for name in array_names:
            member = name if name in members else f"{name}.npy"
            if member in members:
                _require_array(archive, member, name, path)


def _require_array(archive: zipfile.ZipFile, member: str, name: str, path: Path) -> None:
    """Refuse an array of Python objects, or one that is larger than the memory, by its header alone."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(
            version
        )
        if read_header is None:
            return
        shape, _, dtype = read_header(file)
    if dtype.hasobject:
        raise _unreadable(
            path,
            f"Python objects in the array {name}, which are not unpickled: they could run anything",
            "save numbers or texts: give numpy.savez arrays whose dtype is not object",
        )
    require_memory(math.prod(shape) * dtype.itemsize, f"the array {name}", Where(path=str(path)))


def _kind(start: bytes) -> str:
    """Return what a file that is no zip file is, by its first bytes."""
    if start.startswith(np.lib.format.MAGIC_PREFIX):
        return "one array without a name"
    if start.startswith(b"PK"):
        return "a zip file without its end: it was cut"
    return f"a file that begins {start!r}" if start else "no bytes"


def _unreadable(path: Path, found: str, fix: str) -> DataError:
    """Return the error of a file that is no npz of numbers and texts."""
    return DataError(
        "the table cannot be read", expected="a npz file", found=found, where=Where(path=str(path)), fix=fix
    )
