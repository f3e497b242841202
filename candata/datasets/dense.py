"""Dense channels: what is too wide for a table lies in one sharded Zarr v3 store a part."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from candata.datasets import durable
from candata.datasets.bounded import require_bounded
from candata.errors import DataError
from candata.schema.channels import CHANNELS
from candata.schema.episode import Episode

#: Rows a chunk (what is decoded at once: about 1 s) and a shard (what is one file), and the level of zstd.
#: Source: measured on synthetic episodes with taxels, read per CPU-second and size (design of the storage).
CHUNK_ROWS, SHARD_ROWS, ZSTD_LEVEL = 75, 3000, 3
SUFFIX = ".zarr"
#: Where a chunk lies in its shard, as a shard's index tells; what stands there for none; and the index's check sum.
_PLACE, _ABSENT, _CRC_BYTES = np.dtype([("begin", "<u8"), ("length", "<u8")]), 2**64 - 1, 4


class Writer:
    """Appends the rows of episodes to a new store; every shard is written once."""

    def __init__(self, folder: Path, channel: str, shape: tuple[int, ...]) -> None:
        import zarr
        from zarr.codecs import ZstdCodec

        self._channel, self._path = channel, folder / f"{channel}{SUFFIX}"
        self._array: Any = zarr.create_array(
            self._path,
            shape=(0, *shape),
            chunks=(CHUNK_ROWS, *shape),
            shards=(SHARD_ROWS, *shape),
            dtype=CHANNELS[channel].dtype,
            compressors=ZstdCodec(level=ZSTD_LEVEL),
            fill_value=0,
        )
        self._shape, self._written = shape, 0
        self._waiting: list[NDArray] = []
        self._episodes: list[dict[str, Any]] = []

    def add(self, episode: Episode) -> None:
        """Take in one episode; whole shards are written, less than one waits."""
        waiting = sum(map(len, self._waiting))
        meta = episode.meta
        self._episodes.append(
            {"id": meta.id, "first_row": self._written + waiting, "rows": len(episode),
             "newton_per_count": meta.newton_per_count}
        )  # fmt: skip
        self._waiting.append(episode[self._channel])
        if waiting + len(episode) < SHARD_ROWS:
            return
        rows = np.concatenate(self._waiting) if len(self._waiting) > 1 else self._waiting[0]
        whole = len(rows) - len(rows) % SHARD_ROWS
        self._write(rows[:whole])
        self._waiting = [rows[whole:]]

    def close(self) -> None:
        """Write what waits and what the store holds, and force all of it to the disk."""
        self._write(np.concatenate([np.zeros((0, *self._shape), CHANNELS[self._channel].dtype), *self._waiting]))
        unit = CHANNELS[self._channel].unit
        self._array.attrs.update({"channel": self._channel, "unit": unit, "episodes": self._episodes})
        for path in [*self._path.rglob("*"), self._path]:
            durable.sync(path)

    def _write(self, rows: NDArray) -> None:
        """Append rows, the store's rows so far being whole shards."""
        self._array.resize((self._written + len(rows), *self._shape))
        for first in range(0, len(rows), SHARD_ROWS):
            block = rows[first : first + SHARD_ROWS]
            self._array[self._written : self._written + len(block)] = block
            self._written += len(block)


def files(folder: Path) -> list[Path]:
    """Return the files of the stores in a part's folder, in a fixed order."""
    return sorted(path for store in folder.glob(f"*{SUFFIX}") for path in store.rglob("*") if path.is_file())


def read(folder: Path, channel: str, rows: slice, shape: tuple[int, ...]) -> NDArray:
    """Return some rows of a channel, `(rows, *shape)`, decoded from the store in a part's folder.

    Zarr tells what the store is. Its chunks are unpacked here, none to more bytes than its shape has: Zarr makes as
    much room as the compressed bytes ask for.

    Raises
    ------
    DataError
        When the store is missing, does not decode or has another shape, or it unfolds to more than is read at once;
        names it.
    """
    import zarr

    path = folder / f"{channel}{SUFFIX}"
    try:
        array: Any = zarr.open_array(path, mode="r")
        found = (array.dtype, array.shape[1:], array.shape[0] >= rows.stop)
        if found != (np.dtype(CHANNELS[channel].dtype), shape, True):
            raise ValueError(f"{array.dtype} {array.shape}")
        _require_ours(array)
        return _decoded(path, array, rows)
    except (MemoryError, DataError):
        raise
    except Exception as error:  # a store's damage surfaces as whatever its codecs raise
        raise durable.damaged(path, durable.reason(error)) from None


def _require_ours(array: Any) -> None:
    """Raise ValueError for a store that is packed in another way than `Writer` packs."""
    (sharding,) = array.metadata.codecs
    packing = sharding.to_dict()["configuration"]
    kinds = [codec["name"] for codec in (*packing["codecs"], *packing["index_codecs"])]
    endian = {codec["configuration"]["endian"] for codec in (packing["codecs"][0], packing["index_codecs"][0])}
    plain = (kinds, endian, packing["index_location"], array.fill_value, array.shards[1:], array.chunks[1:])
    if plain != (["bytes", "zstd", "bytes", "crc32c"], {"little"}, "end", 0, array.shape[1:], array.shape[1:]):
        raise ValueError(f"packed in another way: {', '.join(kinds)}")


def _decoded(path: Path, array: Any, rows: slice) -> NDArray:
    """Return some rows of a store; those of chunks and shards that it lacks are zeros."""
    kind, (each, *shape), shard_rows = array.dtype.newbyteorder("<"), array.chunks, array.shards[0]
    chunk_bytes = each * math.prod(shape) * kind.itemsize
    files = {i: path / array.metadata.encode_chunk_key((i, *(0 for _ in shape))) for i in _blocks(rows, shard_rows)}
    standing = {i: file for i, file in files.items() if file.is_file()}
    stored = sum(file.stat().st_size for file in standing.values())
    require_bounded(path, len(_blocks(rows, each)) * chunk_bytes, stored)
    decoded = np.zeros((rows.stop - rows.start, *shape), kind)
    for shard, file in standing.items():
        for number, packed in _packed(file, shard_rows // each, _blocks(rows, each), shard):
            values = np.frombuffer(pa.Codec("zstd").decompress(packed, chunk_bytes), kind).reshape(each, *shape)
            first = max(number * each, rows.start)
            last = min((number + 1) * each, rows.stop)
            decoded[first - rows.start : last - rows.start] = values[first - number * each : last - number * each]
    return decoded.astype(array.dtype, copy=False)


def _packed(file: Path, count: int, wanted: range, shard: int) -> Iterator[tuple[int, bytes]]:
    """Yield number and compressed bytes of the wanted chunks that a shard of `count` holds.

    Source: Zarr v3, "Sharding codec": pairs of offset and size (uint64) at the end of the file, then their crc32c;
    both are 2^64 - 1 for a chunk that is not there.
    """
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(size - count * _PLACE.itemsize - _CRC_BYTES)
        places = np.frombuffer(stream.read(count * _PLACE.itemsize), _PLACE)
        for number, (begin, length) in enumerate(places.tolist(), shard * count):
            if number not in wanted or begin == length == _ABSENT:
                continue
            if begin + length > size:
                raise ValueError(f"a chunk ends at byte {begin + length} of {size}")
            stream.seek(begin)
            yield number, stream.read(length)


def _blocks(rows: slice, size: int) -> range:
    """Return the numbers of the blocks of `size` rows in which some rows lie."""
    return range(rows.start // size, -(-rows.stop // size))
