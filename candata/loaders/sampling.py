"""The windows that a step takes: a pure function of (seed, step, rank), so that resuming is a number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError

Numbers = NDArray[np.int64]

#: Second word of the key of noise; permutations have the number of their epoch there, and of their source above it.
_NOISE = 2**64 - 1
#: Place of the source in that word: epochs stay below.
_SOURCE_BIT = 48


@dataclass(frozen=True)
class Sampler:
    """Batches of window numbers, without replacement within an epoch of each source.

    The windows of all epochs of a source are one endless line: epoch e is a permutation keyed by (seed, source, e). The
    places of a run are one line too, each of one source, by a fixed pattern in which every source has its share. Step s
    takes the next `batch_size * world` places, of which rank r has the r-th part. Nothing is dropped: a batch
    may hold the end of one epoch and the beginning of the next.

    Attributes
    ----------
    counts : tuple of int
        Windows of each source; their numbers stand one behind the other.
    batch_size : int
        Windows a step and rank.
    seed : int
        From 0 to 2^64 - 1.
    rank, world : int
        Number of this process, and how many there are.
    parts : tuple of int
        Shares of the sources, as whole numbers: source i has `parts[i]` of every `sum(parts)` places.

    Raises
    ------
    UsageError
        When a number is out of range.
    """

    counts: tuple[int, ...]
    batch_size: int
    seed: int = 0
    rank: int = 0
    world: int = 1
    parts: tuple[int, ...] = (1,)

    def __post_init__(self) -> None:
        """Check the numbers."""
        if min(*self.counts, *self.parts, self.batch_size, self.world) < 1 or len(self.counts) != len(self.parts):
            values_text = f"counts {self.counts}, parts {self.parts}, batch_size {self.batch_size}, world {self.world}"
            raise UsageError("sampling needs at least one window a source, batch and process", found=values_text)
        if not (0 <= self.rank < self.world and 0 <= self.seed < 2**64):
            raise UsageError(
                "rank or seed out of range",
                expected=f"0 <= rank < {self.world}, 0 <= seed < 2^64",
                found=f"rank {self.rank}, seed {self.seed}",
            )

    def indices(self, step: int) -> Numbers:
        """Return `(batch_size,) int64`: the windows of step `step`, the first being 0."""
        first_place = (step * self.world + self.rank) * self.batch_size
        places = np.arange(first_place, first_place + self.batch_size)
        if len(self.counts) == 1:
            return self._lines[0].at(places)
        source, nth = pattern(self.parts)
        period, spot = np.divmod(places, len(source))
        windows, offset = np.empty(self.batch_size, np.int64), 0
        for number, (count, part) in enumerate(zip(self.counts, self.parts, strict=True)):
            in_source = source[spot] == number
            windows[in_source] = offset + self._lines[number].at(period[in_source] * part + nth[spot[in_source]])
            offset += count
        return windows

    def steps(self, first_step: int, stop_step: int) -> Steps:
        """Return the batches of steps `first_step` to `behind - 1` as a DataLoader takes them: `batch_sampler=`."""
        return Steps(self, first_step, stop_step)

    def draw_counts(self, steps: int) -> tuple[int, ...]:
        """Return how many windows of each source all ranks together take in the first `steps` steps."""
        source, _ = pattern(self.parts)
        period, rest = divmod(steps * self.world * self.batch_size, len(source))
        return tuple(period * part + int((source[:rest] == number).sum()) for number, part in enumerate(self.parts))

    @cached_property
    def _lines(self) -> tuple[_Line, ...]:
        """The endless line of each source."""
        return tuple(_Line(count, self.seed, number) for number, count in enumerate(self.counts))


@dataclass(frozen=True)
class Steps:
    """Batches of window numbers of a range of steps: the `batch_sampler` of a DataLoader, read as often as wanted."""

    sampler: Sampler
    first_step: int
    stop_step: int

    def __len__(self) -> int:
        """Return the number of steps."""
        return max(0, self.stop_step - self.first_step)

    def __iter__(self) -> Iterator[Numbers]:
        """Yield the windows of each step."""
        return (self.sampler.indices(step) for step in range(self.first_step, self.stop_step))


@dataclass(frozen=True)
class _Line:
    """The windows of one source, permutation after permutation; the last one is kept."""

    count: int
    seed: int
    source: int
    order_by_epoch: dict[int, Numbers] = field(default_factory=dict, repr=False, compare=False)

    def at(self, places: Numbers) -> Numbers:
        """Return the windows at these places of the line."""
        epoch, position = np.divmod(places, self.count)
        windows = np.empty(len(places), np.int64)
        for number in np.unique(epoch):
            in_epoch = epoch == number
            windows[in_epoch] = self._epoch(int(number))[position[in_epoch]]
        return windows

    def _epoch(self, number: int) -> Numbers:
        """Return a permutation, from the raw counter-based stream: fixed across versions of numpy.

        Source: J. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011 (Philox). numpy promises its
        bit generators' raw streams (NEP 19), not `Generator.permutation`.
        """
        order = self.order_by_epoch.get(number)
        if order is None:
            key = np.array([self.seed, (self.source << _SOURCE_BIT) + number], np.uint64)
            order = np.argsort(np.random.Philox(key=key).random_raw(self.count), kind="stable")
            self.order_by_epoch.clear()
            self.order_by_epoch[number] = order
        return order


@lru_cache(maxsize=8)
def pattern(parts: tuple[int, ...]) -> tuple[Numbers, Numbers]:
    """Return the source of each of `sum(parts)` places, and how many places before it are of the same source.

    Each place goes to the source that is furthest behind its share, the first of equal ones, so that any stretch of
    places holds the shares nearly, and a whole period holds them exactly.
    """
    total, draw_counts = sum(parts), [0] * len(parts)
    source, nth = np.empty(total, np.int64), np.empty(total, np.int64)
    for place in range(total):
        deficits = [
            (place + 1) * part - total * draw_count for part, draw_count in zip(parts, draw_counts, strict=True)
        ]
        source_number = deficits.index(max(deficits))
        source[place], nth[place] = source_number, draw_counts[source_number]
        draw_counts[source_number] += 1
    return source, nth


def noise(seed: int, step: int, rank: int = 0) -> np.random.Generator:
    """Return the generator of the noise of a step, for `augment`; no stream of a permutation.

    Its numbers follow from (seed, step, rank) for one version of numpy, which does not promise them across versions.
    """
    key, counter = np.array([seed, _NOISE], np.uint64), np.array([0, 0, rank, step], np.uint64)
    return np.random.Generator(np.random.Philox(counter=counter, key=key))
