"""Scores of rows over episodes and seeds, and their intervals: both are resampled, the same draws for all rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.experiment.results import Value
from candata.statistics import resamples
from candata.training.metrics import SUCCESS_M
from candata.training.pairs import ENDS, LEAST_TRAJECTORIES, RESAMPLES
from candata.training.results import Evaluation

Array = NDArray[np.float64]
#: Gaps of ADD-S AUC below this are none: a share of one says nothing. Chosen: half a point.
LEAST_GAP = 0.005


@dataclass(frozen=True)
class RowScores:
    """Scores of one row.

    Attributes
    ----------
    adds_auc, success, mse : (S, E) float64
        By seed and episode; NaN where there is none.
    position_error_m, rotation_error_rad : float
        Closed-loop means over all rows and seeds.
    """

    adds_auc: Array
    success: Array
    mse: Array
    position_error_m: float
    rotation_error_rad: float


def row_scores(evaluations: Sequence[Evaluation], names: Sequence[str]) -> RowScores:
    """Return the scores of one row from its evaluations, one a seed; `names` are those of its forecaster in each."""
    by_episode = [sorted(each.by_episode, key=lambda scores: scores.id) for each in evaluations]
    pairs = list(zip(by_episode, names, strict=True))
    forecasters = [each.forecasters[name] for each, name in zip(evaluations, names, strict=True)]
    loops = [scores.closed_loop for scores in forecasters]
    return RowScores(
        adds_auc=np.array([[e.adds_auc.get(name, np.nan) for e in episodes] for episodes, name in pairs]),
        success=np.array([[e.final_position_error_m[name] <= SUCCESS_M for e in episodes] for episodes, name in pairs])
        * 1.0,
        mse=np.array([[e.increment_mse.get(name, np.nan) for e in episodes] for episodes, name in pairs]),
        position_error_m=float(np.mean([loop.position_error_m for loop in loops])),
        rotation_error_rad=float(np.mean([loop.rotation_error_rad for loop in loops])),
    )


class Resampling:
    """Draws of the test episodes of a column, the same for all its rows, and of seeds."""

    def __init__(self, episodes: int, seed: int = 0) -> None:
        """Draw episodes."""
        self.rng_seed, self.episodes = seed, episodes
        self.picks = resamples(np.random.default_rng([seed, 0]), episodes, RESAMPLES)

    @property
    def has_intervals(self) -> bool:
        """Whether there are episodes enough."""
        return self.episodes >= LEAST_TRAJECTORIES

    def means(self, scores: Array) -> Array:
        """Return `(RESAMPLES,)` means of scores `(S, E)` over resampled episodes and seeds."""
        by_draw = scores[:, self.picks].mean(-1)
        seeds = resamples(np.random.default_rng([self.rng_seed, len(scores)]), len(scores), RESAMPLES)
        return np.asarray(by_draw[seeds, np.arange(RESAMPLES)[:, None]].mean(1))

    def value(self, scores: Array) -> Value:
        """Return the mean of scores with its interval."""
        mean = float(scores.mean())
        return self.with_interval(mean, self.means(scores) if np.isfinite(mean) else None)

    def with_interval(self, value: float, draws: Array | None) -> Value:
        """Return a value with the interval of its draws; None for NaN, and no interval over too few episodes."""
        if not np.isfinite(value):
            return Value(value=None)
        if draws is None or not self.has_intervals:
            return Value(value=value)
        low, high = np.quantile(draws, ENDS)
        return Value(value=value, low=float(low), high=float(high))

    def difference(self, scores: Array, reference: Array) -> Value:
        """Return the mean of scores less that of a reference, in pairs of episodes."""
        draws = self.means(scores) - self.means(reference)
        return self.with_interval(float(scores.mean() - reference.mean()), draws)

    def closed(self, scores: Array, nominal: Array, floor: Array | None) -> Value:
        """Return the share that scores close of the gap from the nominal simulator's to the floor's, or to 1.

        None where there is no gap: it is too small, or too small lies within its own interval.
        """
        top = np.ones((1, self.episodes)) if floor is None else floor
        gap, gaps = float(top.mean() - nominal.mean()), self.means(top) - self.means(nominal)
        if not gap > LEAST_GAP or (self.has_intervals and np.quantile(gaps, ENDS[0]) < LEAST_GAP):
            return Value(value=None)
        is_gap = gaps >= LEAST_GAP
        shares = (self.means(scores) - self.means(nominal))[is_gap] / gaps[is_gap]
        value = float((scores.mean() - nominal.mean()) / gap)
        return self.with_interval(value, shares if np.isfinite(shares).all() else None)


def excess(scores: RowScores, floor: RowScores | None) -> float | None:
    """Return the closed-loop error over that of the floor: the mean over position and rotation, 1 at the floor.

    As `candata.gap.measure.score.Score.size` has it for a diagnosis: a ratio for each quantity, then the mean over
    quantities.
    """
    if floor is None:
        return None
    ratios = (
        scores.position_error_m / max(floor.position_error_m, 1e-9),
        scores.rotation_error_rad / max(floor.rotation_error_rad, 1e-9),
    )
    return float(np.mean(ratios))
