"""One evidence for all comparisons of sets of effects: log likelihood of held-out episodes, and a prior of the names.

An episode's loss counts as a log likelihood for as many independent blocks as null replays show it to hold: where
contact is chaos, its block means rise and fall together, and a recording of a thousand of them says as much as a few.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.candidates import Candidate
from candata.gap.robust import rho
from candata.gap.score import Score
from candata.gap.search import Members
from candata.statistics import resamples

Array = NDArray[np.float64]
#: Share of resampled sets of episodes in which a larger set must explain more to be taken: one of the two dials.
#: Source: the usual level of a one-sided test.
SURE = 0.95
#: Resamples of the episodes.
RESAMPLES = 2000


def independent_share(score: Score) -> float:
    """Return the share of an episode's block means that count as independent, 0 to 1, by its null replays.

    The variance of a mean of n equal, independent values is that of one of them over n (Kish 1965, "Survey Sampling",
    the design effect); null replays of an episode vary by more.
    """
    lost = np.where(score.mask, rho(score.null), 0.0)
    count = np.maximum(score.mask.sum(1), 1)
    means = lost.sum(-1, dtype=np.float64) / count
    if len(means) < 2:
        return 1.0
    square = (lost**2).sum(-1, dtype=np.float64) / count - means**2
    varies = float(means.var(axis=0, ddof=1).mean())
    return float(np.clip((square / count).mean() / max(varies, 1e-12), 0.0, 1.0))


def log_likelihood(score: Score, loss: Array) -> Array:
    """Return `(E,)` the log likelihood of episodes by their held-out losses [floors], up to a constant."""
    return -independent_share(score) * score.nats() * loss


def log_prior(members: Members, alternatives: int) -> float:
    """Return the log prior of a set of names, each one of so many (Scott & Berger 2010: a cost of multiplicity)."""
    return -len(members) * float(np.log(max(alternatives, 1)))


def odds(score: Score, losses: tuple[Array, Array], members: tuple[Members, Members], alternatives: int) -> Array:
    """Return `(RESAMPLES,)` the log odds of a second set against a first over resampled episodes.

    Parameters
    ----------
    score : Score
        In whose floors the losses are.
    losses : pair of (E,) float64
        Held-out losses of the first set and of the second.
    members : pair of Members
    alternatives : int
        Among how many effects each name was chosen.
    """
    gained = log_likelihood(score, losses[1]) - log_likelihood(score, losses[0])
    prior = log_prior(members[1], alternatives) - log_prior(members[0], alternatives)
    picks = resamples(np.random.default_rng(0), len(gained), RESAMPLES)
    return gained[picks].sum(1) + prior


def weights_of(score: Score, losses: Sequence[Array], sets: Sequence[Members], alternatives: int) -> Array:
    """Return `(S,)` the share of resampled sets of episodes in which each set has the highest posterior."""
    each = np.stack([log_likelihood(score, loss) for loss in losses])
    prior = np.array([log_prior(members, alternatives) for members in sets])
    picks = resamples(np.random.default_rng(0), each.shape[1], RESAMPLES)
    winner = (each[:, picks].sum(2) + prior[:, None]).argmax(0)
    return np.bincount(winner, minlength=len(sets)) / RESAMPLES


def names_key(members: Sequence[tuple[Candidate, Array]]) -> tuple[str, ...]:
    """Return what makes two sets the same: labels, and the value of each choice."""
    return tuple(sorted(c.label if not c.choices else f"{c.label}={u.tolist()}" for c, u in members))
