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
from candata.formats._lerobot_layout import Entry, Folder, missing, read_table

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
    held: _Held | None = None
    for entry in folder.entries:
        file = _file_of(entry, holders)
        if held is None or held.file != file:
            held = _read(file, columns)
        if holders is None and not (held.whose == entry.index).any():
            holders = _holders(folder)
            file = _file_of(entry, holders)
            held = held if held.file == file else _read(file, columns)
        if file != entry.file:
            note(f"episode {entry.index}: the index names {entry.file.name}, its rows are in {file.name}: taken there")
        rows = np.flatnonzero(held.whose == entry.index)
        _check_rows(entry, rows, holders)
        part, first = held.table.slice(int(rows[0]), len(rows)), int(rows[0])
        arrays = {name: _column(part, name, widths[name], file, first) for name in names}
        yield entry, arrays | {name: _column(part, name, 1, file, first)[:, 0] for name in (STAMP, FRAME)}


@dataclass(frozen=True, eq=False)
class _Held:
    """A file at hand: its columns, and whose its rows are; of one that is not there, no row."""

    file: Path
    table: pa.Table
    whose: NDArray


def _read(file: Path, columns: Sequence[str]) -> _Held:
    """Return the columns of a file."""
    if not os.path.isfile(file):  # unlike Path.is_file, also where the name is too long
        return _Held(file, pa.table({}), np.zeros(0))
    table = read_table(file, columns)
    return _Held(file, table, _whole_numbers(table, EPISODE, file))


def _file_of(entry: Entry, holders: Holders | None) -> Path:
    """Return the file to take an episode from: the one named, unless it lacks all rows and one other has them all."""
    found = {} if holders is None else holders.get(entry.index, {})
    elsewhere = len(found) == 1 and entry.file not in found and entry.rows in found.values()
    return next(iter(found)) if elsewhere else entry.file


def _holders(folder: Folder) -> Holders:
    """Return which file of a set holds how many rows of which episode, whatever the index says."""
    found: dict[int, dict[Path, int]] = {}
    for path in sorted(folder.root.rglob("*.parquet")):
        if path.relative_to(folder.root).parts[0] == "meta":
            continue
        table = read_table(path, (), optional=(EPISODE,))
        if EPISODE in table.column_names:
            for index, count in zip(*np.unique(_whole_numbers(table, EPISODE, path), return_counts=True), strict=True):
                found.setdefault(int(index), {})[path] = int(count)
    return found


def _check_rows(entry: Entry, rows: NDArray, holders: Holders | None) -> None:
    """Raise unless the rows of an episode are as many as it claims, one after the other."""
    where = Where(path=str(entry.file), episode=str(entry.index))
    if len(rows) != entry.rows or not len(rows):
        if not os.path.isfile(entry.file):
            raise missing(entry.file)
        others = {} if holders is None else holders.get(entry.index, {})
        named = ", ".join(f"{count} in {path.parent.name}/{path.name}" for path, count in others.items())
        raise DataError(
            "the file does not hold the episode's rows",
            expected=f"{entry.rows} rows",
            found=f"{len(rows)} rows" + (f"; {named}" if named else ""),
            where=where,
            fix="correct the file numbers in meta/episodes, or get the set again from its source"
            if named
            else "the set was not closed or was edited; get it again from its source",
        )
    if rows[-1] - rows[0] != len(rows) - 1:
        raise DataError("the rows of an episode do not follow each other", found="rows of another between", where=where)


def _whole_numbers(table: pa.Table, name: str, path: Path) -> NDArray:
    """Return a column of whole numbers `(T,)`; they may be kept as floats."""
    values = _column(table, name, 1, path, 0)[:, 0]
    odd = np.flatnonzero(~(np.isfinite(values) & (values == np.rint(values))))
    if len(odd):
        raise DataError(
            f"column {name} holds what is no whole number",
            expected="0, 1, 2, ...",
            found=f"{values[odd[0]]} ({len(odd)} such rows)",
            where=Where(path=str(path), channel=name, index=int(odd[0])),
            fix="correct the column; it says which episode a row belongs to",
        )
    return values


def _column(table: pa.Table, name: str, width: int, path: Path, first: int) -> NDArray:
    """Return a column as `(T, width)`: numbers, lists, or lists of lists; a missing value is NaN.

    `first` is the row of the file at which the table begins, for messages.
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
        where = Where(path=str(path), channel=name)
        raise DataError(f"{name} does not hold numbers", expected="numbers", found=str(kind), where=where)
    if any(one.null_count for one in lists) or len(values) != table.num_rows * width or not _even(lists):
        raise _uneven(lists, name, width, table.num_rows, Where(path=str(path), channel=name), first)
    if pa.types.is_boolean(kind) and values.null_count:
        values = values.cast(pa.uint8())
    return values.to_numpy(zero_copy_only=False).reshape(table.num_rows, width)


def _even(lists: Sequence[pa.Array]) -> bool:
    """Tell whether all lists of a level are of one length."""
    return all(len(pc.unique(pc.list_value_length(one))) < 2 for one in lists)


def _uneven(lists: Sequence[pa.Array], name: str, width: int, rows: int, where: Where, first: int) -> DataError:
    """Return the error of a column whose lists are not all as `meta/info.json` says; names the first row."""
    sizes = [_size(one) for one in lists[0].to_pylist()] if lists else [1] * rows
    row = next((k for k, size in enumerate(sizes) if size != width), 0)
    size = sizes[row] if sizes else 0
    return DataError(
        f"{name} has rows of another size than meta/info.json says",
        expected=f"{width} numbers in every row",
        found="an empty cell" if size is None else f"{size} numbers in row {first + row} of the file",
        where=Where(path=where.path, channel=name, index=first + row),
        fix="the row is damaged, or the shape in meta/info.json is that of another set",
    )


def _size(cell: object) -> int | None:
    """Return how many numbers nested lists hold, None where one is missing."""
    if not isinstance(cell, list):
        return None if cell is None else 1
    sizes = [_size(part) if isinstance(part, list) else 1 for part in cell]
    return None if None in sizes else sum(size or 0 for size in sizes)
