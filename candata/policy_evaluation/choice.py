"""One chunk chosen of many, or an abstention."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.policy_evaluation.cost import ChunkCost

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Reason = Literal["outside", "unsure"]
#: Weight of the samples' spread in the score of a chunk, in standard deviations. Source: a penalty of about one
#: deviation of the ensemble, as in T. Yu et al., "MOPO: model-based offline policy optimization", arXiv 2005.13239,
#: section 4.3.
SPREAD_WEIGHT = 1.0
#: Spread of the best chunk's cost over what it gains on random choice at which nothing is chosen. Chosen: the gain is
#: one standard deviation.
MOST_SPREAD_PER_GAIN = 1.0
#: Share of a chunk's samples that must reach the goal for it to be chosen whatever it gains. Chosen: nine of ten.
SURE_SHARE = 0.9


class Choice(NamedTuple):
    """What was chosen at a start.

    Attributes
    ----------
    candidate : int or None
        Number of the chunk; None for an abstention.
    reason : str or None
        Why nothing was chosen: every candidate lies `outside` what was seen, or the forecaster is `unsure`.
    gain : float
        Mean cost of the candidates that may be chosen, less that of the best.
    spread : float
        Standard deviation of the best one's cost over the samples.
    reached : float
        Share of its samples that reach the goal.
    """

    candidate: int | None
    reason: Reason | None
    gain: float
    spread: float
    reached: float


def choose(cost: ChunkCost, allowed: Flags) -> tuple[Choice, ...]:
    """Return the choice of each start.

    Parameters
    ----------
    cost : ChunkCost
        Of forecasts `(M, S, N)`.
    allowed : (S, N) bool
        Which chunks may be chosen: those within what the forecaster has seen.
    """
    return tuple(_choose(cost.cost[:, s], cost.reached[:, s], allowed[s]) for s in range(len(allowed)))


def _choose(cost: Array, reached: Flags, allowed: Flags) -> Choice:
    """Return the choice among chunks of costs `(M, N)`."""
    mean, spread = cost.mean(0), cost.std(0)
    usable = allowed & np.isfinite(mean)
    if not usable.any():
        return Choice(None, "outside", 0.0, 0.0, 0.0)
    best = int(np.where(usable, mean + SPREAD_WEIGHT * spread, np.inf).argmin())
    gain, share = float(mean[usable].mean() - mean[best]), float(reached[:, best].mean())
    is_sure = spread[best] <= MOST_SPREAD_PER_GAIN * gain or share >= SURE_SHARE
    facts = gain, float(spread[best]), share
    return Choice(best, None, *facts) if is_sure else Choice(None, "unsure", *facts)
