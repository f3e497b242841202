"""Episodes as Arrow tables and back, and the hash of their content; no files."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from candata.schema.channels import CHANNELS, DENSE_CHANNELS, VALID_SUFFIX, canonical_order
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.json_text import parse_json

#: Shapes without the time axis, by column: what all episodes of one part share.
ColumnShapes = dict[str, tuple[int, ...]]

#: Key of the schema metadata that holds the layout.
LAYOUT_KEY = b"candata.layout"

_TEXT = pa.string()
_NAMES = pa.list_(pa.string())

#: `episodes.parquet`: one row an episode, in the order of the rows of `steps.parquet`.
EPISODE_COLUMNS = pa.schema(
    {
        "id": _TEXT,
        "source": _TEXT,
        "scene": _TEXT,
        "object": _TEXT,
        "task": _TEXT,
        "seed": pa.int64(),
        "effects": _TEXT,
        "outcome": _TEXT,
        "rate_hz": pa.float64(),
        "rows": pa.int64(),
        "duration_s": pa.float64(),
        "joint_names": _NAMES,
        "actuator_names": _NAMES,
        "fingertip_names": _NAMES,
        "content_hash": _TEXT,
        "row_group": pa.int64(),
        "meta": _TEXT,
    }
)


@dataclass(frozen=True)
class RawEpisode:
    """An episode as stored, unchecked: what the checks look at.

    Attributes
    ----------
    id : str
        Name in the catalog row.
    meta_json : str
        Who, what, when as stored.
    arrays : mapping of str to ndarray
        Columns as stored.
    stored_hash : str
        Content hash that the catalog row claims.
    first_row : int
        Rows of the part before it.
    rows : int
        Rows that its catalog row claims.
    dense_shapes : mapping of str to tuple of int, optional
        Shapes of channels that the tables lack because they lie in Zarr stores.
    """

    id: str
    meta_json: str
    arrays: Mapping[str, NDArray]
    stored_hash: str
    first_row: int = 0
    rows: int = 0
    dense_shapes: ColumnShapes | None = None

    def content_hash(self) -> str:
        """Return the hash of what is stored now."""
        return hash_columns(self.meta_json, self.arrays)

    def meta(self) -> EpisodeMeta:
        """Return who, what, when.

        Raises
        ------
        ValueError, UsageError
            When the stored text is no JSON, or no such record.
        """
        return EpisodeMeta.parse(parse_json(self.meta_json), f"meta of {self.id}")


def meta_json(meta: EpisodeMeta) -> str:
    """Return who, what, when as canonical JSON; without defaults, so a new optional field changes nothing."""
    fields = meta.model_dump(mode="json", exclude_defaults=True)
    return json.dumps(fields, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def hash_columns(meta: str, arrays: Mapping[str, NDArray]) -> str:
    """Return sha256 over (name, dtype, shape, bytes) of `meta` and of each column, in canonical order.

    Unknown columns come last, by name, so that damaged data hashes too.
    """
    digest = hashlib.sha256()
    text = meta.encode()
    digest.update(f"meta|json|{len(text)}|".encode() + text)
    known_names = canonical_order([n for n in arrays if n.removesuffix(VALID_SUFFIX) in CHANNELS])
    for name in [*known_names, *sorted(set(arrays) - set(known_names))]:
        array = np.ascontiguousarray(arrays[name])
        little_endian = array.astype(array.dtype.newbyteorder("<"), copy=False)
        shape = ",".join(map(str, array.shape))
        digest.update(f"{name}|{array.dtype.name}|{shape}|".encode())
        digest.update(little_endian.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def content_hash(episode: Episode) -> str:
    """Return the sha256 that names the episode's content, whatever file it is kept in.

    Covers every column and who, what, when. Equal content gives equal hashes on every machine.
    """
    return hash_columns(meta_json(episode.meta), episode.arrays)


def layout_of(episode: Episode) -> ColumnShapes:
    """Return each column's shape without the time axis."""
    return {name: array.shape[1:] for name, array in episode.arrays.items()}


def dense_layout(layout: ColumnShapes) -> ColumnShapes:
    """Return the part of a layout that lies in Zarr stores; a channel without elements lies nowhere."""
    return {name: shape for name, shape in layout.items() if name in DENSE_CHANNELS and 0 not in shape}


def steps_schema(layout: ColumnShapes) -> pa.Schema:
    """Return the Arrow schema of `steps.parquet`: a fixed-size list a column, units in the field metadata."""
    fields = [pa.field("episode", pa.string())]
    dense_shapes = dense_layout(layout)
    for name, shape in layout.items():
        if math.prod(shape) and name not in dense_shapes:
            fields.append(pa.field(name, _column_type(name, shape), metadata=_field_metadata(name, shape)))
    text = json.dumps({name: list(shape) for name, shape in layout.items()})
    return pa.schema(fields, metadata={LAYOUT_KEY: text.encode()})


def _column_type(name: str, shape: tuple[int, ...]) -> pa.DataType:
    """Return the Arrow type of a column of the schema."""
    dtype = "bool" if name.endswith(VALID_SUFFIX) else CHANNELS[name].dtype
    scalar = pa.from_numpy_dtype(np.dtype(dtype))
    return pa.list_(scalar, math.prod(shape)) if shape else scalar


def _field_metadata(name: str, shape: tuple[int, ...]) -> dict[str, str]:
    """Return what a reader without candata needs to know of a column."""
    channel = CHANNELS[name.removesuffix(VALID_SUFFIX)]
    unit = "1" if name.endswith(VALID_SUFFIX) else channel.unit
    return {"unit": unit, "shape": json.dumps(shape), "frame": channel.frame, "role": channel.role}


def parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """Return how `steps.parquet` is encoded: numbers by their bytes, times by their differences, no dictionaries.

    Source: measured on synthetic episodes of 300 steps, 56.6 against 96.4 kB and 2.7 times the episodes per
    CPU-second of pyarrow's defaults, whose dictionaries never fit readings (`benchmarks/store.py` writes them).
    """
    split = {}
    for field in schema:
        is_list = pa.types.is_fixed_size_list(field.type)
        if pa.types.is_float32(field.type.value_type if is_list else field.type):
            split[f"{field.name}.list.element" if is_list else field.name] = "BYTE_STREAM_SPLIT"
    return {
        "compression": "zstd",
        "compression_level": 3,
        "use_dictionary": ["episode"],
        "write_statistics": ["episode", "time_ns"],
        "column_encoding": {"time_ns": "DELTA_BINARY_PACKED", **split},
    }


def steps_batch(episode: Episode, schema: pa.Schema) -> pa.RecordBatch:
    """Return the rows of one episode as `steps.parquet` keeps them."""
    columns: list[pa.Array] = [pa.array([episode.meta.id] * len(episode), pa.string())]
    for field in list(schema)[1:]:
        values = pa.array(episode.arrays[field.name].reshape(-1))
        if pa.types.is_fixed_size_list(field.type):
            values = pa.FixedSizeListArray.from_arrays(values, field.type.list_size)
        columns.append(values)
    return pa.RecordBatch.from_arrays(columns, schema=schema)


def episode_row(meta: EpisodeMeta, time_ns: NDArray[np.int64], digest: str, row_group: int) -> dict[str, object]:
    """Return an episode's row of `episodes.parquet`; a seed beyond int64 stands in `meta` only."""
    effects = None if meta.effects is None else [e.model_dump(mode="json") for e in meta.effects]
    seed = meta.seed if meta.seed is not None and abs(meta.seed) < 2**63 else None
    duration_s = (time_ns[-1:] - time_ns[:1]) * 1e-9
    return {
        "id": meta.id,
        "source": meta.source,
        "scene": meta.scene,
        "object": meta.object,
        "task": meta.task,
        "seed": seed,
        "effects": None if effects is None else json.dumps(effects),
        "outcome": meta.outcome,
        "rate_hz": meta.rate_hz,
        "rows": len(time_ns),
        "duration_s": float(duration_s[0]),
        "joint_names": list(meta.joint_names),
        "actuator_names": list(meta.actuator_names),
        "fingertip_names": list(meta.fingertip_names),
        "content_hash": digest,
        "row_group": row_group,
        "meta": meta_json(meta),
    }


def episode_table(stored_table: pa.Table) -> pa.Table:
    """Return a stored table with the columns of `EPISODE_COLUMNS`, those that it lacks without values.

    Raises
    ------
    pyarrow.ArrowException
        When a column is of another type.
    """
    missing_columns = {name for name in EPISODE_COLUMNS.names if name not in stored_table.column_names}
    columns = [
        pa.nulls(len(stored_table), field.type)
        if field.name in missing_columns
        else stored_table[field.name].cast(field.type)
        for field in EPISODE_COLUMNS
    ]
    return pa.table(columns, EPISODE_COLUMNS)


def decode_group(steps: pa.Table, rows: Sequence[Mapping[str, object]], first_row: int = 0) -> list[RawEpisode]:
    """Return the episodes of one row group: `steps` split by the row counts in `rows`.

    Dense channels are named, not read. `first_row` counts the part's rows before the group.

    Raises
    ------
    ValueError
        When the rows do not add up, or a column is no fixed-size list of its shape.
    """
    counts = [int(str(row["rows"])) for row in rows]
    if sum(counts) != steps.num_rows:
        raise ValueError(f"{steps.num_rows} rows where the episodes claim {sum(counts)}")
    layout = stored_layout(steps.schema)
    dense_shapes = dense_layout(layout)
    columns = {name: _decode_column(steps, name, shape) for name, shape in layout.items() if name not in dense_shapes}
    ends = np.cumsum(counts)
    return [
        RawEpisode(
            str(row["id"]),
            str(row["meta"]),
            {name: column[end - count : end] for name, column in columns.items()},
            str(row["content_hash"]),
            first_row + int(end - count),
            count,
            dense_shapes,
        )
        for row, count, end in zip(rows, counts, ends, strict=True)
    ]


def stored_layout(schema: pa.Schema) -> ColumnShapes:
    """Return each column's shape without the time axis, as the schema of `steps.parquet` tells it.

    Raises
    ------
    ValueError, TypeError, AttributeError
        When what the schema tells is damaged.
    """
    layout = {field.name: _stored_shape(field.type) for field in list(schema)[1:]}
    return layout | {n: tuple(s) for n, s in parse_json((schema.metadata or {}).get(LAYOUT_KEY, b"{}")).items()}


def _stored_shape(kind: pa.DataType) -> tuple[int, ...]:
    """Return the shape without the time axis that a column's type tells."""
    return (kind.list_size,) if pa.types.is_fixed_size_list(kind) else ()


def _decode_column(steps: pa.Table, name: str, shape: tuple[int, ...]) -> NDArray:
    """Return one column as `(rows, *shape)`; a column without elements is not stored."""
    if not math.prod(shape):
        dtype = "bool" if name.endswith(VALID_SUFFIX) else CHANNELS[name].dtype
        return np.zeros((steps.num_rows, *shape), dtype)
    if name not in steps.column_names:
        raise ValueError(f"column {name} is missing")
    column = steps.column(name).combine_chunks()
    values = column.flatten() if shape else column
    return values.to_numpy(zero_copy_only=False).reshape(steps.num_rows, *shape)
