"""Forecasters against each other: areas under the curve on resampled episodes, in pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from candata.statistics import resamples
from candata.training.results import Interval, Pair

Array = NDArray[np.float64]

#: Resamples of the episodes for an interval, and how many are held in memory at once.
RESAMPLES, CHUNK = 2000, 100
#: Ends of a 95 % interval.
ENDS = (0.025, 0.975)
#: Episodes below which resampling them says nothing of how another draw would come out, as in a diagnosis.
LEAST_EPISODES = 8
#: Test episodes below which a table gives no intervals. Source: the project's specification of evaluations; of 30
#: episodes the Wilson interval of a share is up to 34 points wide.
LEAST_TRAJECTORIES = 30


@dataclass(frozen=True)
class ResampledAreas:
    """Areas under the curve of all forecasters, as recorded and on the same resampled episodes.

    Attributes
    ----------
    value : dict of str to float
        As recorded.
    draws : dict of str to (RESAMPLES,) float64, or None
        On resampled episodes; None for fewer than `LEAST_EPISODES`.
    """

    value: dict[str, float]
    draws: dict[str, Array] | None

    def interval(self, name: str) -> Interval | None:
        """Return the interval of a forecaster's own area."""
        return None if self.draws is None else _ends(self.draws[name])

    def pairs(self) -> tuple[Pair, ...]:
        """Return the difference of each two forecasters, the first less the later one."""
        return tuple(self._pair(*names) for names in combinations(self.value, 2))

    def _pair(self, forecaster: str, reference: str) -> Pair:
        """Return the difference of two forecasters."""
        low, high = (None, None) if self.draws is None else _ends(self.draws[forecaster] - self.draws[reference])
        value = self.value[forecaster] - self.value[reference]
        return Pair(forecaster=forecaster, reference=reference, value=value, low=low, high=high)


def resampled_areas(areas: Mapping[str, Array], counts: NDArray[np.int64], seed: int) -> ResampledAreas:
    """Return the areas of all forecasters on the same resampled episodes.

    Parameters
    ----------
    areas : mapping of str to (E,) float64
        Sum over an episode's rows of what each adds to the area, by forecaster.
    counts : (E,) int64
        Rows of each episode.
    seed : int
        Seed of the draws.
    """
    names, table = list(areas), np.stack([*areas.values(), counts.astype(np.float64)], axis=1)
    sums = table.sum(axis=0)
    value = dict(zip(names, (sums[:-1] / sums[-1]).tolist(), strict=True))
    if len(counts) < LEAST_EPISODES:
        return ResampledAreas(value, None)
    rng = np.random.default_rng([seed, 3])
    drawn = np.concatenate([_times_drawn(rng, len(counts)) @ table for _ in range(RESAMPLES // CHUNK)])
    return ResampledAreas(value, dict(zip(names, (drawn[:, :-1] / drawn[:, -1:]).T, strict=True)))


def _times_drawn(rng: np.random.Generator, count: int) -> Array:
    """Return `(CHUNK, count)`: how often each episode is in each of some bootstrap samples."""
    picks = resamples(rng, count, CHUNK) + count * np.arange(CHUNK)[:, None]
    return np.bincount(picks.ravel(), minlength=CHUNK * count).reshape(CHUNK, count).astype(np.float64)


def _ends(values: Array) -> Interval:
    """Return the ends of the interval that holds 95 % of the values."""
    low, high = np.quantile(values, ENDS)
    return float(low), float(high)
