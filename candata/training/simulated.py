"""The simulator's forecasts of all windows that train: made once in chunks, kept as a memory-mapped file.

The file is derived: made again where it is missing or damaged, and its folder may be deleted at any time. A run that
was killed while it was made goes on with the next chunk.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata import __version__
from candata.datasets.writing import replacing
from candata.errors import SetupError
from candata.loaders import MixedWindows, Windows
from candata.loaders.sampling import Sampler
from candata.training.simulator import Simulator, simulated_keys
from candata.user_folders import user_cache

#: Raised when the bytes of the files, or what they mean, change.
LAYOUT_VERSION = 1
#: Windows a chunk: a quarter of a minute of simulation on one core.
CHUNK = 512
#: Windows up to which every row of the episodes begins one; of longer data fewer rows do, down to one a model step.
#: Chosen: five minutes of simulation on one core.
DENSE_WINDOWS = 8192
#: Numbers kept of each step: the pose, and whether the hand touches.
WIDTH = 8

#: Called with (windows done, windows in all).
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class SimulatedWindows:
    """Windows whose batches also hold `simulated/object_pose (B, H, 7)` and `simulated/contact (B, H)`, float32.

    Attributes
    ----------
    windows : Windows or MixedWindows
        All else of the batches.
    forecasts : tuple of (n, H, 8) float32
        The simulator's forecasts of the windows of each source.
    """

    windows: Windows | MixedWindows
    forecasts: tuple[NDArray[np.float32], ...]

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.windows)

    @property
    def clouds(self) -> NDArray[np.float32]:
        """Point clouds of the windows."""
        return self.windows.clouds

    def sampler(self, batch_size: int, seed: int = 0, rank: int = 0, world: int = 1) -> Sampler:
        """Return the sampler of the windows."""
        return self.windows.sampler(batch_size, seed, rank, world)

    def batch(self, numbers: ArrayLike) -> dict[str, Any]:
        """Return the windows with these numbers, and what the simulator made of them."""
        index = np.asarray(numbers, np.int64)
        begin = np.cumsum([0, *map(len, self.forecasts)])
        source = begin.searchsorted(index, "right") - 1
        values = np.empty((len(index), *self.forecasts[0].shape[1:]), np.float32)
        for number, forecasts in enumerate(self.forecasts):
            members = source == number
            values[members] = forecasts[index[members] - begin[number]]
        return self.windows.batch(numbers) | simulated_keys(values[..., :7], values[..., 7])

    def resident(self, device: str) -> NoReturn:
        """Refuse: forecasts stay on the host.

        Raises
        ------
        SetupError
            Always.
        """
        raise SetupError("the simulator's forecasts are kept on the host", found=device)


def thinned(feed: Windows | MixedWindows) -> Windows | MixedWindows:
    """Return the windows that are simulated: every row begins one, or fewer where that would be too many."""
    if isinstance(feed, MixedWindows):
        return replace(feed, sources=tuple(_thinned(source) for source in feed.sources))
    return _thinned(feed)


def evenly_chosen(feed: Windows | MixedWindows, count: int) -> Windows | MixedWindows:
    """Return `count` windows at most of each source, evenly spread."""
    if isinstance(feed, MixedWindows):
        return replace(feed, sources=tuple(_evenly(source, count) for source in feed.sources))
    return _evenly(feed, count)


def simulated_windows(
    feed: Windows | MixedWindows,
    build: Callable[[Windows], Simulator],
    progress: Progress = lambda _done, _total: None,
    folder: Path | None = None,
) -> SimulatedWindows:
    """Return the windows with the simulator's forecasts, made now where they are not kept.

    Parameters
    ----------
    feed : Windows or MixedWindows
        What is to be forecast.
    build : callable
        `windows -> simulator` of one source.
    progress : callable
        Called with (windows done, windows in all) of each source while it is simulated.
    folder : Path, optional
        Where forecasts are kept; the user's cache folder by default.

    Raises
    ------
    SetupError
        When they cannot be written.
    """
    sources = feed.sources if isinstance(feed, MixedWindows) else (feed,)
    home = user_cache() if folder is None else folder
    return SimulatedWindows(feed, tuple(_forecasts(source, build(source), home, progress) for source in sources))


def _forecasts(feed: Windows, forecaster: Simulator, home: Path, progress: Progress) -> NDArray[np.float32]:
    """Return the forecasts `(n, H, 8)` of all windows, memory-mapped."""
    name, shape = f"simulated-{_key(feed, forecaster)}", (len(feed), feed.horizon, WIDTH)
    standing = _checked(home, name, shape)
    if standing is None:
        chunks = home / f"{name}-chunks"
        for done_count in _make_chunks(feed, forecaster, chunks):
            progress(done_count, len(feed))
        _join(home, name, chunks, shape)
        shutil.rmtree(chunks, ignore_errors=True)
        standing = _checked(home, name, shape)
    if standing is None:
        raise SetupError("the simulator's forecasts were damaged while they were written", found=str(home / name))
    return standing


def _make_chunks(feed: Windows, forecaster: Simulator, folder: Path) -> Iterator[int]:
    """Make the chunks that are not there, and yield how many windows are done after each."""
    for number, first in enumerate(range(0, len(feed), CHUNK)):
        members = np.arange(first, min(first + CHUNK, len(feed)))
        name, shape = f"{number:05d}", (len(members), feed.horizon, WIDTH)
        if _checked(folder, name, shape) is None:
            simulated = forecaster.simulate(feed.batch(members))
            values = np.concatenate([simulated.object_pose, simulated.contact[..., None]], axis=-1)
            _save(folder, name, values.astype(np.float32))
        yield int(members[-1]) + 1


def _join(home: Path, name: str, chunks: Path, shape: tuple[int, ...]) -> None:
    """Write all chunks as one file."""
    joined = np.empty(shape, np.float32)
    for number, first in enumerate(range(0, len(joined), CHUNK)):
        part = joined[first : first + CHUNK]
        chunk = _checked(chunks, f"{number:05d}", part.shape)
        if chunk is None:
            raise SetupError("a chunk of the simulator's forecasts has gone", found=str(chunks), fix="run this again")
        part[:] = chunk
    _save(home, name, joined)


def _save(folder: Path, name: str, values: NDArray[np.float32]) -> None:
    """Write an array whole or not at all, its check sum in the file's name; damaged ones of the name go."""
    damaged = list(folder.glob(f"{name}-*.npy")) if folder.is_dir() else []
    with replacing(folder / f"{name}-{_crc(values):08x}.npy", "simulator's forecasts") as draft:
        np.save(draft, values, allow_pickle=False)
    for path in damaged:
        if path.name != f"{name}-{_crc(values):08x}.npy":
            path.unlink(missing_ok=True)


def _checked(folder: Path, name: str, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    """Return the array of a name, memory-mapped; None where there is none that is what was written."""
    for path in folder.glob(f"{name}-*.npy"):
        try:
            values = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError):
            continue
        if values.shape == shape and values.dtype == np.float32 and path.stem == f"{name}-{_crc(values):08x}":
            return np.asarray(values)
    return None


def _crc(values: NDArray[np.float32]) -> int:
    """Return the check sum of an array's bytes."""
    return zlib.crc32(np.ascontiguousarray(values).view(np.uint8).data)


def _key(feed: Windows, forecaster: Simulator) -> str:
    """Return what names forecasts: the windows, the scenes with their effects, and the versions that simulate."""
    arrays = (feed.present_row, feed.owner, feed.stride, forecaster.scenes.number)
    facts = [
        *(LAYOUT_VERSION, __version__, mujoco.__version__),
        *(feed.dataset.digest, feed.dataset.ids, feed.channels, feed.history, feed.horizon),
        [hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest() for values in arrays],
        list(forecaster.scenes.digests.values()),
    ]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:24]


def _thinned(source: Windows) -> Windows:
    """Return the windows of every few rows of the episodes, at least one a model step."""
    every = np.minimum(-(-len(source) // DENSE_WINDOWS), source.stride[source.owner])
    kept = (source.present_row - source.cache.begin[source.owner]) % every == 0
    return replace(source, present_row=source.present_row[kept], owner=source.owner[kept])


def _evenly(source: Windows, count: int) -> Windows:
    """Return `count` windows at most, evenly spread."""
    numbers = np.linspace(0, len(source) - 1, min(count, len(source))).round().astype(np.int64)
    return replace(source, present_row=source.present_row[numbers], owner=source.owner[numbers])
