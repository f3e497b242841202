"""The simulator's forecasts of all windows that train: made once in chunks, kept as a memory-mapped file.

The file is derived: made again where it is missing or damaged, and its folder may be deleted at any time. A run that
was killed while it was made goes on with the next chunk.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata import __version__
from candata.datasets.writing import replacing
from candata.errors import SetupError
from candata.loaders import MixedWindows, SimulatedWindows, Windows
from candata.training.simulator import Simulator
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


def thinned(feed: Windows | MixedWindows) -> Windows | MixedWindows:
    """Return the windows that are simulated: every row begins one, or fewer where that would be too many."""
    if isinstance(feed, MixedWindows):
        return replace(feed, sources=tuple(_thinned(source) for source in feed.sources))
    return _thinned(feed)


def rows_apart(count: int, stride: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many rows lie between the windows that are simulated.

    Parameters
    ----------
    count : int
        Windows of which every row of the episodes begins one.
    stride : (n,) int64
        Rows a model step.
    """
    return np.minimum(-(-count // DENSE_WINDOWS), stride)


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
    first_share: float = 0.0,
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
    first_share : float
        Where among the chunks to begin: processes that begin apart share the work.

    Raises
    ------
    SetupError
        When they cannot be written.
    """
    sources = feed.sources if isinstance(feed, MixedWindows) else (feed,)
    home = user_cache() if folder is None else folder
    return SimulatedWindows(
        feed, tuple(_forecasts(source, build(source), home, progress, first_share) for source in sources)
    )


def _forecasts(
    feed: Windows, forecaster: Simulator, home: Path, progress: Progress, first_share: float
) -> NDArray[np.float32]:
    """Return the forecasts `(n, H, 8)` of all windows, memory-mapped."""
    target = _Kept(home, f"simulated-{_key(feed, forecaster)}", (len(feed), feed.horizon, WIDTH))
    standing = target.read()
    while standing is None:
        folder = home / f"{target.name}-chunks"
        chunks = [
            _Kept(folder, f"{number:05d}", (min(CHUNK, len(feed) - first), feed.horizon, WIDTH))
            for number, first in enumerate(range(0, len(feed), CHUNK))
        ]
        begin = round(first_share * len(chunks))
        for done_count, number in enumerate([*range(begin, len(chunks)), *range(begin)], 1):
            if chunks[number].read() is None and target.read() is None:
                values = _simulated(feed, forecaster, number * CHUNK, chunks[number].shape[0])
                try:
                    chunks[number].write(values)
                except SetupError:
                    if target.read() is None:  # else another process has joined the chunks meanwhile
                        raise
            progress(min(done_count * CHUNK, len(feed)), len(feed))
        parts = [chunk.read() for chunk in chunks]
        if all(part is not None for part in parts):
            target.write(np.concatenate([part for part in parts if part is not None]))
        # Where a chunk has gone, another process has joined them.
        standing = target.read()
        shutil.rmtree(folder, ignore_errors=True)
    return standing


def _simulated(feed: Windows, forecaster: Simulator, first: int, count: int) -> NDArray[np.float32]:
    """Return the forecasts `(count, H, 8)` of windows from number `first` on."""
    simulated = forecaster.simulate(feed.batch(np.arange(first, first + count)))
    return np.concatenate([simulated.object_pose, simulated.contact[..., None]], axis=-1).astype(np.float32)


@dataclass(frozen=True)
class _Kept:
    """An array on disk under a name, its check sum in the file's own; whole or not there.

    Attributes
    ----------
    folder : Path
        Where it lies.
    name : str
        What it is called.
    shape : tuple of int
        Its shape.
    """

    folder: Path
    name: str
    shape: tuple[int, ...]

    def read(self) -> NDArray[np.float32] | None:
        """Return the array, memory-mapped; None where there is none that is what was written."""
        for path in self.folder.glob(f"{self.name}-*.npy"):
            try:
                values = np.load(path, mmap_mode="r", allow_pickle=False)
            except (OSError, ValueError):
                continue
            if values.shape == self.shape and values.dtype == np.float32 and path.name == self._file_name(values):
                return np.asarray(values)
        return None

    def write(self, values: NDArray[np.float32]) -> None:
        """Write the array; damaged ones of its name go.

        Raises
        ------
        SetupError
            When it cannot be written.
        """
        path = self.folder / self._file_name(values)
        others = set(self.folder.glob(f"{self.name}-*.npy")) - {path}
        with replacing(path, "simulator's forecasts") as draft:
            np.save(draft, values, allow_pickle=False)
        for other in others:
            other.unlink(missing_ok=True)

    def _file_name(self, values: NDArray[np.float32]) -> str:
        """Return the name of the file that holds these values."""
        return f"{self.name}-{zlib.crc32(np.ascontiguousarray(values).view(np.uint8).data):08x}.npy"


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
    every = rows_apart(len(source), source.stride[source.owner])
    kept = (source.present_row - source.cache.begin[source.owner]) % every == 0
    return replace(source, present_row=source.present_row[kept], owner=source.owner[kept])


def _evenly(source: Windows, count: int) -> Windows:
    """Return `count` windows at most, evenly spread."""
    numbers = np.linspace(0, len(source) - 1, min(count, len(source))).round().astype(np.int64)
    return replace(source, present_row=source.present_row[numbers], owner=source.owner[numbers])
