"""The one rule by which a set of effects takes another's place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.candidates import Candidate
from candata.gap.compare import BLUNT, error_within, standard_error
from candata.gap.search import Fit
from candata.gap.worth import EXTRA, FAINT, LEFT, MOST, SURER, left_by, share_of

Array = NDArray[np.float64]


def is_better(best: Fit, fit: Fit, tasks: Sequence[str]) -> bool:
    """Tell whether a set takes the place of another: it says more with as many names, or is worth its names.

    One with fewer names does unless what it lacks is worth the names.
    """
    more = len(fit.members) - len(best.members)
    if more > 0:
        return is_worth(best, fit, tasks, more)
    if more < 0:
        return not is_worth(fit, best, tasks, -more)
    gained = best.evidence.loss - fit.evidence.loss
    return bool(gained.mean() > max(standard_error(gained), BLUNT * best.gain))


def is_worth(best: Fit, fit: Fit, tasks: Sequence[str], names: int) -> bool:
    """Tell whether a set gains what so many more names must: each a share of the gain and of what is left.

    What lies below the floor is luck and counts for nothing.
    """
    luck = max(1.0 - float(fit.evidence.loss.mean()), 0.0)
    extra = (best.evidence.loss - fit.evidence.loss - luck) / names
    left = left_by(best) / names
    others = float(np.delete(extra, np.argmax(extra)).mean())
    least = EXTRA * best.gain
    takes = left_by(best) <= LEFT or float(extra.mean()) > share_of(left)
    if float(extra.mean()) > max(standard_error(extra), least) and others > least / 2 and takes:
        return True
    ends = max(FAINT, MOST * left)
    return float(extra.mean()) > max(ends, SURER * error_within(extra, tasks)) and others > ends / 2


def names_key(members: Sequence[tuple[Candidate, Array]]) -> tuple[str, ...]:
    """Return what makes two sets the same: labels, and the value of each choice."""
    return tuple(sorted(c.label if not c.choices else f"{c.label}={u.tolist()}" for c, u in members))
