"""The one rule by which a set of effects takes another's place, and what a set leaves unexplained."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.comparison import BLUNT, error_within, null_level, standard_error
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.problem import Problem

Array = NDArray[np.float64]
#: Most effects of a set that are searched for, beside those that were measured without a fit. Chosen.
LARGEST = 3
#: Share of the gain so far that each further name must add. Chosen.
EXTRA = 0.05
#: Floors from which what is left is worth a search for pairs or a force: contact alone leaves a tenth or two behind a
#: right cause. Chosen.
LEFT = 0.2
#: Share of what is left, where that is more than `LEFT`, that each further name must take; and floors of what is left
#: that count for that, at most, so that 0.15 floors are worth a name however much no effect explains. Chosen.
TAKEN, MUCH = 0.25, 0.6
#: A name that adds less is worth it if it ends the search: it takes this share of what is left, at least so many
#: floors, and so many standard errors. Chosen.
MOST, FAINT, SURER = 0.5, 0.05, 3.0


def left_by(best: Fit) -> float:
    """Return what a fit leaves above the floor, in floors."""
    return float(best.evidence.loss.mean()) - 1


def leaves(problem: Problem, fit: Fit) -> bool:
    """Tell whether the held-out loss of a fit lies above the nulls of its world."""
    return bool(fit.evidence.loss.mean() > null_level(problem.score))


def is_better(best: Fit, fit: Fit, tasks: Sequence[str]) -> bool:
    """Tell whether a set takes another's place, both in units of the same floor.

    One with more names does if it is worth them, one with fewer if the names that it lacks are not worth it. One with
    as many does if it explains more by more than a standard error of the difference and than fits are sharp.

    Parameters
    ----------
    best, fit : Fit
        The set that stands, and the one that challenges it.
    tasks : sequence of str
        Task of each episode.
    """
    more = len(fit.members) - len(best.members)
    if more > 0:
        return _is_worth(best, fit, tasks, more)
    if more < 0:
        return not _is_worth(fit, best, tasks, -more)
    gained = best.evidence.loss - fit.evidence.loss
    return bool(gained.mean() > max(standard_error(gained), BLUNT * best.gain))


def _is_worth(best: Fit, fit: Fit, tasks: Sequence[str], names: int) -> bool:
    """Tell whether a set gains what so many more names must, and not by one episode.

    A loss below the floor is luck and counts for nothing.
    """
    luck = max(1.0 - float(fit.evidence.loss.mean()), 0.0)
    extra = (best.evidence.loss - fit.evidence.loss - luck) / names
    mean, others = float(extra.mean()), float(np.delete(extra, np.argmax(extra)).mean())
    left = left_by(best)
    share = TAKEN * min(max(left / names, 0.0), MUCH) if left > LEFT else 0.0
    if mean > max(standard_error(extra), EXTRA * best.gain, share) and others > EXTRA * best.gain / 2:
        return True
    ends = max(FAINT, MOST * left / names)
    return mean > max(ends, SURER * error_within(extra, tasks)) and others > ends / 2


def is_full(members: Members, measured: Members) -> bool:
    """Tell whether a set holds as many effects as are searched for."""
    return searched_count(members, measured) >= LARGEST


def searched_count(members: Members, measured: Members) -> int:
    """Return how many members of a set were searched for; one that was measured directly takes no place."""
    known = {c.name for c, _ in measured}
    return sum(c.name not in known for c, _ in members)
