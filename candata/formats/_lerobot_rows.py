"""The rows of a LeRobot set: each episode's features as arrays, from the file that its index names or that holds it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.formats._lerobot_layout import Entry, Folder, missing_error, read_table

#: Columns that are read of every set beside the features that are asked for.
STAMP, FRAME, EPISODE = "timestamp", "frame_index", "episode_index"

#: How many rows each file holds of each episode.
Holders = Mapping[int, Mapping[Path, int]]


def episode_arrays(
    folder: Folder, names: Sequence[str], note: Callable[[str], None]
) -> Iterator[tuple[Entry, dict[str, NDArray]]]:
    """Yield each episode with its features as `(T, width)`, and its stamps and frames `(T,)`; a file is read once.

    An episode whose rows are not in the file that the index names is taken from the one file that holds them, and that
    is noted.

    Raises
    ------
    DataError
        When a file is damaged or lacks a column, rows are missing, or a cell holds what does not fit.
    """
    columns = tuple(dict.fromkeys([*names, STAMP, FRAME, EPISODE]))
    widths = {feature.name: feature.width for feature in folder.features}
    holders: Holders | None = None
    open_file: _OpenFile | None = None
    for entry in folder.entries:
        file = _file_of(entry, holders)
        if open_file is None or open_file.file != file:
            open_file = _read(file, columns)
        if holders is None and not (open_file.episode_of_row == entry.index).any():
            holders = _holders(folder)
            file = _file_of(entry, holders)
            open_file = open_file if open_file.file == file else _read(file, columns)
        if file != entry.file:
            note(f"episode {entry.index}: the index names {entry.file.name}, its rows are in {file.name}: taken there")
        rows = np.flatnonzero(open_file.episode_of_row == entry.index)
        _check_rows(entry, rows, holders)
        part, first_row = open_file.table.slice(int(rows[0]), len(rows)), int(rows[0])
        arrays = {name: _column(part, name, widths[name], file, first_row) for name in names}
        yield entry, arrays | {name: _column(part, name, 1, file, first_row)[:, 0] for name in (STAMP, FRAME)}


@dataclass(frozen=True, eq=False)
class _OpenFile:
    """A file at hand: its columns, and whose its rows are; of one that is not there, no row."""

    file: Path
    table: pa.Table
    episode_of_row: NDArray


def _read(file: Path, columns: Sequence[str]) -> _OpenFile:
    """Return the columns of a file."""
    if not os.path.isfile(file):  # unlike Path.is_file, also where the name is too long
        return _OpenFile(file, pa.table({}), np.zeros(0))
    table = read_table(file, columns)
    return _OpenFile(file, table, _whole_numbers(table, EPISODE, file))


def _file_of(entry: Entry, holders: Holders | None) -> Path:
    """Return the file to take an episode from: the one named, unless it lacks all rows and one other has them all."""
    counts = {} if holders is None else holders.get(entry.index, {})
    is_elsewhere = len(counts) == 1 and entry.file not in counts and entry.rows in counts.values()
    return next(iter(counts)) if is_elsewhere else entry.file


def _holders(folder: Folder) -> Holders:
    """Return which file of a set holds how many rows of which episode, whatever the index says."""
    counts: dict[int, dict[Path, int]] = {}
    for path in sorted(folder.root.rglob("*.parquet")):
        if path.relative_to(folder.root).parts[0] == "meta":
            continue
        table = read_table(path, (), optional=(EPISODE,))
        if EPISODE in table.column_names:
            for index, count in zip(*np.unique(_whole_numbers(table, EPISODE, path), return_counts=True), strict=True):
                counts.setdefault(int(index), {})[path] = int(count)
    return counts


def _check_rows(entry: Entry, rows: NDArray, holders: Holders | None) -> None:
    """Raise unless the rows of an episode are as many as it claims, one after the other."""
    location = Where(path=str(entry.file), episode=str(entry.index))
    if len(rows) != entry.rows or not len(rows):
        if not os.path.isfile(entry.file):
            raise missing_error(entry.file)
        other_files = {} if holders is None else holders.get(entry.index, {})
        files_text = ", ".join(f"{count} in {path.parent.name}/{path.name}" for path, count in other_files.items())
        raise DataError(
            "the file does not hold the episode's rows",
            expected=f"{entry.rows} rows",
            found=f"{len(rows)} rows" + (f"; {files_text}" if files_text else ""),
            where=location,
            fix="correct the file numbers in meta/episodes, or get the set again from its source"
            if files_text
            else "the set was not closed or was edited; get it again from its source",
        )
    if rows[-1] - rows[0] != len(rows) - 1:
        raise DataError(
            "the rows of an episode do not follow each other", found="rows of another between", where=location
        )


def _whole_numbers(table: pa.Table, name: str, path: Path) -> NDArray:
    """Return a column of whole numbers `(T,)`; they may be kept as floats."""
    values = _column(table, name, 1, path, 0)[:, 0]
    odd_rows = np.flatnonzero(~(np.isfinite(values) & (values == np.rint(values))))
    if len(odd_rows):
        raise DataError(
            f"column {name} holds what is no whole number",
            expected="0, 1, 2, ...",
            found=f"{values[odd_rows[0]]} ({len(odd_rows)} such rows)",
            where=Where(path=str(path), channel=name, index=int(odd_rows[0])),
            fix="correct the column; it says which episode a row belongs to",
        )
    return values


def _column(table: pa.Table, name: str, width: int, path: Path, first_row: int) -> NDArray:
    """Return a column as `(T, width)`: numbers, lists, or lists of lists; a missing value is NaN.

    `first_row` is the row of the file at which the table begins, for messages.
    """
    values: pa.Array = table[name].combine_chunks()
    if isinstance(values, pa.ExtensionArray):
        values = values.storage
    lists: list[pa.Array] = []
    while (
        pa.types.is_list(values.type) or pa.types.is_large_list(values.type) or pa.types.is_fixed_size_list(values.type)
    ):
        lists.append(values)
        values = values.flatten()
    kind = values.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        location = Where(path=str(path), channel=name)
        raise DataError(f"{name} does not hold numbers", expected="numbers", found=str(kind), where=location)
    if any(level.null_count for level in lists) or len(values) != table.num_rows * width or not _is_even(lists):
        raise _uneven_error(lists, name, width, table.num_rows, Where(path=str(path), channel=name), first_row)
    if pa.types.is_boolean(kind) and values.null_count:
        values = values.cast(pa.uint8())
    return values.to_numpy(zero_copy_only=False).reshape(table.num_rows, width)


def _is_even(lists: Sequence[pa.Array]) -> bool:
    """Tell whether all lists of a level are of one length."""
    return all(len(pc.unique(pc.list_value_length(level))) < 2 for level in lists)


def _uneven_error(
    lists: Sequence[pa.Array], name: str, width: int, rows: int, location: Where, first_row: int
) -> DataError:
    """Return the error of a column whose lists are not all as `meta/info.json` says; names the first row."""
    sizes = [_size(cell) for cell in lists[0].to_pylist()] if lists else [1] * rows
    row = next((k for k, size in enumerate(sizes) if size != width), 0)
    size = sizes[row] if sizes else 0
    return DataError(
        f"{name} has rows of another size than meta/info.json says",
        expected=f"{width} numbers in every row",
        found="an empty cell" if size is None else f"{size} numbers in row {first_row + row} of the file",
        where=Where(path=location.path, channel=name, index=first_row + row),
        fix="the row is damaged, or the shape in meta/info.json is that of another set",
    )


def _size(cell: object) -> int | None:
    """Return how many numbers nested lists hold, None where one is missing."""
    if not isinstance(cell, list):
        return None if cell is None else 1
    sizes = [_size(part) if isinstance(part, list) else 1 for part in cell]
    return None if None in sizes else sum(size or 0 for size in sizes)
