"""What an exported MCAP file says for candata alone: an episode's rows and metadata, from which it is restored."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.datasets import content_hash
from candata.datasets.encode import meta_json
from candata.errors import CandataError, DataError, Where
from candata.formats import Reading
from candata.formats._mcap_messages import message
from candata.formats._mcap_scan import Scan
from candata.schema.channels import CHANNELS, DENSE_CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.json_text import parse_json

#: Name of the metadata record, and topics.
EPISODE = "candata.episode"
ROWS, TAXELS, POINTS = "/candata/row", "/candata/taxels", "/object/points"
#: Version of what is written here; a reader refuses another.
LAYOUT = "1"
#: How a float32 that JSON has no number for is written: its bits; the usual NaN is null.
_BITS, _NAN = "bits:", 0x7FC00000


def episode_record(episode: Episode) -> dict[str, str]:
    """Return the metadata record of an episode: who, what, when, its columns, and the hash of its content."""
    columns = {name: list(array.shape) for name, array in episode.arrays.items()}
    return {
        "layout": LAYOUT,
        "meta": meta_json(episode.meta),
        "columns": json.dumps(columns),
        "content_hash": content_hash(episode),
    }


def row_schema(episode: Episode) -> bytes:
    """Return the JSON Schema of a row, with the unit of each channel."""
    properties: dict[str, Any] = {}
    for name, array in episode.arrays.items():
        if name not in DENSE_CHANNELS:
            properties[name] = _property(name, array)
    return json.dumps({"type": "object", "title": "candata.Row", "properties": properties}).encode()


def _property(name: str, array: NDArray) -> dict[str, Any]:
    """Return the schema of one channel of a row."""
    kind = {"b": "boolean", "i": "integer"}.get(array.dtype.kind, "number")
    schema: dict[str, Any] = {"type": kind}
    for _ in array.shape[1:]:
        schema = {"type": "array", "items": schema}
    channel = CHANNELS.get(name)
    return schema | ({"description": f"{channel.meaning} [{channel.unit}]"} if channel else {})


def rows_json(episode: Episode) -> Iterator[bytes]:
    """Yield each row as JSON; every number is read back as the same bits."""
    columns = {name: _json_list(array) for name, array in episode.arrays.items() if name not in DENSE_CHANNELS}
    for k in range(len(episode)):
        yield json.dumps({name: rows[k] for name, rows in columns.items()}, allow_nan=False).encode()


def _json_list(array: NDArray) -> list:
    """Return an array as lists that JSON can hold."""
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return array.tolist()
    bits = array.view(np.uint32)
    bit_texts = [None if b == _NAN else f"{_BITS}{b:08x}" for b in bits[~np.isfinite(array)].tolist()]
    items = array.astype(object)
    items[np.isfinite(array)] = array[np.isfinite(array)].tolist()
    items[~np.isfinite(array)] = bit_texts
    return items.tolist()


def restore(path: Path, reading: Reading) -> Episode:
    """Return the episode that `candata export mcap` wrote into a file, bit for bit.

    Raises
    ------
    DataError
        When the file is damaged, or was changed: the content must have the hash that it had.
    """
    location = Where(path=str(path))
    try:
        episode, stored_hash, cloud = _read_episode(path)
    except CandataError as error:
        raise _changed_error(location, error.problem) from None
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise _changed_error(location, f"{type(error).__name__}: {error}".splitlines()[0]) from None
    if content_hash(episode) != stored_hash:
        raise _changed_error(location, f"content {content_hash(episode)[:12]} where {stored_hash[:12]} was written")
    if cloud is not None:
        reading.cloud(cloud)
    return episode


def _changed_error(location: Where, found: str) -> DataError:
    """Return the error of a file from which its episode cannot be restored."""
    return DataError(
        "the episode cannot be restored from the file",
        expected="the file as `candata export mcap` wrote it",
        found=found,
        where=location,
        fix="export it again; or give a --map to read its topics as any other recording's",
    )


def _read_episode(path: Path) -> tuple[Episode, str, NDArray[np.float32] | None]:
    """Return the episode in a file, the hash that it had, and its cloud if there is one."""
    from mcap.records import Channel, Message, Metadata

    scan, record = Scan(path), dict[str, str]()
    topics: dict[int, str] = {}
    rows: list[dict[str, Any]] = []
    taxel_rows: list[NDArray[np.int16]] = []
    cloud = None
    for item in scan:
        if isinstance(item, Metadata) and item.name == EPISODE:
            record = dict(item.metadata)
        elif isinstance(item, Channel):
            topics[item.id] = item.topic
        elif isinstance(item, Message):
            topic = topics.get(item.channel_id)
            if topic == ROWS:
                rows.append(parse_json(item.data, finite=False))
            elif topic == TAXELS:
                taxel_rows.append(_counts(item.data))
            elif topic == POINTS:
                cloud = _points(item.data)
    if not scan.whole or scan.damaged_chunks:
        raise DataError(f"the file is cut or damaged: whole records end at byte {scan.end}")
    if record["layout"] != LAYOUT:
        raise DataError(f"layout {record['layout']!r}, where this version of candata reads {LAYOUT!r}")
    meta = EpisodeMeta.parse(parse_json(record["meta"]), path)
    columns: Mapping[str, list[int]] = parse_json(record["columns"])
    arrays = {name: _column(name, shape, rows, taxel_rows) for name, shape in columns.items()}
    return Episode(meta, arrays), record["content_hash"], cloud if meta.point_cloud else None


def _column(name: str, shape: list[int], rows: list[dict[str, Any]], taxel_rows: list[NDArray[np.int16]]) -> NDArray:
    """Return one column of the episode."""
    if name in DENSE_CHANNELS:
        return np.stack(taxel_rows) if math.prod(shape) else np.zeros(shape, np.int16)
    flag = name.endswith(VALID_SUFFIX)
    dtype = np.dtype("bool" if flag else CHANNELS[name].dtype)
    values = [row[name] for row in rows]
    if dtype.kind != "f":
        return np.array(values, dtype).reshape(shape)
    try:
        return np.array(values, np.float64).astype(np.float32).reshape(shape)
    except ValueError:
        return _from_bits(np.array(values, object)).reshape(shape)


def _from_bits(values: NDArray) -> NDArray[np.float32]:
    """Return float32 numbers of which some are written as their bits."""
    cells = values.reshape(-1)
    is_text = np.array([isinstance(value, str) for value in cells])
    numbers = np.array([np.nan if text else value for text, value in zip(is_text, cells, strict=True)], np.float32)
    bits = [int(value.removeprefix(_BITS), 16) for value in cells[is_text]]
    numbers[is_text] = np.array(bits, np.uint32).view(np.float32)
    return numbers


def _counts(data: bytes) -> NDArray[np.int16]:
    """Return the taxels of a row `(F, N, 3) int16`."""
    from google.protobuf.message import DecodeError

    try:
        frame = message("candata.TactileFrame").FromString(data)
    except DecodeError as error:
        raise ValueError(str(error)) from None
    return np.frombuffer(frame.counts, "<i2").reshape(tuple(frame.shape))


def _points(data: bytes) -> NDArray[np.float32]:
    """Return the points of a cloud `(N, 3) float32 [m]`."""
    from google.protobuf.message import DecodeError

    try:
        cloud = message("foxglove.PointCloud").FromString(data)
    except DecodeError as error:
        raise ValueError(str(error)) from None
    return np.frombuffer(cloud.data, "<f4").reshape(-1, 3)
