"""A Diffusion Policy buffer on disk: a zarr group of format 2 or 3, in a folder or a zip file; arrays open by name."""

from __future__ import annotations

import lzma
import math
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.storage import ZipStore

from candata.errors import DataError, Where
from candata.formats._memory import require_memory
from candata.formats._sidecar import json_of
from candata.lfs import refuse_pointer
from candata.schema.json_text import MOST_BYTES
from candata.schema.text_bounds import read_start

#: The file that makes a folder a group, and the one that makes it an array, by the format of zarr.
_GROUPS: dict[Literal[2, 3], str] = {2: ".zgroup", 3: "zarr.json"}
_ARRAYS: dict[Literal[2, 3], str] = {2: ".zarray", 3: "zarr.json"}
#: What compression can gain at most; an array that claims more is damaged. Source: deflate, at most 1032 to 1.
_LARGEST_GAIN = 1100
_SLACK_BYTES = 1 << 20
#: Rows are read in blocks of whole chunks of about this size: a call of zarr costs a millisecond, memory is short.
_BLOCK_BYTES = 1 << 24
#: What reading a member of a damaged zip file raises: its name, its place, its kind of compression, its contents.
_ZIP_ERRORS = (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, lzma.LZMAError)

Tree = Path | zipfile.Path


@dataclass(frozen=True, eq=False)
class Buffer:
    """A buffer that was found; nothing of its arrays is read yet.

    Attributes
    ----------
    path : Path
        Its folder or zip file.
    root : Path or zipfile.Path
        Where its group begins; in a zip file that may be a folder inside.
    version : int
        Format of zarr, 2 or 3.
    """

    path: Path
    root: Tree
    version: Literal[2, 3]

    @property
    def where(self) -> Where:
        """Place for messages."""
        return Where(path=str(self.path))

    @property
    def stem(self) -> str:
        """Name of the buffer, without the endings of a zarr store."""
        return self.path.name.removesuffix(".zip").removesuffix(".zarr")


def find_buffer(source: Path) -> Buffer:
    """Return the zarr group in a folder, a zip file, or a folder that holds one of these.

    Raises
    ------
    DataError
        When there is none or more than one, or it cannot be opened.
    """
    source = Path(source)
    refuse_pointer(source)
    if source.is_file():
        return _zip_buffer(source)
    version = _version(source) if source.is_dir() else None
    if version is not None:
        return Buffer(source, source, version)
    candidates = sorted(p for p in source.iterdir() if _looks_like_zarr(p)) if source.is_dir() else []
    if len(candidates) != 1:
        raise DataError(
            "there is no Diffusion Policy buffer",
            expected="a zarr group with data/ and meta/, its .zarr.zip, or a folder that holds one of these",
            found=", ".join(p.name for p in candidates) or "no .zgroup and no zarr.json",
            where=Where(path=str(source)),
            fix="give the buffer itself",
        )
    return find_buffer(candidates[0])


def attributes(buffer: Buffer) -> dict[str, Any]:
    """Return the attributes of the buffer's group.

    Raises
    ------
    DataError
        When they cannot be read.
    """
    place = buffer.root / (".zattrs" if buffer.version == 2 else _GROUPS[3])
    if not place.is_file():
        return {}
    if isinstance(place, Path):
        refuse_pointer(place)
    try:
        with place.open("rb") as file:
            data = read_start(file, MOST_BYTES + 1)
    except _ZIP_ERRORS as error:
        raise _unreadable(buffer, place.name, error) from None
    record = json_of(data, place)  # more bytes than that are refused
    values = record if buffer.version == 2 or not isinstance(record, dict) else record.get("attributes", {})
    return values if isinstance(values, dict) else {}


def array_names(buffer: Buffer) -> tuple[str, ...]:
    """Return the names of the arrays in `data`; none of them is opened.

    Raises
    ------
    DataError
        When there is no `data`, or it holds what is neither a file nor a folder.
    """
    data = buffer.root / "data"
    if not data.is_dir():
        raise DataError("the buffer lacks data/", expected="data/ and meta/", where=buffer.where)
    entries: list[Tree] = list(data.iterdir())  # type: ignore[arg-type]
    _require_files(entries)
    return tuple(sorted(entry.name for entry in entries if (entry / _ARRAYS[buffer.version]).is_file()))


def open_array(buffer: Buffer, key: str) -> Any:
    """Return an array of numbers by its path in the buffer, `data/NAME`; its values are not read yet.

    Raises
    ------
    DataError
        When it is damaged, holds no numbers, needs a codec that is not there, or claims more than there is.
    """
    place = buffer.root / key
    if isinstance(place, Path):
        _require_files(place.rglob("*"))
    try:
        store: Any = str(buffer.root) if isinstance(buffer.root, Path) else ZipStore(buffer.path, mode="r")
        store_path = key if isinstance(buffer.root, Path) else f"{buffer.root.at}{key}"
        array: Any = zarr.open_array(store, path=store_path, mode="r", zarr_format=buffer.version)
    except Exception as error:  # zarr and its codecs raise nearly everything, by where the damage lies
        raise _unreadable(buffer, key, error) from None
    if not array.ndim or np.dtype(array.dtype).kind not in "fiub":
        raise DataError(
            f"{key} does not hold rows of numbers",
            expected="numbers or flags, a row a step",
            found=f"shape {array.shape} of {array.dtype}",
            where=buffer.where,
        )
    if array.nbytes > _SLACK_BYTES and all(array.nbytes > _LARGEST_GAIN * size for size in _sizes(buffer, key)):
        raise DataError(
            "an array claims more than the buffer can hold",
            expected=f"at most {_LARGEST_GAIN} times the bytes of the buffer",
            found=f"{key} of {array.nbytes / 1e9:,.4g} GB",
            where=buffer.where,
            fix="the buffer is damaged or incomplete; get it again from its source",
        )
    require_memory(math.prod(array.chunks) * array.dtype.itemsize, f"a chunk of {key}", buffer.where)
    return array


def width(array: Any) -> int:
    """Return the numbers in a row of an array."""
    return math.prod(array.shape[1:])


def episode_rows(buffer: Buffer, key: str, array: Any, ends: Sequence[int]) -> Iterator[NDArray]:
    """Yield the rows of each episode as `(T, width)`; no chunk is decoded twice, and little is held beside them.

    Raises
    ------
    DataError
        When a chunk is damaged, or an episode does not fit into memory.
    """
    row_bytes = max(width(array) * array.dtype.itemsize, 1)
    step = max(array.chunks[0], _BLOCK_BYTES // row_bytes // array.chunks[0] * array.chunks[0])
    pending_rows, first_row = np.empty((0, *array.shape[1:]), array.dtype), 0
    for start, end in zip([0, *ends], ends, strict=False):
        require_memory((end - start) * width(array) * 8, f"an episode of {key}", buffer.where)
        parts, next_row = [pending_rows[start - first_row :]], first_row + len(pending_rows)
        while next_row < end:
            parts.append(read_rows(buffer, key, array, next_row, min(next_row + step, array.shape[0])))
            next_row += len(parts[-1])
        pending_rows, first_row = np.concatenate(parts) if len(parts) > 1 else parts[0], start
        yield pending_rows[: end - start].reshape(end - start, -1)


def read_rows(buffer: Buffer, key: str, array: Any, start: int, stop: int) -> NDArray:
    """Return rows of an array in its own shape.

    Raises
    ------
    DataError
        When a chunk is damaged.
    """
    try:
        return np.asarray(array[start:stop])
    except Exception as error:  # codecs raise nearly everything
        raise _unreadable(buffer, key, error) from None


def _looks_like_zarr(path: Path) -> bool:
    """Tell whether a path in the folder that was given can be the buffer."""
    return path.name.endswith(".zip") if path.is_file() else path.is_dir() and _version(path) is not None


def _version(root: Tree) -> Literal[2, 3] | None:
    """Return the format of zarr of a group, None where a folder is none."""
    return next((version for version, name in _GROUPS.items() if (root / name).is_file()), None)


def _zip_buffer(path: Path) -> Buffer:
    """Return the buffer in a zip file: at its top, or in its one folder."""
    try:
        top = zipfile.Path(path)
        places = [top, *(p for p in top.iterdir() if p.is_dir())]
        versions = [(place, version) for place in places if (version := _version(place)) is not None]
    except _ZIP_ERRORS as error:
        raise DataError(
            "there is no Diffusion Policy buffer",
            expected="a zarr group, or a zip file of one",
            found=getattr(error, "strerror", None) or str(error),
            where=Where(path=str(path)),
            fix="give the folder or the .zarr.zip of the buffer; a zip file that was cut must be got again",
        ) from None
    if not versions:
        raise DataError(
            "there is no Diffusion Policy buffer",
            expected="a zip file of a zarr group with data/ and meta/",
            found="no .zgroup and no zarr.json",
            where=Where(path=str(path)),
        )
    return Buffer(path, *versions[0])


def _require_files(entries: Iterable[Tree]) -> None:
    """Refuse pointers of Git LFS, files larger than the memory, and what is no file: a pipe may never end."""
    for entry in entries:
        if not (entry.is_file() or entry.is_dir()):
            raise DataError("the buffer holds what is no file", found=entry.name, where=Where(path=str(entry)))
        if isinstance(entry, Path) and entry.is_file():
            refuse_pointer(entry)
            require_memory(entry.stat().st_size, entry.name, Where(path=str(entry)))


def _sizes(buffer: Buffer, key: str) -> Iterator[int]:
    """Yield the bytes that are there for an array: its own, then, as what is 0 takes none, those of the buffer."""
    if isinstance(buffer.root, Path):
        for place in (buffer.root / key, buffer.root):
            yield sum(p.stat().st_size for p in place.rglob("*") if p.is_file())
    else:
        yield buffer.path.stat().st_size


def _unreadable(buffer: Buffer, key: str, error: Exception) -> DataError:
    """Return the error of an array that cannot be read."""
    text = (str(error).splitlines() or [""])[0]
    no_codec = type(error).__name__ == "UnknownCodecError"  # numcodecs and zarr each have one
    return DataError(
        f"{key} of the buffer cannot be read",
        expected=f"an array of zarr format {buffer.version}",
        found=text[:200] or type(error).__name__,
        where=buffer.where,
        fix="leave the array out of the map, or write it again with a codec that zarr brings"
        if no_codec
        else "the buffer is damaged or incomplete; get it again from its source",
    )
