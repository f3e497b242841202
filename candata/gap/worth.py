"""What an effect must explain to be worth a name, and what a set leaves unexplained."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.compare import error_within, null_level, standard_error
from candata.gap.search import Fit, Members, Problem

Array = NDArray[np.float64]
#: Most effects of a set that are searched for, beside those that were measured without a fit.
LARGEST = 3
#: Share of the gain so far below which another effect is not worth naming, significant or not.
EXTRA = 0.05
#: An effect worth less is named too where it takes `MOST` of what is left, and gains more floors and more standard
#: errors than these: one that was missing ends the search, one that makes up for it leaves a part. Chosen: beside a
#: tracker turned by 8 degrees, a dead band of the fingertips was worth 0.16 of 0.21 floors left, a 28th of the gain.
FAINT, SURER = 0.05, 3.0
#: Floors that must be left for pairs, and for a fault to be tried on other elements, one effect in place of two, or all
#: together: contact alone leaves a tenth or two behind a right cause. (A softer servo and a gain of the fingertips, for
#: steps half as long beside a mass, left 0.18; one joint's torque limit, for that of its finger, 0.19. Of a gap of
#: one floor three of seven little things left 0.19, too much for a verdict; all together left 0.08.)
LEFT, OPEN = 0.2, 0.1
#: Share of what is left, where that is more than `LEFT`, that the next effect must take, sharply fitted. Chosen: of two
#: or three causes the next one takes most of what the others leave; beside the object's mass, named for a magnet,
#: contact damping took a fifth, then a mass centre a twentieth.
TAKEN = 0.25
#: Floors of what is left that count for that, at most: 0.15 floors are worth a name however much no effect explains.
#: (Of real cube tosses ten floors stay; inertia and contact, true of the cube, take 0.4 of them together. In 131 blind
#: cases one step of one search depended on its being 0.15, not 0.2, and no name did.)
MUCH = 0.6
#: Share of the loss above the floor that a joint fit of many effects must take off, and, of what a first cause leaves,
#: a set to whose signatures the recording adds up.
MOST = 0.5


def left_by(best: Fit) -> float:
    """Return what a fit leaves above the floor, in floors."""
    return float(best.evidence.loss.mean()) - 1


def has_room(best: Fit) -> bool:
    """Tell whether so much is left that another effect could be worth a name."""
    return left_by(best) > EXTRA * best.gain


def leaves(problem: Problem, fit: Fit) -> bool:
    """Tell whether the held-out loss of a fit lies above the nulls of its world."""
    return bool(fit.evidence.loss.mean() > null_level(problem.score))


def worth_adding(extra: Array, so_far: float) -> bool:
    """Tell whether the gain `extra (E,)` of one more effect is sure, worth a name, and not one episode's doing."""
    least = max(standard_error(extra), EXTRA * so_far)
    return bool(extra.mean() > least and np.delete(extra, np.argmax(extra)).mean() > EXTRA * so_far / 2)


def extra_of(best: Fit, grown: Fit) -> Array:
    """Return what another set gains on each episode `(E,)` beyond the best so far, in floors."""
    return best.evidence.loss - grown.evidence.loss


def takes(best: Fit, grown: Fit) -> bool:
    """Tell whether more effects take their share of what is left, where that is much."""
    left = left_by(best)
    return left <= LEFT or float(extra_of(best, grown).mean()) > share_of(left)


def share_of(left: float) -> float:
    """Return how much more effects must take of what is left, in floors, where that is much."""
    return TAKEN * min(max(left, 0.0), MUCH)


def is_next(best: Fit, grown: Fit, tasks: Sequence[str]) -> bool:
    """Tell whether one more effect is worth a name: it gains enough and takes enough, or it ends the search."""
    enough = worth_adding(extra_of(best, grown), best.gain) and takes(best, grown)
    return enough or settles(best, grown, tasks)


def settles(best: Fit, grown: Fit, tasks: Sequence[str]) -> bool:
    """Tell whether one more effect, small beside the others, surely takes most of what they leave.

    It may show in one of the tasks alone, surely there. (A time step of 0.5 ms was worth 1.3 floors in each episode of
    one task of five, and in none of another.)
    """
    extra = extra_of(best, grown)
    least = max(FAINT, MOST * left_by(best))
    sure = float(extra.mean()) > max(least, SURER * error_within(extra, tasks))
    return sure and bool(np.delete(extra, np.argmax(extra)).mean() > least / 2)


def is_full(members: Members, measured: Members) -> bool:
    """Tell whether a set holds as many effects as are searched for."""
    return searched(members, measured) >= LARGEST


def searched(members: Members, measured: Members) -> int:
    """Return how many members of a set were searched for; one that was measured directly takes no place."""
    known = {c.name for c, _ in measured}
    return sum(c.name not in known for c, _ in members)
