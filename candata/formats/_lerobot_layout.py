"""What a LeRobot folder says of itself: its features, and where each episode lies; both layouts."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ConfigDict, Field

from candata.datasets.footer import read_chunks
from candata.errors import DataError, Where
from candata.formats._features import Feature
from candata.formats._memory import require_memory
from candata.formats._sidecar import json_of
from candata.lfs import refuse_pointer
from candata.schema.json_text import MOST_BYTES
from candata.schema.record import Record
from candata.schema.text_bounds import TextError, decode_text, read_bounded

INFO = "meta/info.json"
SIDECAR = "meta/candata.json"
#: Layouts that are read: per-episode files, and files of many episodes.
PER_EPISODE, SHARED_FILES = ("v2.0", "v2.1"), ("v3.0",)
#: Columns that every LeRobot set has.
BOOKKEEPING_COLUMNS = ("timestamp", "frame_index", "episode_index", "index", "task_index")
_NUMBERS = re.compile(r"(float|int|uint)\d+|bool")
_PLACE = re.compile(r"\{(\w+)(?::(\d{1,2})d)?\}")

Count = Annotated[int, Field(ge=0)]


class FeatureInfo(Record):
    """A feature in `meta/info.json`; what else stands there is not looked at."""

    model_config = ConfigDict(extra="ignore")

    dtype: str
    shape: tuple[Count, ...]
    names: Any = None


class Info(Record):
    """`meta/info.json`; what else stands there is not looked at."""

    model_config = ConfigDict(extra="ignore")

    codebase_version: str
    fps: Annotated[float, Field(gt=1e-6, lt=1e9)]
    features: dict[str, FeatureInfo]
    data_path: str
    chunks_size: Annotated[int, Field(gt=0)] = 1000
    total_episodes: Count
    total_frames: Count


@dataclass(frozen=True)
class Entry:
    """An episode of a set: its number, its rows, its tasks, its file."""

    index: int
    rows: int
    tasks: tuple[str, ...]
    file: Path


@dataclass(frozen=True)
class Folder:
    """A LeRobot set as its `meta` describes it.

    Attributes
    ----------
    root : Path
        Its folder.
    info : Info
        What `meta/info.json` says.
    entries : tuple of Entry
        Its episodes by number; whether each one's file is there is seen when it is read.
    """

    root: Path
    info: Info
    entries: tuple[Entry, ...]

    @property
    def features(self) -> tuple[Feature, ...]:
        """Features that hold numbers, without the bookkeeping."""
        return tuple(
            Feature(name, _width(info), _names(info))
            for name, info in self.info.features.items()
            if name not in BOOKKEEPING_COLUMNS and is_numbers(info) and _width(info)
        )


def open_folder(root: Path) -> Folder:
    """Return what a folder says of itself.

    Raises
    ------
    DataError
        When a file is missing or damaged, the version is not known, or the counts do not agree.
    UsageError
        When a field of `meta/info.json` is missing or wrong.
    """
    root = Path(root)
    info = _info(root)
    if info.codebase_version in SHARED_FILES:
        entries = tuple(_shared_entries(root, info))
    else:
        entries = tuple(_per_episode_entries(root, info))
    _check_entries(root, info, entries)
    return Folder(root, info, entries)


def is_numbers(feature: FeatureInfo) -> bool:
    """Tell whether a feature holds numbers or flags."""
    return _NUMBERS.fullmatch(feature.dtype) is not None


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    DataError
        When it is missing, no text, a Git LFS pointer, or too large.
    """
    if not path.is_file():
        raise missing_error(path)
    refuse_pointer(path)
    try:
        return decode_text(read_bounded(path, MOST_BYTES))
    except (OSError, TextError) as error:
        raise unreadable(path, error) from None


def read_table(path: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> pa.Table:
    """Return columns of a Parquet file, and those of the optional ones that it has; others are not read.

    Raises
    ------
    DataError
        When it is missing, damaged, a Git LFS pointer, lacks a column, or claims more than fits into memory.
    """
    if not path.is_file():
        raise missing_error(path)
    refuse_pointer(path)
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            known_names = file.schema_arrow.names
            missing_columns = [name for name in columns if name not in known_names]
            if not missing_columns:
                column_names = [*columns, *(name for name in optional if name in known_names)]
                require_memory(_claimed_bytes(path, column_names), path.name, Where(path=str(path)))
                return file.read(columns=column_names, use_threads=False)
    except (pa.ArrowException, OSError, ValueError, KeyError, OverflowError, MemoryError) as error:
        raise unreadable(path, error) from None
    raise DataError(
        f"the table lacks {', '.join(missing_columns)}",
        expected=", ".join(columns),
        where=Where(path=str(path)),
        fix="the folder is incomplete or was changed; get it again from its source",
    )


def _claimed_bytes(path: Path, columns: Sequence[str]) -> int:
    """Return the size of columns as float64, by what a file says of itself; packed they may take next to nothing."""
    starts = tuple(f"{name}." for name in columns)
    chunks = (chunk for group in read_chunks(path) for chunk in group)
    return 8 * sum(max(chunk.values, 0) for chunk in chunks if f"{chunk.column}.".startswith(starts))


def missing_error(path: Path) -> DataError:
    """Return the error of a file that is not there."""
    return DataError(
        f"{path.name} is missing",
        expected="a LeRobot folder with meta/ and data/",
        where=Where(path=str(path)),
        fix="give the folder that holds meta/info.json, with all files that it names",
    )


def unreadable(path: Path, error: Exception) -> DataError:
    """Return the error of a file that cannot be read."""
    message = (str(error).splitlines() or [""])[0] or type(error).__name__
    return DataError(
        f"{path.name} cannot be read",
        found=message[:200],
        where=Where(path=str(path)),
        fix="the file is damaged or incomplete; get it again from its source",
    )


def _info(root: Path) -> Info:
    """Return `meta/info.json`, its version known."""
    path = root / INFO
    value = json_of(read_text(path), path)
    version = value.get("codebase_version") if isinstance(value, dict) else None
    if version not in PER_EPISODE + SHARED_FILES:
        raise DataError(
            "unknown LeRobot codebase_version",
            expected=f"one of {', '.join(PER_EPISODE + SHARED_FILES)}",
            found=repr(version)[:80],
            where=Where(path=str(path)),
            fix="convert it with lerobot's own scripts, or read it with a newer candata",
        )
    return Info.parse(value, path)


def _per_episode_entries(root: Path, info: Info) -> Iterator[Entry]:
    """Yield the episodes of the layout with a file each."""
    path = root / "meta" / "episodes.jsonl"
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip():
            continue
        place = f"{path}, line {number}"
        index, rows, tasks = _fields(json_of(line, place), place)
        places = {"episode_chunk": index // info.chunks_size, "episode_index": index}
        yield Entry(index, rows, tasks, _file(root, info.data_path, places))


def _shared_entries(root: Path, info: Info) -> Iterator[Entry]:
    """Yield the episodes of the layout with files of many episodes."""
    tables = sorted((root / "meta" / "episodes").glob("*/*.parquet"))
    if not tables and info.total_episodes:
        raise missing_error(root / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    columns = ("episode_index", "length", "data/chunk_index", "data/file_index")
    for path in tables:
        for number, value in enumerate(read_table(path, columns, optional=("tasks",)).to_pylist()):
            index, rows, tasks = _fields(value, f"{path}, row {number}")
            places = {"chunk_index": value["data/chunk_index"], "file_index": value["data/file_index"]}
            if not all(isinstance(n, int) and n >= 0 for n in places.values()):
                raise _inconsistent_error(f"episode {index} has no file", path, found=repr(places))
            yield Entry(index, rows, tasks, _file(root, info.data_path, places))


def _fields(value: Any, place: str) -> tuple[int, int, tuple[str, ...]]:
    """Return number, rows and tasks of an episode's record; a set may name no tasks."""
    record = value if isinstance(value, dict) else {}
    index, rows, tasks = record.get("episode_index"), record.get("length"), record.get("tasks") or ()
    is_whole = [isinstance(n, int) and not isinstance(n, bool) and 0 <= n < 2**40 for n in (index, rows)]
    if not all(is_whole) or not isinstance(tasks, list | tuple) or not all(isinstance(t, str) for t in tasks):
        raise _inconsistent_error(
            "a record of an episode is not valid",
            place,
            "episode_index and length as whole numbers, tasks as a list of texts, if any",
            repr(value)[:200],
        )
    return int(record["episode_index"]), int(record["length"]), tuple(tasks)


def _file(root: Path, template: str, places: dict[str, int]) -> Path:
    """Return the file that a path template names; it lies inside the folder."""
    location = Where(path=str(root / INFO))

    def substitute(match: re.Match[str]) -> str:
        name, width = match.groups()
        if name not in places:
            raise DataError("data_path has an unknown place", expected=", ".join(places), found=name, where=location)
        return f"{places[name]:0{int(width or 0)}d}"

    relative = Path(_PLACE.sub(substitute, template))
    if relative.is_absolute() or ".." in relative.parts or "\0" in template or relative.suffix != ".parquet":
        raise DataError(
            "data_path does not name a Parquet file inside the folder", found=repr(template)[:200], where=location
        )
    return root / relative


def _check_entries(root: Path, info: Info, entries: Sequence[Entry]) -> None:
    """Raise unless the episodes are numbered 0, 1, ..., add up, and any of their files is there."""
    if [entry.index for entry in entries] != list(range(len(entries))):
        raise _inconsistent_error(
            "the episodes are not numbered 0, 1, 2, ...", root / "meta", found=_odd_number(entries)
        )
    if not entries:
        raise DataError("the set holds no episode", where=Where(path=str(root)))
    for field, claimed_count, actual_count in (
        ("total_episodes", info.total_episodes, len(entries)),
        ("total_frames", info.total_frames, sum(entry.rows for entry in entries)),
    ):
        if claimed_count != actual_count:
            raise _inconsistent_error(
                f"{field} does not agree with the list of episodes",
                root / INFO,
                f"{actual_count} as listed",
                str(claimed_count),
            )
    if not any(os.path.isfile(file) for file in {entry.file for entry in entries}):  # also where the name is too long
        raise missing_error(entries[0].file)


def _odd_number(entries: Sequence[Entry]) -> str:
    """Return the first number that is out of order."""
    return next(f"{entry.index} as number {k}" for k, entry in enumerate(entries) if entry.index != k)


def _inconsistent_error(
    problem: str, path: Path | str, expected: str | None = None, found: str | None = None
) -> DataError:
    """Return the error of a `meta` that contradicts itself."""
    return DataError(
        problem,
        expected=expected,
        found=found,
        where=Where(path=str(path)),
        fix="the set was not closed or was edited; get it again from its source",
    )


def _width(feature: FeatureInfo) -> int:
    """Return the number of columns of a feature."""
    total = 1
    for size in feature.shape:
        total *= size
    return total


def _names(feature: FeatureInfo) -> tuple[str, ...]:
    """Return the names of the columns where there is one each: a list, a list in a list, or a mapping."""
    names = tuple(_flatten_names(feature.names))
    return names if len(names) == _width(feature) and len(set(names)) == len(names) else ()


def _flatten_names(value: Any, depth: int = 3) -> Iterator[str]:
    """Yield the texts in nested lists; of a mapping to numbers its keys in their order, else its values."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict) and value and all(isinstance(n, int) for n in value.values()):
        yield from sorted(value, key=value.__getitem__)
    elif isinstance(value, dict | list) and depth:
        for part in value.values() if isinstance(value, dict) else value:
            yield from _flatten_names(part, depth - 1)
