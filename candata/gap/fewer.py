"""Sets with fewer effects that explain as much: members that others make up for, and two that stand for one."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from candata.gap.added import ADDED, by_loss, residuals_at
from candata.gap.candidates import Candidate
from candata.gap.refine import joint
from candata.gap.response import Plane
from candata.gap.screen import respond
from candata.gap.search import Fit, Members, Problem, fit_one
from candata.gap.sets import Grown, judged
from candata.gap.shortlist import brief
from candata.gap.stage import RIVALS, UNSURE, is_tied, unheld
from candata.gap.trials import least_worth
from candata.gap.worth import EXTRA, FAINT, is_next

Array = NDArray[np.float64]
#: Share of what leaving a member out costs to which slopes must promise that refitting the others brings it down, for
#: that to be tried. Chosen: 0.41 where a tracker's bias made up for a support's height, 0.9 to 1 of what was true.
MADE_UP = 0.6
#: Members worth least of which each two may stand for one effect. Chosen: what stands for one is worth little by half.
PAIRED = 3


def simplified(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set without members that the others make up for once they are refitted.

    What was taken early may be worth nothing beside what came later. (A support's height stayed beside a tracker's bias
    that was worth as much in its place.) Slopes tell which to try, or how little a member is worth (a dead band that
    closed a thousandth of the gap came by an exchange); one that was measured without a fit stays.
    """
    if len(best.members) < 2:
        return best, problem, remains
    known = {c.name for c, _ in problem.measured}
    free = [m for m in best.members if m[0].name not in known and not m[0].choices and _is_spare(problem, best, m)]
    base = problem.score.loss(problem.nominal)
    fits = [joint(problem, tuple(m for m in best.members if m is not left), base) for left in free]
    found = max(fits, key=lambda f: f.gain, default=None)
    if found is None or is_next(found, best, problem.recs.tasks):
        return best, problem, remains
    found, world, remains = judged(problem, found)
    return simplified(world, found, remains)


def _is_spare(problem: Problem, best: Fit, left: tuple[Candidate, Array]) -> bool:
    """Tell whether leaving a member out costs little, or slopes promise that the others, refitted, make up for it."""
    plane = best.plane
    own = np.concatenate([np.full(c.size, c is left[0]) for c, _ in best.members])
    at = plane.at.copy()
    at[own] = left[0].neutral
    rest = Plane(plane.low[~own], plane.high[~own], plane.at[~own], plane.read(at), plane.slope[~own])
    refitted = rest.read(rest.best(np.arange(len(rest.z))))
    left_out, promised, now = (float(problem.score.loss(z).mean()) for z in (rest.z, refitted, plane.z))
    return left_out - now < max(FAINT, EXTRA * best.gain) or promised - now < MADE_UP * (left_out - now)


def merged(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set with one effect in place of two that stand for it, where it explains as much.

    A fit of all numbers makes up for a choice that is missing by several of them, none of which is idle beside the
    others. (For a pyramidal friction cone it named less friction and a contact damping.) Tried where a gap remains, on
    pairs of the members worth least; one that was measured without a fit stays.
    """
    known = {c.name for c, _ in problem.measured}
    free = [m for m in best.members if m[0].name not in known]
    few = len(best.members) < 3 or len(free) < 2
    if not remains or few or problem.plays_all:
        return best, problem, remains
    problem.pace.told("trying one effect in place of two")
    part, _ = brief(problem)
    found = [
        members
        for pair in combinations(least_worth(part, best, known)[:PAIRED], 2)
        for members in _instead(part, best, pair)
    ]
    base = part.score.loss(part.nominal)
    refitted = [joint(part, members, base, widths=()).members for _, members in by_loss(part, found)[:ADDED]]
    base = problem.score.loss(problem.nominal)
    light = [joint(problem, members, base, widths=()) for _, members in by_loss(part, refitted)[:RIVALS]]
    near = [joint(problem, f.members, base) for f in light if is_tied(f, best, UNSURE)]
    fit = max(near, key=lambda f: f.gain, default=None)
    if fit is None or not is_tied(fit, best):
        return best, problem, remains
    fit, world, remains = judged(problem, fit)
    return merged(world, fit, remains)


def _instead(problem: Problem, best: Fit, pair: Members) -> list[Members]:
    """Return the sets with the one effect in place of a pair that promises most beside the others, and its rivals."""
    kept = tuple(m for m in best.members if all(m is not one for one in pair))
    here = residuals_at(problem, kept)
    base = problem.score.loss(here)
    found = [c for c in unheld(problem, kept) if c.label not in {one.label for one, _ in pair}]
    fits = [fit_one(problem, c, response, base) for c, response in respond(problem, here, found, kept)[0]]
    fits = sorted((f for f in fits if f.gain > 0), key=lambda f: -f.gain)
    return [(*kept, f.members[0]) for f in fits[: 1 + RIVALS]]
