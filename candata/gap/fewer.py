"""Sets with fewer effects that explain as much: members that others make up for, and two that stand for one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from candata.gap.added import ADDED, ALIKE, HALFWAY, by_loss, lightly, lightly_fitted, pieces_of, residuals_at
from candata.gap.candidates import FEW_NUMBERS, Candidate, is_on_slides, probes
from candata.gap.compare import RIVALS, UNSURE, is_tied
from candata.gap.elsewhere import everywhere, neighbour
from candata.gap.own_floor import Grown, judged
from candata.gap.refine import WIDTHS, joint
from candata.gap.screen import respond
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief
from candata.gap.stage import unheld
from candata.gap.together import beside
from candata.gap.trials import least_worth, sharp, without
from candata.gap.worth import EXTRA, FAINT, LARGEST, LEFT, OPEN, is_next, left_by

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Share of what leaving a member out costs to which slopes must promise that refitting the others brings it down, for
#: that to be tried. Chosen: 0.41 where a tracker's bias made up for a support's height, 0.9 to 1 of what was true.
MADE_UP = 0.6
#: Members worth least of which each two may stand for one effect. Chosen: four names are fitted where one is missing;
#: the two that stood for a friction cone, or for an object's size, were any two of them.
PAIRED = 4


def simplified(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set without members that the others make up for once they are refitted.

    What was taken early may be worth nothing beside what came later. (A support's height stayed beside a tracker's bias
    that was worth as much in its place.) Slopes tell which to try, or how little a member is worth (a dead band that
    closed a thousandth of the gap came by an exchange); one that was measured without a fit stays.
    """
    if len(best.members) < 2:
        return best, problem, remains
    free = _free(problem, best)
    lighter = _without_one(problem, best, free)
    found = lighter or _without_some(problem, best, _spare(problem, best, free))
    if found is None:
        return best, problem, remains
    found, world, remains = judged(problem, found)
    # Of what is still many, all that can be was left out at once.
    is_done = lighter is None and len(found.members) > LARGEST
    return (found, world, remains) if is_done else simplified(world, found, remains)


def _without_some(problem: Problem, best: Fit, spare: Members) -> Fit | None:
    """Return the set, refitted, without one of some members, or several of them, where it explains as much; else None.

    Of a joint fit of many, all are left out at once, else half of them, and so on to one, and again of what is left,
    fitted lightly until none can be: sharply and one by one, each of eleven was fitted without each of the others. It
    is the whole set that each is compared with: step by step, seven names came down to three that left 0.52 floors
    where they had left 0.28.
    """
    base = problem.score.loss(problem.nominal)
    if len(best.members) > LARGEST:
        fewer = _thinned(problem, best, best, spare, base)
        return joint(problem, fewer.members, base, WIDTHS[1:]) if fewer else None
    found = sharp(problem, [without(best, (left,)) for left in spare[: 1 + RIVALS]])
    return found if found is not None and not is_next(found, best, problem.recs.tasks) else None


def _without_one(problem: Problem, best: Fit, free: Sequence[tuple[Candidate, Array]]) -> Fit | None:
    """Return the set, refitted, without a choice or many numbers among `free`, if it explains as much; else None.

    Tried by simulated slopes, on a few episodes first, whatever those of the fit promise: many numbers share what one
    more effect does along a valley that bends, and a choice has no slopes. (Six joint offsets took a part of an
    object's size. Without them the slopes where they stood promised 0.9 floors; a few steps on, the truth left a tenth
    less than the set with them. A time step that had stood for another integrator stayed beside it.)
    """
    asked = [m for m in free if m[0].size > FEW_NUMBERS or m[0].choices]
    if not asked:
        return None
    part, _ = brief(problem)
    near = _about_as_well(part, best)
    for m in asked:
        loss, members = lightly_fitted(part, without(best, (m,)), WIDTHS)
        if loss < near:
            fit = joint(problem, members, problem.score.loss(problem.nominal), WIDTHS[1:])
            few = len(best.members) <= LARGEST
            if not is_next(fit, best, problem.recs.tasks) if few else is_tied(fit, best, UNSURE):
                return fit
    return None


def _thinned(problem: Problem, whole: Fit, best: Fit, spare: Members, base: Array) -> Fit | None:
    """Return the smallest set found, fitted lightly, without some members that explains as much as `whole`; or None."""
    halves = (spare[: len(spare) >> times] for times in range(len(spare).bit_length()))
    light = (joint(problem, without(best, left_out), base, widths=()) for left_out in halves)
    found = next((f for f in light if is_tied(f, whole, UNSURE)), None)
    if found is None or len(found.members) <= LARGEST:
        return found
    return _thinned(problem, whole, found, _spare(problem, found, _free(problem, found)), base) or found


def _about_as_well(part: Problem, best: Fit) -> float:
    """Return the loss on a few episodes up to which a light fit may explain about as much as a set once it is sharp."""
    now, most = by_loss(part, [best.members])[0][0], float(part.score.loss(part.nominal).mean())
    return now + ALIKE * (most - now)


def _free(problem: Problem, best: Fit) -> Members:
    """Return the members that may be left out: what was measured without a fit stays."""
    known = {c.name for c, _ in problem.measured}
    return tuple(m for m in best.members if m[0].name not in known)


def _spare(problem: Problem, best: Fit, free: Sequence[tuple[Candidate, Array]]) -> Members:
    """Return those of some members that cost little, or that slopes promise the others, refitted, to make up for.

    First comes the one without which slopes promise most; one member of the set is none of them, and a choice, which
    has no slopes, neither.
    """
    now, found = float(problem.score.loss(best.plane.z).mean()), []
    for m in [m for m in free if not m[0].choices]:
        left_out, promised = _losses_without(problem, best, m)
        if left_out - now < max(FAINT, EXTRA * best.gain) or promised - now < MADE_UP * (left_out - now):
            found.append((promised, m))
    order = [m for _, m in sorted(found, key=lambda pair: pair[0])]
    return tuple(order[: len(best.members) - 1])


def _losses_without(problem: Problem, best: Fit, left: tuple[Candidate, Array]) -> tuple[float, float]:
    """Return the loss that slopes promise without a member as the others stand, and once they are refitted."""
    rest = best.plane_without((left,))
    left_out, promised = (float(problem.score.loss(z).mean()) for z in (rest.z, rest.least()))
    return left_out, promised


def by_choice(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set with a choice in place of many members that stand for it, where it explains as much.

    The joint fit leaves choices out, as these have no slopes, and makes up for a missing one by several numbers. Tried
    is each value of each beside the few members worth most. (Beside a mass, a time step of 1 ms was named as damping of
    servos and joints, gains of both and one of the fingertips.)
    """
    if len(best.members) <= LARGEST or problem.plays_all:
        return best, problem, remains
    problem.pace.told("trying choices in place of many effects")
    part, _ = brief(problem)
    known, scene = {c.name for c, _ in problem.measured}, problem.replayer.scene
    stay, order = [m for m in best.members if m[0].name in known], least_worth(part, best, known)[::-1]
    choices = [(c, u) for c in unheld(problem, best.members) if c.choices for u in probes(c, scene)]
    sets = [(*stay, *order[:count], one) for count in range(1, LARGEST) for one in choices]
    light = [lightly_fitted(part, members, WIDTHS[:2]) for _, members in lightly(part, sets)[:ADDED]]
    near = _about_as_well(part, best)
    as_well = sorted((pair for pair in light if pair[0] < near), key=lambda pair: pair[0])
    found = sharp(problem, [members for _, members in as_well[: 1 + RIVALS]])
    if found is None or not is_tied(found, best):
        return best, problem, remains
    found, world, remains = judged(problem, found)
    return simplified(world, found, remains)


def widened(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set with an effect of one element on all, where that explains more, or either of two elements as much.

    So it is said of a single cause too: which one it is is not known. (Beside softer servos and a tilt, more torsional
    friction of one of two fingertips that held a box explained as much as that of both, which was true. Of a thumb
    against two fingers it was named for what all had: 0.07 floors were left, with all of them 0.02. Elsewhere it left
    0.01, all of them 0.04 by a light fit, and 0.01 less than it by a sharp one.)
    """
    for member in best.members if len(best.members) > 1 else ():
        if member[0].element is None or is_on_slides(member[0], problem.replayer.scene):
            continue
        whole = everywhere(problem, *member)
        if whole[0].size != member[0].size:
            continue
        base = problem.score.loss(problem.nominal)
        all_over, anyones = _instead_of(best, member, whole), cache(partial(_is_anyones, problem, best, member, base))
        if not is_tied(joint(problem, all_over, base, widths=()), best) and not anyones():
            continue
        fit = joint(problem, all_over, base)
        if fit.gain > best.gain or (is_tied(fit, best) and anyones()):
            found, world, remains = judged(problem, fit)
            return widened(world, found, remains)
    return best, problem, remains


def _is_anyones(problem: Problem, best: Fit, member: tuple[Candidate, Array], base: Array) -> bool:
    """Tell whether the effect of another element, fitted lightly, would do as well in a member's place."""
    elsewhere = neighbour(problem, without(best, (member,)), member[0], apart=True)
    as_strong = [(c, member[1]) for c, _ in elsewhere if c.size == member[0].size]
    begun = [_instead_of(best, member, one) for one in (*elsewhere, *as_strong)]
    return any(is_tied(joint(problem, members, base, widths=()), best, UNSURE) for members in begun)


def completed(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set with all numbers of a vector in the place of one element's and of others, if that explains more.

    What the numbers of one element leave of a whole vector, others make up for by several names. (Offsets of six joints
    were named as that of one, beside a tracker's bias and turn.) Fewest names are tried first, on a few episodes; of
    many others only those worth most. (All sets of eight took 262 of a world's 398 CPU s.) Beside all others the vector
    must explain as much more as a name is worth: where one joint's offset beside a bias left 1.2 of 8.8 floors.
    """
    known = {c.name for c, _ in problem.measured}
    for member in best.members if len(best.members) > 1 else ():
        if member[0].element is None or is_on_slides(member[0], problem.replayer.scene):
            continue
        whole = everywhere(problem, *member)
        if whole[0].size == member[0].size:
            continue
        part, _ = brief(problem)
        near = _about_as_well(part, best)
        others = without(best, (member,))
        stay, free = ([m for m in others if (m[0].name in known) is measured] for measured in (True, False))
        many = len(free) > LARGEST
        order = [m for m in least_worth(part, best, known)[::-1] if m is not member] if many else free
        for count in range(len(free) + (left_by(best) > LEFT)):
            some_of = [order[:count]] if many else combinations(order, count)
            sets = [(whole, *stay, *some) for some in some_of]
            loss, members = min((lightly_fitted(part, s, WIDTHS[:1]) for s in sets), key=lambda pair: pair[0])
            if loss > near:
                continue
            fit = joint(problem, members, problem.score.loss(problem.nominal))
            fewer_names = count < len(free)
            if (fit.gain > best.gain) if fewer_names else is_next(best, fit, problem.recs.tasks):
                return judged(problem, fit)
    return best, problem, remains


def _instead_of(best: Fit, member: tuple[Candidate, Array], other: tuple[Candidate, Array]) -> Members:
    """Return the members of a set with one in place of another."""
    return tuple(other if m is member else m for m in best.members)


def merged(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set with one effect in place of two that stand for it, where it explains as much.

    A fit of all numbers makes up for a choice that is missing by several of them, none of which is idle beside the
    others. (For a pyramidal friction cone it named less friction and a contact damping.) Tried where a gap remains that
    contact alone does not leave, on pairs of the members worth least; one that was measured without a fit stays. Where
    that grew from a wrong beginning, what stands for one may leave a little less than it (but less than a name is
    worth), until what it hid is found, too.
    """
    known = {c.name for c, _ in problem.measured}
    free = [m for m in best.members if m[0].name not in known]
    few = len(best.members) < 3 or len(free) < 2
    if not remains or left_by(best) < OPEN or few or problem.plays_all:
        return best, problem, remains
    problem.pace.told("trying one effect in place of two")
    part, index = brief(problem)
    pairs = combinations(least_worth(part, best, known)[:PAIRED], 2)
    found = [members for pair in pairs for members in _instead(part, index, best, pair)]
    refitted = [lightly_fitted(part, members) for _, members in by_loss(part, found)[:ADDED]]
    worthy = sorted((pair for pair in refitted if _stands_for_most(part, best, *pair)), key=lambda pair: pair[0])
    base = problem.score.loss(problem.nominal)
    light = [lightly_fitted(part, members, WIDTHS) for _, members in worthy[:RIVALS]]
    enough = _about_as_well(part, best)
    near = [joint(problem, members, base) for loss, members in light if loss < enough]
    fit = max(near, key=lambda f: f.gain, default=None)
    if fit is None or not is_tied(fit, best, UNSURE) or is_next(fit, best, problem.recs.tasks):
        return best, problem, remains
    fit, world, remains = judged(problem, fit)
    return merged(world, fit, remains)


def _stands_for_most(problem: Problem, best: Fit, loss: float, members: Members) -> bool:
    """Tell whether a set with one effect in place of two, which leaves a loss, makes up for `HALFWAY` of what the two
    are worth, at least: a fit on all episodes may find the rest.
    """
    labels = {c.label for c, _ in members}
    kept = tuple(m for m in best.members if m[0].label in labels)
    own, without_both = (float(problem.score.loss(residuals_at(problem, some)).mean()) for some in (best.members, kept))
    return loss < own + HALFWAY * (without_both - own)


def _instead(part: Problem, index: Index, best: Fit, pair: Members) -> list[Members]:
    """Return the sets with the one effect in place of a pair that leaves least once the others move along, and rivals.

    As the others stand, they make up for what is missing. (An object of 0.935 times its size, for which a tracker's
    bias, a support's height and an offset of one joint stood, promised nothing beside that bias.) `part` holds the
    episodes `index` of those that `best` is a fit of. None of the pair's effects is tried elsewhere in place of both.
    """
    kept = without(best, pair)
    here = residuals_at(part, kept)
    found = [c for c in unheld(part, kept) if c.name not in {one.name for one, _ in pair}]
    held = [piece for piece in pieces_of(best, here, index) if any(piece[0] is c for c, _ in kept)]
    tried = beside(part, here, held, respond(part, here, found, kept)[0])
    # Of a choice's values, the one that leaves least.
    first = {one.members[-1][0].label: one for one in reversed(tried)}
    return [one.members for one in sorted(first.values(), key=lambda one: one.loss)[: 1 + RIVALS]]
