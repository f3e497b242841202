"""Comparing fits: which are tied, which so near that only a sharper look tells, and how sure a mean is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import Candidate, elements_of
from candata.gap.fit.fits import Fit
from candata.gap.measure.score import Score
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Share of the best gain above which another effect's fit is sharpened too before the two are compared, and how many.
NEAR, RIVALS = 0.85, 2
#: Standard errors of the paired difference within which it is sharpened as well, however much less it gains.
UNSURE = 2.0
#: The same of a rival that leaves as little as a true cause may: with more the best one has nine chances in ten.
#: Record 43.
BELOW = 1.28
#: Share of the best gain up to which a difference between two fits is no evidence: of aliases the one that was fitted a
#: little sharper wins, in every episode alike. Chosen: of five blind cases between damping of servos and of joints,
#: the wrong one came first by 0.08, 0.13 (named with support 0.88) and 0.8 %, the right one by 1.4 and 3.7 %.
BLUNT = 0.01
#: Share of null recordings that lie below the level from which there is a gap. Chosen: of 300 nulls none or one is
#: called a gap by chance.
NULL_QUANTILE = 0.998


def tied_with(best: Fit, fits: Sequence[Fit], reachable: float = 0.0) -> list[Fit]:
    """Return the fits whose held-out loss is within one standard error of the best one's (Breiman et al. 1984).

    The error is that of the paired difference over episodes. What lies below the loss that true worlds reach could be
    true, and is tied within `BELOW` errors. The same effect on fewer or more elements is no rival.
    """
    rivals = [f for f in fits if f.members[0][0].name != best.members[0][0].name]
    return [best, *(f for f in rivals if is_tied(f, best, BELOW if f.evidence.loss.mean() <= reachable else 1.0))]


def is_near(fit: Fit, best: Fit) -> bool:
    """Tell whether a fit comes so near the best that only a sharper look can tell which is better."""
    return fit.gain > NEAR * best.gain or (best.gain > 0 and is_tied(fit, best, UNSURE))


def is_tied(fit: Fit, best: Fit, errors: float = 1.0) -> bool:
    """Tell whether a fit is no worse than the best by more than so many standard errors, or than fits are sharp."""
    worse = fit.evidence.loss - best.evidence.loss
    return bool(worse.mean() <= max(errors * standard_error(worse), BLUNT * best.gain))


def is_elsewhere(c: Candidate, best: Candidate, scene: Scene) -> bool:
    """Tell whether a candidate is another effect, or the same one on other elements."""
    if c.name != best.name:
        return True
    one_each = c.element is not None and best.element is not None
    return one_each and not set(elements_of(c, scene)) & set(elements_of(best, scene))


def standard_error(values: Array) -> float:
    """Return the standard error of the mean of independent episodes."""
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def error_within(values: Array, tasks: Sequence[str]) -> float:
    """Return the standard error of the mean of episodes `(E,)` of these very tasks, as of a stratified sample.

    Each task's own mean varies by its own episodes (Cochran 1977, theorem 5.3); of fewer than two nothing is known, and
    then the episodes count as if drawn from all tasks.
    """
    groups = [values[[i for i, own in enumerate(tasks) if own == task]] for task in sorted(set(tasks))]
    if min(map(len, groups), default=0) < 2:
        return standard_error(values)
    return float(np.sqrt(sum(len(g) * g.var(ddof=1) for g in groups)) / len(values))


def null_level(score: Score, quantile: float = NULL_QUANTILE) -> float:
    """Return the quantile of the mean loss of null sets, in floors."""
    return float(np.quantile(score.null_means, quantile))
