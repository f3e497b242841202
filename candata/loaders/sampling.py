"""Which windows a step takes: a pure function of (seed, step, rank), so that resuming is a number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError


@dataclass(frozen=True)
class Sampler:
    """Batches of window numbers, without replacement within an epoch.

    The windows of all epochs are one endless line: epoch e is a permutation keyed by (seed, e). Step s
    takes the next `batch_size * world` of the line, of which rank r has the r-th part. Nothing is dropped: a batch
    may hold the end of one epoch and the beginning of the next.

    Attributes
    ----------
    count : int
        Windows in all.
    batch_size : int
        Windows a step and rank.
    seed : int
        From 0 to 2^64 - 1.
    rank, world : int
        Number of this process, and how many there are.

    Raises
    ------
    UsageError
        When a number is out of range.
    """

    count: int
    batch_size: int
    seed: int = 0
    rank: int = 0
    world: int = 1

    def __post_init__(self) -> None:
        """Check the numbers."""
        if min(self.count, self.batch_size, self.world) < 1:
            found = f"count {self.count}, batch_size {self.batch_size}, world {self.world}"
            raise UsageError("sampling needs at least one window, batch and process", found=found)
        if not (0 <= self.rank < self.world and 0 <= self.seed < 2**64):
            raise UsageError(
                "rank or seed out of range",
                expected=f"0 <= rank < {self.world}, 0 <= seed < 2^64",
                found=f"rank {self.rank}, seed {self.seed}",
            )

    def indices(self, step: int) -> NDArray[np.int64]:
        """Return `(batch_size,) int64`: the windows of step `step`, the first being 0."""
        first = (step * self.world + self.rank) * self.batch_size
        place = np.arange(first, first + self.batch_size)
        epoch, position = np.divmod(place, self.count)
        picked = np.empty(self.batch_size, np.int64)
        for number in np.unique(epoch):
            here = epoch == number
            picked[here] = _permutation(self.seed, int(number), self.count)[position[here]]
        return picked

    @property
    def steps_per_epoch(self) -> float:
        """Steps in which each window is met once."""
        return self.count / (self.batch_size * self.world)


@lru_cache(maxsize=2)
def _permutation(seed: int, epoch: int, count: int) -> NDArray[np.int64]:
    """Return a permutation of `count`, from the raw counter-based stream: fixed across versions of numpy.

    Source: J. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011 (Philox). numpy promises its
    bit generators' raw streams (NEP 19), not `Generator.permutation`.
    """
    key = np.array([seed, epoch], np.uint64)
    order: NDArray[np.int64] = np.argsort(np.random.Philox(key=key).random_raw(count), kind="stable")
    order.flags.writeable = False
    return order
