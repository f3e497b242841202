"""Columns of a Parquet, CSV or npz file by name, with one value or one list of values in each row."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet
from numpy.typing import NDArray

from candata.datasets.bounded import require_bounded
from candata.errors import CandataError, DataError, UsageError, Where
from candata.formats._csv import dialect, read_csv
from candata.formats._memory import require_memory
from candata.formats._names import split_entry
from candata.formats._npz import require_arrays
from candata.lfs import refuse_pointer

Columns = dict[str, NDArray]

#: Endings of the tables that can be read.
TABLES = (".parquet", ".csv", ".npz")
#: Bytes that a number takes in memory.
_NUMBER_BYTES = 8
#: What tables write for a flag that is not a number.
_FLAG_WORDS = {"true": 1.0, "false": 0.0}


def read_columns(path: Path, names: Iterable[str], entries: Iterable[str] = ()) -> Columns:
    """Return columns of a table by name, all of one length, in the file's own types.

    Nothing else in the file is decoded or checked.

    Parameters
    ----------
    path : Path
        A `.parquet`, `.csv` or `.npz` file; of an npz, each array is a column.
    names : iterable of str
        Columns of one value in each row, `(T,)`.
    entries : iterable of str
        Columns that may hold a list in each row, `(T, k)`, nested lists row-major; `state[0:7]` means column `state`.

    Raises
    ------
    UsageError
        When the file's ending is none of these.
    DataError
        When the file is missing or cannot be read, lacks a column, has no rows, or is larger than the memory; when one
        of `names` holds lists, or a column lists of several lengths.
    """
    readers = dict(zip(TABLES, (_parquet, _csv, _npz), strict=True))
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise UsageError(
            "unknown kind of table",
            expected=f"a file that ends in {', '.join(readers)}",
            found=path.name,
            where=Where(path=str(path)),
        )
    require_file(path)
    refuse_pointer(path)
    names = list(names)
    try:
        columns = reader(path, names, list(entries))
    except CandataError:
        raise
    except Exception as error:  # pyarrow, zipfile and zlib raise nearly everything, by where the damage lies
        raise DataError(
            "the table cannot be read",
            expected=f"a {path.suffix[1:]} file",
            found=(str(error).splitlines() or [type(error).__name__])[0],
            where=Where(path=str(path)),
            fix="check that the file is whole, and that its ending tells what it is",
        ) from None
    for name in names:
        if columns[name].ndim > 1:
            raise DataError(
                f"column {name} holds lists",
                expected="one value in each row",
                found=f"{columns[name].shape[1]} values",
                where=Where(path=str(path)),
            )
    check_lengths(columns, path)
    return columns


def require_file(path: Path) -> None:
    """Raise when the table is not there.

    Raises
    ------
    DataError
        Says how the map's `file` is read.
    """
    if not os.path.isfile(path):  # unlike Path.is_file, also where the name is too long
        raise DataError(
            "the table does not exist",
            found="no such file",
            where=Where(path=str(path)),
            fix="correct `file` in the map; it is relative to the map's folder",
        )


def check_lengths(columns: Mapping[str, NDArray], path: Path) -> None:
    """Raise when the columns differ in length or have no rows.

    Raises
    ------
    DataError
        Names the columns and lengths that differ, or says that the table is empty.
    """
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        low, high = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
        raise DataError(
            "the columns differ in length",
            expected="one length",
            found=f"{low}: {lengths[low]} rows, {high}: {lengths[high]} rows",
            where=Where(path=str(path)),
        )
    if not any(lengths.values()):
        raise DataError("the table is empty", expected="at least 1 row", where=Where(path=str(path)))


def numbers(values: NDArray, column: str, path: Path, flags: bool = False) -> NDArray[np.float64]:
    """Return a column as float64 of its own shape, missing cells as NaN.

    Parameters
    ----------
    flags : bool
        Take the words true and false, in any case, for 1 and 0.

    Raises
    ------
    DataError
        When the column holds anything else than numbers; shows the first such value.
    """
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    cells = values.ravel()
    if flags and all(isinstance(v, str) and v.strip().casefold() in _FLAG_WORDS for v in cells if v is not None):
        words = [np.nan if v is None else _FLAG_WORDS[v.strip().casefold()] for v in cells]
        return np.array(words, float).reshape(values.shape)
    index, value = next(((i, v) for i, v in enumerate(cells) if not _is_number(v)), (0, cells[0]))
    raise DataError(
        f"column {column} does not hold numbers",
        expected="numbers",
        found=f"{value!r} ({values.dtype})",
        where=Where(path=str(path), index=index // max(1, cells.size // len(values))),
    )


def _is_number(value: object) -> bool:
    """Tell whether a cell of a text column reads as a number."""
    try:
        float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True


def _parquet(path: Path, names: list[str], entries: list[str]) -> Columns:
    """Return the columns of a Parquet file."""
    with pa.parquet.ParquetFile(path) as file:
        column_names = _resolve(names, entries, file.schema_arrow.names, path)
        claimed = file.metadata.num_rows * len(column_names) * _NUMBER_BYTES
        require_memory(claimed, "the table", Where(path=str(path)))
        require_bounded(path, claimed, path.stat().st_size)
        return _from_arrow(file.read(columns=column_names), column_names, path)


def _csv(path: Path, names: list[str], entries: list[str]) -> Columns:
    """Return the columns of a text table."""
    require_memory(path.stat().st_size, "the table", Where(path=str(path)))
    layout = dialect(path)
    if not layout.has_header and not {*names, *entries} <= set(layout.names):
        raise DataError(
            "the table has no header: its first line holds numbers",
            expected="a first line with the names of columns, or a map that gives columns by number",
            found=layout.first_line[:80],
            where=Where(path=str(path)),
            fix="give columns by number, from 0, such as `time_s: 0` and `joint_position: [1, 2]`, or add a first line",
        )
    column_names = _resolve(names, entries, list(layout.names), path)
    return _from_arrow(read_csv(path, layout, column_names), column_names, path)


def _npz(path: Path, names: list[str], entries: list[str]) -> Columns:
    """Return the arrays of an npz file; axes behind the first become one."""
    require_arrays(path, [])
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        column_names = _resolve(names, entries, list(arrays), path)
        require_arrays(path, column_names)
        columns = {name: arrays[name] for name in column_names}
    for name, values in columns.items():
        if values.ndim == 0 or values.dtype.kind in "cV" or values.dtype == np.dtype("M8"):
            raise DataError(
                f"array {name} is no column",
                expected="numbers, texts, or times with their unit",
                found=str(values.dtype) if values.ndim else "a single value",
                where=Where(path=str(path)),
                fix="save it as an array of one of these",
            )
    return {name: values if values.ndim < 2 else values.reshape(len(values), -1) for name, values in columns.items()}


def _from_arrow(table: pa.Table, column_names: list[str], path: Path) -> Columns:
    """Return arrow columns as numpy arrays; nulls become NaN, NaT or None."""
    columns = {}
    for name in column_names:
        values = table[name].combine_chunks()
        if _is_list(values.type):
            columns[name] = _from_lists(values, name, np.arange(len(values)), Where(path=str(path)))
        else:
            columns[name] = _from_values(values)
    return columns


def _from_values(values: pa.Array) -> NDArray:
    """Return `(T,)` values; nulls become NaN, NaT or None."""
    if pa.types.is_null(values.type) or pa.types.is_decimal(values.type):
        values = values.cast(pa.float64())
    elif pa.types.is_boolean(values.type) and values.null_count:
        values = values.cast(pa.uint8()).cast(pa.float64())
    elif pa.types.is_dictionary(values.type):
        values = values.cast(values.type.value_type)
    return values.to_numpy(zero_copy_only=False)


def _is_list(kind: pa.DataType) -> bool:
    """Tell whether a type is a list of any kind."""
    return pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)


def _from_lists(values: pa.Array, name: str, rows: NDArray[np.int64], location: Where) -> NDArray:
    """Return `(T, k)` what the lists of each row hold, inner lists row-major; a row without a list is NaN or None.

    `rows (T,)` are the numbers of the rows in the table, for messages.
    """
    has_list = values.is_valid().to_numpy(zero_copy_only=False)
    lengths = pc.list_value_length(values).drop_null().to_numpy(zero_copy_only=False)
    if len(set(lengths.tolist())) > 1:
        usual_length = int(np.bincount(lengths).argmax())
        odd_row = int(np.argmax(lengths != usual_length))
        raise DataError(
            f"column {name} holds lists of several lengths",
            expected=f"{usual_length} values, as in most rows",
            found=f"{lengths[odd_row]} values",
            where=replace(location, index=int(rows[has_list][odd_row])),
        )
    inner = values.flatten()
    if _is_list(inner.type):
        inner_values = _from_lists(inner, name, np.repeat(rows[has_list], lengths), location)
    else:
        inner_values = _from_values(inner)
    matrix = inner_values.reshape(len(lengths), -1) if len(lengths) else np.zeros((0, 0))
    if has_list.all():
        return matrix
    fill_value = None if matrix.dtype.kind == "O" else np.nan
    result = np.full((len(has_list), matrix.shape[1]), fill_value, np.result_type(matrix, type(fill_value)))
    result[has_list] = matrix
    return result


def _resolve(names: list[str], entries: list[str], known_names: list[str], path: Path) -> list[str]:
    """Return the columns that names and entries mean; raises when one is missing or stands twice."""
    column_names = list(dict.fromkeys([*names, *(split_entry(entry, known_names)[0] for entry in entries)]))
    repeated_names = [name for name in column_names if known_names.count(name) > 1]
    if repeated_names:
        raise DataError(
            f"the table has several columns {', '.join(repeated_names)}",
            expected="each name once",
            where=Where(path=str(path)),
            fix="rename the columns in the table",
        )
    missing_names = [name for name in column_names if name not in known_names]
    if not missing_names:
        return column_names
    matches_by_name = {name: _nearest_names(name, known_names) for name in missing_names}
    hints = [f"{name} -> {' or '.join(matches)}" for name, matches in matches_by_name.items() if matches]
    raise DataError(
        f"the table has no column {', '.join(missing_names)}",
        expected=", ".join(missing_names),
        found=f"columns {', '.join(known_names)}",
        where=Where(path=str(path)),
        fix=f"did you mean {'; '.join(hints)}?" if hints else "correct the column names in the map",
    )


def _nearest_names(name: str, known_names: list[str]) -> list[str]:
    """Return the names that differ in case or space alone, else up to three that look alike."""
    key = name.strip().casefold()
    equal_names = [candidate for candidate in known_names if candidate.strip().casefold() == key]
    return equal_names or difflib.get_close_matches(name, known_names, n=3)
