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
#: Entry of a shard's index, its number for a missing chunk, and the bytes of the index's check sum.
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
        unwritten_rows = sum(map(len, self._waiting))
        meta = episode.meta
        self._episodes.append(
            {
                "id": meta.id,
                "first_row": self._written + unwritten_rows,
                "rows": len(episode),
                "newton_per_count": meta.newton_per_count,
            }
        )
        self._waiting.append(episode[self._channel])
        if unwritten_rows + len(episode) < SHARD_ROWS:
            return
        rows = np.concatenate(self._waiting) if len(self._waiting) > 1 else self._waiting[0]
        full_rows = len(rows) - len(rows) % SHARD_ROWS
        self._write(rows[:full_rows])
        self._waiting = [rows[full_rows:]]

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
        for start in range(0, len(rows), SHARD_ROWS):
            block = rows[start : start + SHARD_ROWS]
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
        stored_form = (array.dtype, array.shape[1:], array.shape[0] >= rows.stop)
        if stored_form != (np.dtype(CHANNELS[channel].dtype), shape, True):
            raise ValueError(f"{array.dtype} {array.shape}")
        _require_ours(array)
        return _decode_rows(path, array, rows)
    except (MemoryError, DataError):
        raise
    except Exception as error:  # a store's damage surfaces as whatever its codecs raise
        raise durable.damaged_error(path, durable.reason(error)) from None


def _require_ours(array: Any) -> None:
    """Raise ValueError for a store that is packed in another way than `Writer` packs."""
    (shard_codec,) = array.metadata.codecs
    shard_options = shard_codec.to_dict()["configuration"]
    kinds = [codec["name"] for codec in (*shard_options["codecs"], *shard_options["index_codecs"])]
    endian = {
        codec["configuration"]["endian"] for codec in (shard_options["codecs"][0], shard_options["index_codecs"][0])
    }
    form = (kinds, endian, shard_options["index_location"], array.fill_value, array.shards[1:], array.chunks[1:])
    if form != (["bytes", "zstd", "bytes", "crc32c"], {"little"}, "end", 0, array.shape[1:], array.shape[1:]):
        raise ValueError(f"packed in another way: {', '.join(kinds)}")


def _decode_rows(path: Path, array: Any, rows: slice) -> NDArray:
    """Return some rows of a store; those of chunks and shards that it lacks are zeros."""
    kind, (chunk_rows, *shape), shard_rows = array.dtype.newbyteorder("<"), array.chunks, array.shards[0]
    chunk_bytes = chunk_rows * math.prod(shape) * kind.itemsize
    files = {i: path / array.metadata.encode_chunk_key((i, *(0 for _ in shape))) for i in _blocks(rows, shard_rows)}
    shards = {i: file for i, file in files.items() if file.is_file()}
    stored_bytes = sum(file.stat().st_size for file in shards.values())
    require_bounded(path, len(_blocks(rows, chunk_rows)) * chunk_bytes, stored_bytes)
    result = np.zeros((rows.stop - rows.start, *shape), kind)
    for shard, file in shards.items():
        for number, chunk in _packed_chunks(file, shard_rows // chunk_rows, _blocks(rows, chunk_rows), shard):
            values = np.frombuffer(pa.Codec("zstd").decompress(chunk, chunk_bytes), kind).reshape(chunk_rows, *shape)
            first_row = max(number * chunk_rows, rows.start)
            stop_row = min((number + 1) * chunk_rows, rows.stop)
            result[first_row - rows.start : stop_row - rows.start] = values[
                first_row - number * chunk_rows : stop_row - number * chunk_rows
            ]
    return result.astype(array.dtype, copy=False)


def _packed_chunks(file: Path, count: int, chunk_numbers: range, shard: int) -> Iterator[tuple[int, bytes]]:
    """Yield number and compressed bytes of the wanted chunks that a shard of `count` holds.

    Source: Zarr v3, "Sharding codec": pairs of offset and size (uint64) at the end of the file, then their crc32c;
    both are 2^64 - 1 for a chunk that is not there.
    """
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(size - count * _PLACE.itemsize - _CRC_BYTES)
        places = np.frombuffer(stream.read(count * _PLACE.itemsize), _PLACE)
        for number, (begin, length) in enumerate(places.tolist(), shard * count):
            if number not in chunk_numbers or begin == length == _ABSENT:
                continue
            if begin + length > size:
                raise ValueError(f"a chunk ends at byte {begin + length} of {size}")
            stream.seek(begin)
            yield number, stream.read(length)


def _blocks(rows: slice, size: int) -> range:
    """Return the numbers of the blocks of `size` rows in which some rows lie."""
    return range(rows.start // size, -(-rows.stop // size))
