"""Names of a set that are left out at the end: nobody could tell their size from none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.attribute import Attribution
from candata.gap.candidates import Candidate
from candata.gap.own_floor import judged
from candata.gap.refine import WIDTHS, joint
from candata.gap.search import Fit, Members, Problem
from candata.gap.shrink import intervals
from candata.gap.trials import without
from candata.gap.worth import LARGEST, searched

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
    tied ones stay; and so do several that are worth more together: of names that make up for one another none has a
    size, and without them all much is missing. (Where everything was a little wrong, damping, inertia and dry friction
    of the joints were left out together, and 0.68 of 2.1 floors stayed in place of 0.06.) Of a joint fit of many, each
    was asked already whether it is worth anything: one by one, thirteen came down to five, and 0.06 floors to 0.37.
    """
    best = found.chosen
    if best is None or found.force or len(found.tied) > 1 or len(best.members) < 2:
        return found
    if searched(best.members, problem.measured) > LARGEST:
        return found
    return _sized(problem, found, best, (1 - LITTLE) * _explained(replace(problem, score=found.score), best))


def _sized(problem: Problem, found: Attribution, best: Fit, least: float) -> Attribution:
    """Return the same as long as what stays explains a share of the gap, at `least`."""
    world = replace(problem, score=found.score)
    untold = _untold(world, best, least) if len(best.members) > 1 else ()
    if not untold:
        return found
    fit = _rival(world, found.rivals, without(best, untold), least)
    if fit is None:
        fit = joint(world, without(best, untold), world.score.loss(world.nominal), WIDTHS[1:])
    fit, world, remains = judged(world, fit)
    if _explained(world, fit) < least:
        return found
    new = replace(found, chosen=fit, tied=(fit,), score=world.score, remains=found.remains and remains, rivals=())
    return _sized(problem, new, fit, least)


def _rival(problem: Problem, rivals: Sequence[Fit], stays: Members, least: float) -> Fit | None:
    """Return the rival that leaves least of those that hold all that stays and nothing without a size; None of none.

    An effect of which nobody can tell that it is there has no claim on what another, told from none, does as well. (A
    time step of 2.5 ms beside a mass left as much as a little damping of the joints.)
    """
    names = {c.label for c, _ in stays}
    for fit in sorted(rivals, key=lambda f: float(f.evidence.loss.mean())):
        if names < {*fit.labels} and not _untold(problem, fit, least):
            return fit
    return None


def _explained(problem: Problem, fit: Fit) -> float:
    """Return the share of the loss above the floor that a set takes off."""
    whole = float(problem.score.loss(problem.nominal).mean()) - 1
    return 1 - (float(problem.score.loss(fit.plane.z).mean()) - 1) / max(whole, 1e-6)


def _untold(problem: Problem, fit: Fit, least: float) -> Members:
    """Return members worth little whose values could as well be neutral, as many as together leave a share explained.

    That is `least`, the others as they are; of all members, the first stays.
    """
    known, ends = {c.name for c, _ in problem.measured}, [fit.split(end) for end in intervals(problem, fit)]
    own, whole = (float(problem.score.loss(z).mean()) for z in (fit.plane.z, problem.nominal))
    rises = [float(problem.score.loss(z).mean()) - own for z in problem.without_each(fit.members)]
    found = [
        (rise, member)
        for member, (_, low), (_, high), rise in zip(fit.members, *ends, rises, strict=True)
        if rise < LITTLE * (whole - own) and member[0].name not in known and _is_none(member, low, high)
    ]
    order = [member for _, member in sorted(found, key=lambda pair: pair[0])][: len(fit.members) - 1]
    while len(order) > 1:
        left = problem.residuals([problem.setting(without(fit, tuple(order)))])[0]
        if whole - float(problem.score.loss(left).mean()) >= least * (whole - 1):
            break
        order.pop()
    return tuple(order)


def _is_none(member: tuple[Candidate, Array], low: Array, high: Array) -> bool:
    """Tell whether a member's coordinates `(d,)`, between two ends, lie so near its neutral ones."""
    c, u = member
    away = u - c.neutral
    reach = np.where(away > 0, u - low, high - u)
    return not c.choices and bool((np.abs(away) < UNTOLD * reach).all())
