"""Parquet read within a bound: a few kilobytes may unfold to more than any memory holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from candata.datasets.footer import ColumnChunk, read_chunks
from candata.errors import DataError, Where

#: What may be unfolded at once from a file of any size [bytes]: half of the memory that a reader of untrusted data
#: should need.
LIMIT_BYTES = 512 * 2**20
#: What a larger file may unfold to, over its own size. Readings shrink 2 to 20 times; only constants shrink more.
LIMIT_RATIO = 100
#: Least size of a value while it is decoded [bytes].
_VALUE_BYTES = 8


def require_bounded(path: Path, unfolded_bytes: int, stored_bytes: int) -> None:
    """Return nothing; `stored_bytes` of a file do not unfold to more than is read at once.

    Raises
    ------
    DataError
        When they do.
    """
    limit = max(LIMIT_BYTES, LIMIT_RATIO * stored_bytes)
    if unfolded_bytes > limit:
        raise DataError(
            "a file unfolds to more than is read at once",
            expected=f"at most {limit / 1e6:.0f} MB of {stored_bytes / 1e6:.3g} MB",
            found=f"{unfolded_bytes / 1e6:.0f} MB",
            where=Where(path=str(path)),
            fix="do not trust this file; ask who made it",
        )


def read_parquet(path: Path, columns: Sequence[str] | None = None, group: int | None = None) -> pa.Table:
    """Return a Parquet file, or one of its row groups.

    Text is read as dictionaries and unfolded last, when it is known how large that is.

    Parameters
    ----------
    path : Path
        File.
    columns : sequence of str, optional
        Columns to read, by default all.
    group : int, optional
        Row group to read, by default all.

    Raises
    ------
    DataError
        When it would take more memory than its size allows.
    pyarrow.ArrowException, OSError, ValueError
        When it is missing or no Parquet file, or lacks the row group.
    """
    meta = pq.read_metadata(path)
    leaves = [meta.schema.column(i) for i in range(meta.num_columns)]
    claimed = read_chunks(path)
    stored_bytes = path.stat().st_size
    groups = claimed if group is None else claimed[group : group + 1]
    require_bounded(path, sum(_decoded_bytes(chunks, leaves, columns) for chunks in groups), stored_bytes)
    texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY"]
    names = None if columns is None else list(columns)
    with pq.ParquetFile(path, metadata=meta, read_dictionary=texts) as file:
        if group is None:
            table = file.read(names, use_threads=False)
        else:
            table = file.read_row_group(group, names, use_threads=False)
    require_bounded(path, sum(map(_text_bytes, table.columns)), stored_bytes)
    return table.cast(
        pa.schema([field.with_type(_plain_type(field.type)) for field in table.schema], table.schema.metadata)
    )


def _decoded_bytes(
    chunks: Sequence[ColumnChunk], leaves: Sequence[pq.ColumnSchema], columns: Sequence[str] | None
) -> int:
    """Return what a row group takes decoded, by its number of values and by its pages [bytes]."""
    total = 0
    for chunk, leaf in zip(chunks, leaves, strict=True):
        if columns is None or leaf.path.split(".")[0] in columns:
            width = max(_VALUE_BYTES, leaf.length)
            total += max(chunk.size_bytes, chunk.values * width, chunk.rows * width, 0)
    return total


def _plain_type(kind: pa.DataType) -> pa.DataType:
    """Return the type of text that stands for itself, in lists too; any other as it is."""
    if pa.types.is_dictionary(kind):
        return kind.value_type
    return pa.list_(kind.value_field.with_type(_plain_type(kind.value_type))) if pa.types.is_list(kind) else kind


def _text_bytes(column: pa.ChunkedArray) -> int:
    """Return what the texts of a column take one by one [bytes]; 0 where it holds none."""
    total = 0
    for chunk in column.chunks:
        while pa.types.is_list(chunk.type) or pa.types.is_large_list(chunk.type):
            chunk = chunk.flatten()
        if pa.types.is_dictionary(chunk.type):
            lengths = pc.binary_length(chunk.dictionary).cast(pa.int64())
            total += pc.sum(lengths.take(chunk.indices)).as_py() or 0
    return total
