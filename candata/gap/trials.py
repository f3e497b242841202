"""Sets on trial: fitted lightly, near rivals sharply; and two effects that are tried together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from candata.gap.added import TRIED, begun, here_of
from candata.gap.candidates import Candidate
from candata.gap.compare import RIVALS, UNSURE, is_tied, standard_error
from candata.gap.refine import WIDTHS, joint
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief
from candata.gap.sparse import pruned
from candata.gap.worth import (
    EXTRA,
    FAINT,
    LARGEST,
    LEFT,
    MOST,
    extra_of,
    is_full,
    is_next,
    left_by,
    searched,
    share_of,
    takes,
    worth_adding,
)

Array = NDArray[np.float64]
#: Numbers of a set up to which each rival that a light fit cannot tell from the best gets simulated slopes too; of more
#: numbers, only the best. Chosen: twelve joint offsets and one more effect took 53 CPU s each.
MANY = 8
#: Standard errors by which an effect alone must gain to be tried in a pair. (Of one split of cube tosses, inertia and
#: compliance are worth 0.7 floors together and nothing alone, beside the friction cone.)
SURELY = 2.0
#: Share of what another effect must take that a set must take of a few episodes to be fitted on all, and lightly fitted
#: to be fitted sharply. Chosen: of two causes in no library such sets took a hundredth of what was left, for 15 and 24
#: CPU s.
PROMISING = 0.5
#: Shares of what it is alone at which an effect begins beside one that does much alike, which begins at the rest.
#: Chosen: damping of the joints beside less of the servos was not found from half of either, as the two lie far apart.
SPLITS = (0.5, 1.0)


def sharp(problem: Problem, sets: Sequence[Members], beside: Fit | None = None) -> Fit | None:
    """Return the best of some sets, sharply fitted those that light fits cannot tell from the best; None of none.

    Where they are what is found with more `beside` it, only those are that take a part of what is left already, and
    those with a choice: no slope of its own leads to it, so that the others must move first. (A light fit moves them
    too little: beside a heavier object another `impratio` took nothing.)
    """
    base = problem.score.loss(problem.nominal)
    if beside is None and len(sets) == 1:
        return joint(problem, sets[0], base)
    light = [joint(problem, members, base, widths=()) for members in sets]
    fitted = [f for f in light if beside is None or f.members[-1][0].choices or promises_more(beside, f)]
    return sharpest(problem, fitted)


def promises_more(best: Fit, grown: Fit) -> bool:
    """Tell whether more effects, lightly fitted, take a part of what a name must: a sharp fit may find the rest."""
    left = left_by(best)
    enough = max(EXTRA * best.gain, share_of(left) if left > LEFT else 0.0)
    least = min(enough, max(FAINT, MOST * left))
    return float(extra_of(best, grown).mean()) > PROMISING * least


def sharpest(problem: Problem, light: Sequence[Fit]) -> Fit | None:
    """Return the best of lightly fitted sets, sharply fitted those that cannot be told from the best; None of none.

    Of several, those are fitted on that still cannot be told from the best by slopes over the first of the widths.
    """
    base = problem.score.loss(problem.nominal)
    near, known = _untold(light), 0
    if len(near) > 1:
        near, known = _untold([joint(problem, f.members, base, WIDTHS[:1]) for f in near]), 1
    return max((joint(problem, f.members, base, WIDTHS[known:]) for f in near), key=lambda f: f.gain, default=None)


def _untold(fits: Sequence[Fit]) -> list[Fit]:
    """Return the best fit and, where none has many numbers, the first few that cannot be told from it."""
    ordered = sorted(fits, key=lambda f: -f.gain)
    many = max((len(f.plane.at) for f in ordered), default=0) > MANY
    near = [f for f in ordered if f is ordered[0] or (not many and is_tied(f, ordered[0], UNSURE))]
    return near[: 1 + RIVALS]


def paired(problem: Problem, best: Fit, alone: Sequence[Fit]) -> Fit | None:
    """Return the set with two more effects that are worth a name together though neither is beside `best`.

    Tried are those that gained surely alone: beside a cause that took their share, each may need the other. A pair that
    gains nothing at any share of what each is alone is not fitted.
    """
    too_many = searched(best.members, problem.measured) + 2 > LARGEST
    if too_many or left_by(best) < LEFT:
        return None
    free = _free(best, alone)
    pairs = [(a, b) for a, b in combinations(free, 2) if a[0].name != b[0].name]
    part, index = brief(problem)
    now = float(part.score.loss(here_of(problem, best)[index]).mean()) if pairs else 0.0
    sets = [begun(part, best.members, pair) for pair in pairs]
    found = sharp(problem, [members for loss, members in sets if loss < now], best)
    return found if found is not None and are_worth_two(best, found) else None


def are_worth_two(best: Fit, found: Fit) -> bool:
    """Tell whether two more effects are worth a name each, and together take enough of what is left."""
    return worth_adding(extra_of(best, found) / 2, best.gain) and takes(best, found)


def shared(problem: Problem, best: Fit, alone: Sequence[Fit]) -> Fit | None:
    """Return the set in which a member shares what it explains with an effect that does much the same; else None.

    Where both act, the one that was taken made up for the other, which gains nothing beside it, and no slope leads from
    there. (More damping of the servos stood for theirs and the joints' own, 1.4 floors off: 0.2 where both act.) In a
    full set it takes the place of the member worth least, which may make up for it. (Beside a clock's drift a gain of
    one servo did, 0.7 floors off.)
    """
    if left_by(best) < LEFT:
        return None
    known = {c.name for c, _ in problem.measured}
    part, index = brief(problem)
    base = part.score.loss(part.nominal)
    left_out = least_worth(part, best, known)[:1] if is_full(best.members, problem.measured) else ()
    kept = without(best, left_out)
    fits = [
        _split(part, tuple(one for one in kept if one is not m), m, f, base)
        for m in kept
        if m[0].name not in known and not m[0].choices
        for f in _free(best, alone)
        if not f[0].choices
    ]
    now = float(part.score.loss(here_of(problem, best)[index]).mean()) if fits else 0.0
    far = now - PROMISING * share_of(now - 1)
    found = sharp(problem, [f.members for f in fits if float(part.score.loss(f.plane.z).mean()) < far])
    # One that gives way altogether leaves its place.
    found = pruned(problem, found, problem.score.loss(problem.nominal)) if found is not None else None
    return found if found is not None and is_next(best, found, problem.recs.tasks) else None


def _split(part: Problem, others: Members, m: tuple[Candidate, Array], f: tuple[Candidate, Array], base: Array) -> Fit:
    """Return the better light fit of two effects that do much alike beside others, begun at either of `SPLITS`."""
    fits = [joint(part, (*others, _part(m, 1 - own), _part(f, own)), base, WIDTHS[:1]) for own in SPLITS]
    return min(fits, key=lambda fit: float(part.score.loss(fit.plane.z).mean()))


def without(best: Fit, left_out: Members) -> Members:
    """Return the members of a set without some of them."""
    return tuple(m for m in best.members if all(m is not one for one in left_out))


def least_worth(problem: Problem, best: Fit, known: Collection[str]) -> Members:
    """Return the members, but for effects named in `known`, by what is lost without each, the least first."""
    losses = [float(problem.score.loss(z).mean()) for z in problem.without_each(best.members)]
    order = [m for _, m in sorted(zip(losses, best.members, strict=True), key=lambda pair: pair[0])]
    return tuple(m for m in order if m[0].name not in known)


def _free(best: Fit, alone: Sequence[Fit]) -> Members:
    """Return the first of the effects that gain surely alone and are not in the set."""
    taken = {c.name for c, _ in best.members}
    sure = [f for f in alone if f.gain > SURELY * standard_error(f.evidence.gain)]
    return tuple(f.members[0] for f in sure if f.members[0][0].name not in taken)[:TRIED]


def _part(member: tuple[Candidate, Array], share: float) -> tuple[Candidate, Array]:
    """Return an effect at a share of its distance from its neutral value."""
    c, u = member
    return c, c.neutral + share * (u - c.neutral)
