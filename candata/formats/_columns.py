"""Named columns of a Parquet, CSV or npz file as one-dimensional arrays."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from candata.errors import CandataError, DataError, UsageError, Where
from candata.formats._npz import require_arrays
from candata.lfs import refuse_pointer

Columns = dict[str, NDArray]

#: Endings of the tables that can be read.
TABLES = (".parquet", ".csv", ".npz")
#: pyarrow infers a CSV column's type from its first block; the whole file is one block up to this size.
_CSV_BLOCK_BYTES = 1 << 30


def read_columns(path: Path, wanted: Iterable[str]) -> Columns:
    """Return the `wanted` columns of a table by name, all of one length, in the file's own types.

    Parameters
    ----------
    path : Path
        A `.parquet`, `.csv` or `.npz` file; of an npz, each array is a column.
    wanted : iterable of str
        Column names.

    Raises
    ------
    UsageError
        When the file's ending is none of these.
    DataError
        When the file is missing or cannot be read, lacks a column, or has no rows.
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
    try:
        columns = reader(path, list(dict.fromkeys(wanted)))
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


def numbers(values: NDArray, column: str, path: Path) -> NDArray[np.float64]:
    """Return a column as float64, missing cells as NaN.

    Raises
    ------
    DataError
        When the column holds anything else than numbers; shows the first such value.
    """
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    index, value = next(((i, v) for i, v in enumerate(values) if not _is_number(v)), (0, values[0]))
    raise DataError(
        f"column {column} does not hold numbers",
        expected="numbers",
        found=f"{value!r} ({values.dtype})",
        where=Where(path=str(path), index=index),
    )


def _is_number(value: object) -> bool:
    """Tell whether a cell of a text column reads as a number."""
    try:
        float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True


def _parquet(path: Path, wanted: list[str]) -> Columns:
    """Return the columns of a Parquet file."""
    with pa.parquet.ParquetFile(path) as file:
        _require(wanted, file.schema_arrow.names, path)
        return _from_arrow(file.read(columns=wanted), wanted)


def _csv(path: Path, wanted: list[str]) -> Columns:
    """Return the columns of a CSV file with a header line."""
    block = min(max(path.stat().st_size, 1 << 20), _CSV_BLOCK_BYTES)
    table = pa.csv.read_csv(path, read_options=pa.csv.ReadOptions(block_size=block))
    _require(wanted, table.column_names, path)
    return _from_arrow(table.select(wanted), wanted)


def _npz(path: Path, wanted: list[str]) -> Columns:
    """Return the one-dimensional arrays of an npz file."""
    require_arrays(path, wanted)
    with path.open("rb") as file:
        arrays = np.load(file, allow_pickle=False)
        if not isinstance(arrays, Mapping):
            raise ValueError("one array without a name")
        _require(wanted, list(arrays), path)
        columns = {name: arrays[name] for name in wanted}
    for name, values in columns.items():
        if values.ndim != 1:
            raise DataError(
                f"array {name} is no column",
                expected="one dimension, one value a row",
                found=f"shape {values.shape}",
                where=Where(path=str(path)),
                fix="save each column as an array of its own",
            )
        if values.dtype.kind in "cV" or values.dtype == np.dtype("M8"):
            raise DataError(
                f"array {name} is no column",
                expected="numbers, texts, or times with their unit",
                found=str(values.dtype),
                where=Where(path=str(path)),
            )
    return columns


def _from_arrow(table: pa.Table, wanted: list[str]) -> Columns:
    """Return arrow columns as numpy arrays; nulls become NaN, NaT or None."""
    columns = {}
    for name in wanted:
        values = table[name]
        if pa.types.is_null(values.type) or pa.types.is_decimal(values.type):
            values = values.cast(pa.float64())
        elif pa.types.is_boolean(values.type) and values.null_count:
            values = values.cast(pa.uint8()).cast(pa.float64())
        elif pa.types.is_dictionary(values.type):
            values = values.cast(values.type.value_type)
        columns[name] = values.to_numpy()
    return columns


def _require(wanted: list[str], known: list[str], path: Path) -> None:
    """Raise when the table lacks a wanted column (names the nearest it has) or has it twice."""
    twice = [name for name in wanted if known.count(name) > 1]
    if twice:
        raise DataError(
            f"the table has several columns {', '.join(twice)}",
            expected="each name once",
            where=Where(path=str(path)),
            fix="rename the columns in the table",
        )
    missing = [name for name in wanted if name not in known]
    if not missing:
        return
    near = {name: _nearest(name, known) for name in missing}
    hints = [f"{name} -> {' or '.join(matches)}" for name, matches in near.items() if matches]
    raise DataError(
        f"the table has no column {', '.join(missing)}",
        expected=", ".join(missing),
        found=f"columns {', '.join(known)}",
        where=Where(path=str(path)),
        fix=f"did you mean {'; '.join(hints)}?" if hints else "correct the column names in the map",
    )


def _nearest(name: str, known: list[str]) -> list[str]:
    """Return the names that differ in case or space alone, else up to three that look alike."""
    plain = name.strip().casefold()
    equal = [other for other in known if other.strip().casefold() == plain]
    return equal or difflib.get_close_matches(name, known, n=3)
