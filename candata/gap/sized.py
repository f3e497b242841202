"""Names of a set that are left out at the end: nobody could tell their size from none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.attribute import Attribution
from candata.gap.candidates import Candidate
from candata.gap.own_floor import judged
from candata.gap.refine import joint
from candata.gap.search import Fit, Members, Problem
from candata.gap.shrink import intervals
from candata.gap.trials import without

Array = NDArray[np.float64]
#: Share of the way from its value to the end of its interval within which the neutral value must lie for an effect
#: beside others to be left out, and the share of the gain that it must be worth less than. Chosen: so near, its size is
#: less than 0.8 of its standard error; what is worth more is no luck, however wide its interval.
UNTOLD, LITTLE = 0.5, 0.2


def with_sizes(problem: Problem, found: Attribution) -> Attribution:
    """Return what was found without effects of a set, worth little, whose values hardly differ from the model's own.

    Where contact is chaos, any small change deals other outcomes, and the best of many changes seems to explain a part
    of what is left. (Beside fingertips half as slippery, the contact time of one of them went from 8 to 8.2 ms, with an
    interval from 6.7 to 11.3, for a tenth of the gap.) A choice, what was measured without a fit, an effect alone and
    tied ones stay.
    """
    best = found.chosen
    if best is None or found.force or len(found.tied) > 1 or len(best.members) < 2:
        return found
    world = replace(problem, score=found.score)
    untold = _untold(world, best)
    if not untold:
        return found
    fit, world, remains = judged(world, joint(world, without(best, untold), world.score.loss(world.nominal)))
    new = replace(found, chosen=fit, tied=(fit,), score=world.score, remains=found.remains and remains, rivals=())
    return with_sizes(problem, new)


def _untold(problem: Problem, fit: Fit) -> Members:
    """Return the members worth little whose values could as well be neutral; of all of them, the first stays."""
    known, ends = {c.name for c, _ in problem.measured}, [fit.split(end) for end in intervals(problem, fit)]
    own = float(problem.score.loss(fit.plane.z).mean())
    whole = float(problem.score.loss(problem.nominal).mean()) - own
    rises = [float(problem.score.loss(z).mean()) - own for z in problem.without_each(fit.members)]
    found = tuple(
        member for member, (_, low), (_, high), rise in zip(fit.members, *ends, rises, strict=True)
        if rise < LITTLE * whole and member[0].name not in known and _is_none(member, low, high)
    )  # fmt: skip
    return found if len(found) < len(fit.members) else found[1:]


def _is_none(member: tuple[Candidate, Array], low: Array, high: Array) -> bool:
    """Tell whether a member's coordinates `(d,)`, between two ends, lie so near its neutral ones."""
    c, u = member
    away = u - c.neutral
    reach = np.where(away > 0, u - low, high - u)
    return not c.choices and bool((np.abs(away) < UNTOLD * reach).all())
