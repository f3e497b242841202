"""Dense channels: what is too wide for a table lies in one sharded Zarr v3 store a part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.datasets import durable
from candata.schema.channels import CHANNELS
from candata.schema.episode import Episode

#: Rows a chunk (what is decoded at once: about 1 s) and a shard (what is one file), and the level of zstd.
#: Source: measured on synthetic episodes with taxels, read per CPU-second and size (design of the storage).
CHUNK_ROWS, SHARD_ROWS, ZSTD_LEVEL = 75, 3000, 3
SUFFIX = ".zarr"


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

    Raises
    ------
    DataError
        When the store is missing, does not decode or has another shape; names it.
    """
    import zarr

    path = folder / f"{channel}{SUFFIX}"
    try:
        array: Any = zarr.open_array(path, mode="r")
        found = (array.dtype, array.shape[1:], array.shape[0] >= rows.stop)
        if found != (np.dtype(CHANNELS[channel].dtype), shape, True):
            raise ValueError(f"{array.dtype} {array.shape}")
        return np.ascontiguousarray(array[rows])
    except MemoryError:
        raise
    except Exception as error:  # a store's damage surfaces as whatever its codecs raise
        raise durable.damaged(path, durable.reason(error)) from None
