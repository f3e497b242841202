"""Sets to whose signatures the recording adds up, simulated: where a search begins, and what challenges its end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from candata.effects import effects_with
from candata.gap.candidates import Candidate, probes
from candata.gap.compare import BLUNT, RIVALS, UNSURE, is_tied
from candata.gap.pace import TOGETHER
from candata.gap.refine import WIDTHS, joint
from candata.gap.response import Curve, Plane
from candata.gap.score import Compact
from candata.gap.screen import respond, slope_of
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief, fitted
from candata.gap.sparse import pruned
from candata.gap.together import WITHIN, Responses, exchanged, sums
from candata.gap.worth import FAINT, LARGEST, LEFT, MOST, extra_of, is_next, leaves, left_by, takes, worth_adding

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Sets of each size that are simulated, of those to whose signatures the recording adds up. Chosen: twice the rank of
#: true ones whose effects each take a share of the gap.
ADDED = 4
#: Steps of the logarithms of both, from the best pair of their probes on. Chosen: probes lie a factor of two apart.
NEARER = (0.35, 0.18, 0.09)
#: How many effects are tried in pairs, and where a pair's fit is begun: at these shares of what each is alone, which
#: made up for the other too. Chosen.
TRIED, PARTLY = 3, (1.0, 0.6, 0.3)
#: Share of what a first cause leaves that a set may leave, fitted lightly to a few episodes, to be fitted to all, and
#: there to be fitted sharply. Chosen: mass, friction and gain of the fingertips left 0.92 of 1.71 floors blunt, and
#: nothing sharp.
BLUNTLY = 0.75
#: Share of what a member is worth that one in its place must make up for, where it is not yet fitted, to be fitted.
#: Chosen: beside a clock that drifts, an alias of damping made up for 0.56, and what was none for 0.1 at most.
HALFWAY = 0.5
#: Share of what a set explains that one with a member exchanged may explain less where it is simulated on a few
#: episodes to be fitted on all. Chosen: beside damping of contacts, that of the servos explained 5 % less than the
#: joints' own; what was no alias, 13 % and more.
ALIKE = 0.12
#: Share of the member worth most that one must be worth for its aliases to leave the whole set ambiguous. Chosen: where
#: everything is a little wrong nothing had been named for joint damping, worth a fifth, that servo damping does as
#: well, or a tracker's scale, worth less than a tenth, that its bias does.
MINOR = 0.25


def together(problem: Problem, best: Fit, rough: Responses) -> Fit | None:
    """Return the set to whose signatures the recording adds up, where it takes most of what `best` leaves; else None.

    Of the first sets of two effects, and then of three, the one that leaves least where it is simulated is fitted, and
    where these leave a gap the best pair of what explains most alone, begun at shares of that: where both do
    much alike, signatures add up to too much. (Of servos less stiff and joints damped, both slow, the sum was not among
    the first four.) A third worth little beside the two, but a part of what they leave, is judged by a sharp fit.
    (Beside a tracker's bias and a delay, a support's height took 0.28 of 0.59 floors blunt, and all of it sharp; alone
    beside the two it promised nothing, since the bias made up for it.)

    Parameters
    ----------
    problem : Problem
    best : Fit
        A first cause, in units of the same floor.
    rough : sequence of (Candidate, Curve or Plane)
        Every effect alone on a few episodes; nothing is tried where there are none.
    """
    if not rough or left_by(best) < LEFT or problem.plays_all:
        return None
    problem.pace.say("adding up what effects do alone", TOGETHER)
    part, index = brief(problem)
    now = float(part.score.loss(here_of(problem, best)[index]).mean())
    base, left = problem.score.loss(problem.nominal), left_by(best)
    found = more = None
    for some in _firsts(part, rough):
        loss, members = by_loss(part, some)[0]
        loss, members = lightly_fitted(part, members) if loss < now else (loss, members)
        fit = joint(problem, members, base, widths=()) if loss - 1 < BLUNTLY * (now - 1) else None
        if fit is not None and (found is None or worth_adding(extra_of(found, fit), found.gain)):
            found, more = fit, None
        elif fit is not None and found is not None and left_by(found) > LEFT and takes(found, fit):
            more = fit
        if found is not None and not leaves(problem, found):
            break
    if found is None or left_by(found) > BLUNTLY * left:
        return None
    found = pruned(problem, joint(problem, found.members, base), base)
    if more is not None:
        more = joint(problem, more.members, base)
        found = more if is_next(found, more, problem.recs.tasks) else found
    return found if left_by(found) < MOST * left and worth_adding(extra_of(best, found), best.gain) else None


def _firsts(problem: Problem, rough: Responses) -> Iterator[list[Members]]:
    """Yield sets: of two, then of three whose signatures add up; a pair that is coupled, and of what explains most."""
    for some in sums(problem, rough):  # of two effects there is no triple
        if some:
            yield [one.members for one in some[:ADDED]]
    for begin in (_coupled, _started):
        yield from ([members] for members in begin(problem, rough))


def _coupled(problem: Problem, rough: Responses) -> list[Members]:
    """Return the two effects that share a spring and damper where they leave least, from the best of their probes on.

    Of a few episodes; nothing where either cannot act. No slope leads there: what contacts do that bounce is chaos from
    one value to the next. (Contacts 2.4 times as slow, a third as damped, left 1.3 of 3.4 floors, 1.4 where this ends
    and 1.8 where slopes do; alone, no compliance explains anything.)
    """
    # Far from neutral, what each does alone does not add up to what both do.
    coupled = effects_with("contact_spring")
    both = [c for name in coupled for c in [c for c, _ in rough if c.label == name][:1]]
    if len(both) < len(coupled):
        return []
    values = [[(c, u) for u in probes(c, problem.replayer.scene)] for c in both]
    (_, found), *_ = by_loss(problem, list(product(*values)))
    for step in NEARER:
        values = [[(c, np.clip(u + d * step, c.low, c.high)) for d in (-1, 0, 1)] for c, u in found]
        (_, found), *_ = by_loss(problem, list(product(*values)))
    return [found]


def _started(problem: Problem, rough: Responses) -> list[Members]:
    """Return the pair of those that explain most alone that leaves least once it is fitted lightly.

    Of a few episodes; nothing where one effect is all there is.
    """
    base = problem.score.loss(problem.nominal)
    begins = [begun(problem, (), pair)[1] for pair in combinations(_strongest(problem, rough), 2)]
    light = by_loss(problem, [joint(problem, pair, base, widths=()).members for pair in begins])
    return [members for _, members in light[:1]]


def _strongest(problem: Problem, rough: Responses) -> Members:
    """Return the effects, each where it explains most of a few episodes, that explain most of them alone."""
    base = problem.score.loss(problem.nominal)
    found: dict[str, tuple[float, tuple[Candidate, Array]]] = {}
    for c, response in rough:
        gain, at = fitted(problem, response, base)
        if gain > found.get(c.name, (0.0,))[0]:
            found[c.name] = gain, (c, at)
    order = sorted(found.values(), key=lambda pair: -pair[0])
    return tuple(member for _, member in order[:TRIED])


def begun(problem: Problem, held: Members, pair: Members) -> tuple[float, Members]:
    """Return the set with two effects at the shares of their distances that leave the least loss, after that loss."""
    shares = [[(c, u) if c.choices else (c, c.neutral + s * (u - c.neutral)) for s in PARTLY] for c, u in pair]
    return by_loss(problem, [(*held, a, b) for a, b in product(*shares)])[0]


def challenged(
    problem: Problem, world: Problem, best: Fit, rough: Responses, far: bool = True
) -> tuple[Fit, list[Fit]]:
    """Return the set, or one with a member exchanged that explains more, and those that cannot be told from it.

    Each member was chosen beside what was held when it came. Simulated are the sets with one member exchanged to whose
    signatures the recording adds up best; of the ones that stay near, a sharp fit decides. A set with a member that
    was measured without a fit stands.

    Parameters
    ----------
    problem : Problem
        That the responses `rough` are of, on a few episodes.
    world : Problem
        The same in units of the floor that `best` was judged by.
    far : bool
        Whether exchanges are fitted from farther off where much is left, and choices tried where any is to speak of.
    """
    known = {c.name for c, _ in problem.measured} & {c.name for c, _ in best.members}
    if known or not rough or not 1 < len(best.members) <= LARGEST or problem.simulated:
        return best, []
    world.pace.told("challenging each effect that was found by another in its place")
    base = world.score.loss(world.nominal)
    part, _ = brief(problem)
    seen = {c.label for c, _ in rough}
    rough = [*rough, *respond(part, part.nominal, [c for c, _ in best.members if c.label not in seen])[0]]
    now = {c.label: u for c, u in best.members}
    others = [
        tuple((c, now.get(c.label, u)) for c, u in one.members)
        for some in exchanged(part, rough, best.members)
        for one in some[:ADDED]
    ]
    much = far and left_by(best) > LEFT
    choices = _choices(best.members, rough) if far and left_by(best) > FAINT else []
    light = [joint(world, members, base, widths=()) for members in _nearest(part, best.members, others, choices, much)]
    near = [joint(world, f.members, base) for f in light if is_tied(f, best, UNSURE)]
    first = min([best, *near], key=lambda f: float(f.evidence.loss.mean()))
    if first is not best:
        # Beside another member the rest is challenged anew: each exchange leaves less, so this ends.
        return challenged(problem, world, first, rough, far)
    return best, [f for f in near if is_tied(f, best, UNSURE)]


def _choices(held: Members, rough: Responses) -> list[Members]:
    """Return the sets with one member exchanged for each value of each choice: what is left may be another's doing.

    The others made up for what is missing, and must move before a choice shows what it is worth.
    """
    names = {c.name for c, _ in held}
    each = [
        (c, u)
        for c, response in rough
        if isinstance(response, Curve) and c.choices and c.name not in names
        for u in response.at[:, None]
        if not c.is_neutral(u)
    ]
    return [tuple(choice if m is left else m for m in held) for left in held for choice in each]


def _nearest(
    problem: Problem, held: Members, others: Sequence[Members], choices: Sequence[Members] = (), much: bool = False
) -> list[Members]:
    """Return the sets with one member exchanged that explain about as much once refitted, on a few episodes.

    By simulated slopes: signatures say little of what an effect does beside others. (In place of a tracker's bias, a
    support's height left 2.1 floors by signatures, and 1.2 by these, where the bias left 1.3.) Of those with another
    choice the first are: a solver's `impratio` began where it had made up for a cone, and signatures moved it nowhere:
    2.9 floors; simulated slopes led to 0.9, where less friction in the cone's place left 1.4. Where `much` is left, so
    are the first of all: an object's size left 6.3 floors where two joints' offsets stood, 0.25, and 0.14 once a
    tracker's bias, 1 mm off, moved along.
    """
    own = by_loss(problem, [held])[0][0]
    least = {
        c.label: HALFWAY * (float(problem.score.loss(z).mean()) - own) + own
        for (c, _), z in zip(held, problem.without_each(held), strict=True)
    }
    base = problem.score.loss(problem.nominal)
    far = own + ALIKE * (float(base.mean()) - own)
    worthy = []
    for loss, members in by_loss(problem, others):
        labels = {c.label for c, _ in members}
        (left,) = (label for label in least if label not in labels)
        if much or loss < max(least[left], far):
            worthy.append(members)
    refitted = [joint(problem, members, base, WIDTHS[:1]).members for members in worthy[:ADDED]]
    refitted += [joint(problem, members, base, WIDTHS[:2]).members for _, members in lightly(problem, choices)[:ADDED]]
    return [members for loss, members in by_loss(problem, refitted)[:RIVALS] if loss < far] if refitted else []


def lightly(problem: Problem, sets: Sequence[Members]) -> list[tuple[float, Members]]:
    """Return sets where they are fitted lightly, with the loss that they leave, the least first.

    Of a setting whose values have an order, such as a time step, the values on either side of the scene's own come
    first, then farther ones where that leaves less, while it does: what such a setting does grows with it.
    """
    done = []
    for near, far in _outwards(sets):
        first = [lightly_fitted(problem, members) for members in near]
        done += first
        side = int(np.argmin([loss for loss, _ in first]))
        best = first[side][0]
        for members in far[side]:
            done.append(lightly_fitted(problem, members))
            if done[-1][0] >= best:
                break
            best = done[-1][0]
    return sorted(done, key=lambda pair: pair[0])


def lightly_fitted(problem: Problem, members: Members, widths: Sequence[float] = ()) -> tuple[float, Members]:
    """Return the loss that a set leaves where it is fitted, by signatures if no widths are given, and the set there."""
    fit = joint(problem, members, problem.score.loss(problem.nominal), widths)
    return float(problem.score.loss(fit.plane.z).mean()), fit.members


def _outwards(sets: Sequence[Members]) -> list[tuple[list[Members], list[list[Members]]]]:
    """Return sets that differ in the value of one ordered setting, those next to neutral and beyond on each side; a set
    without one is alone.
    """
    groups: dict[tuple[tuple[str, bytes], ...], list[tuple[float, Members]]] = {}
    for i, members in enumerate(sets):
        away = [float((u - c.neutral)[0]) for c, u in members if c.is_ordered]
        same = tuple((c.label, u.tobytes() if c.choices and not c.is_ordered else b"") for c, u in members)
        groups.setdefault(same if away else ((str(i), b""),), []).append((sum(away), members))
    out = []
    for some in groups.values():
        some.sort(key=lambda pair: abs(pair[0]))
        sides = [[members for away, members in some if (away < 0) is below] for below in (True, False)]
        out.append(([side[0] for side in sides if side], [side[1:] for side in sides if side]))
    return out


def aliases(problem: Problem, best: Fit, rivals: Sequence[Fit]) -> list[Fit]:
    """Return the set and those that have an alias in place of one of its members, which each lead; nothing without one.

    An alias leaves more by next to nothing of what the member is worth, less than fits are sharp. A member that is
    worth little beside the others is named although it has one, as its rival: what most of the gap is due to is known.
    """
    if not rivals:
        return []
    own = float(problem.score.loss(best.plane.z).mean())
    worths = [float(problem.score.loss(z).mean()) - own for z in problem.without_each(best.members)]
    for label, worth in zip(best.labels, worths, strict=True):
        if worth < MINOR * max(worths):
            continue
        blunt = BLUNT * worth
        instead = [(f, name) for f in rivals if label not in f.labels for name in f.labels if name not in best.labels]
        same = [f.led_by(name) for f, name in instead if float((f.evidence.loss - best.evidence.loss).mean()) <= blunt]
        if same:
            return [best.led_by(label), *same]
    return []


def by_loss(problem: Problem, sets: Sequence[Members]) -> list[tuple[float, Members]]:
    """Return sets with the loss that they leave where they are simulated, the least first."""
    zs = problem.residuals([problem.setting(members) for members in sets])
    losses = [float(problem.score.loss(z).mean()) for z in zs]
    return sorted(zip(losses, sets, strict=True), key=lambda pair: pair[0])


def here_of(problem: Problem, fit: Fit) -> Compact:
    """Return the residuals `(E, K)` where a fit is; a plane was simulated there, a curve perhaps beside it."""
    if isinstance(fit.response, Plane):
        return fit.response.z
    ((_, u),) = fit.members
    return fit.response.read(u) if fit.response.was_simulated(u) else residuals_at(problem, fit.members)


def residuals_at(problem: Problem, members: Members) -> Compact:
    """Return the residuals `(E, K)` where effects act."""
    return problem.residuals([problem.setting(members)])[0]


def pieces_of(fit: Fit, here: Compact, index: Index) -> Responses:
    """Return how residuals `here (E, K)` of some episodes change with each member of a fit around where it is."""
    if isinstance(fit.response, Plane):
        slope = fit.response.slope
    else:
        ((c, u),) = fit.members
        slope = slope_of(c, fit.response, u, WITHIN)
    ends = np.cumsum([c.size for c, _ in fit.members])[:-1]
    own = np.split(slope[:, index], ends)
    return [(c, Plane(c.low, c.high, u, here, each)) for (c, u), each in zip(fit.members, own, strict=True)]
