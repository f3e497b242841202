"""Sets of causes: grown one by one, all fitted together where three leave a gap, early members exchanged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from candata.gap.added import ADDED, ALIKE, here_of, lightly, lightly_fitted, pieces_of, residuals_at, together
from candata.gap.candidates import Candidate
from candata.gap.compare import RIVALS, UNSURE, is_near, is_tied, standard_error
from candata.gap.elsewhere import moved
from candata.gap.mending import Doubt, Mended
from candata.gap.outlook import further
from candata.gap.own_floor import Grown, judged, refitted, rescored
from candata.gap.pace import ANOTHER, BESIDE, JOINT, REST
from candata.gap.refine import WIDTHS, joint
from candata.gap.score import Compact
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief, gains_share, looked_into
from candata.gap.sparse import sparse
from candata.gap.stage import Stage, as_simulated, look, unheld
from candata.gap.together import Responses, Sum, beside
from candata.gap.trials import are_worth_two, paired, shared, sharp, sharpest
from candata.gap.worth import (
    EXTRA,
    FAINT,
    LARGEST,
    LEFT,
    MOST,
    OPEN,
    extra_of,
    has_room,
    is_full,
    is_next,
    leaves,
    left_by,
    worth_adding,
)
from candata.scenes.traits import is_toss

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Times the gain of all that a member of that fit may be worth. Chosen: true members were worth 1.15 at most; of four
#: names given to a friction that no effect is, damping of the joints 2.9 and less damping of the servos 2.4.
CANCELS = 2.0
#: Beside other causes signatures are believed where the best candidate gains this share of what is left, or where less
#: than `LEFT` is; else every effect is simulated there on a few episodes. Chosen: beside a delay of 40 ms, damping of
#: contacts promised nothing and was worth all of the 3.4 floors left, and torsional friction all of 0.4.
BELIEVED = 0.5
#: Floors that must be left for a search to be made again, or two effects to be taken in place of one. Chosen.
SETTLED = 0.5
#: Share of the best promise from which a rival joins a set on trial, by a fit that simulates no slopes. Chosen: where a
#: true scale of the tracker promised 0.83 of what a bias did, it gained more.
ROUGHLY = 0.7
#: Share of the best gain that the next best effect must have to be tried in its place, with a third. Chosen.
NEXT = 0.5
#: Share of what a set gains that it must leave for others to be tried in place of what was found early; what is near is
#: tried at the end, too. Chosen: of two sets that left 0.07 and 0.10 it took 27 and 23 CPU s and changed nothing.
RETRIED = 0.1
#: Times what a name is worth that slopes may promise members to be worth, for the others to be fitted without them.
#: Chosen: slopes of what makes up for one another promise too much.
HOPELESS = 4.0


def forward(
    problem: Problem, best: Fit, alone: Sequence[Fit], rough: Responses = (), doubt: Doubt | None = None
) -> tuple[Grown, Mended | None]:
    """Return the best set that grows from `best`, and the force that ends its growth, None where none does.

    Grows while the held-out loss lies above the nulls of the world found so far and another effect passes. First tried
    is a set to whose signatures, `rough` on a few episodes, the recording adds up. Where a gap is left, what was taken
    early is looked at again beside what came later, and two of the fits `alone` together. Where signatures promise too
    little of what is left, or a full set leaves much, a `doubt` that stands ends it; beside a full set all effects are
    fitted together first, and where many little things remain, no gap is left to be looked into.
    """
    while True:
        first = best
        world, best = rescored(problem, best)
        world.sofar.best = best
        remains = leaves(world, best)
        sharper = refitted(problem, first, world, best) if remains else None
        if sharper is not None:
            best, remains = sharper, leaves(world, sharper)
        if not remains or not (has_room(best) or left_by(best) > FAINT):
            return (best, world, remains), None
        other, rough = together(problem, first, rough) if has_room(best) else None, ()
        if other is not None:
            best = other
            continue
        seems = has_room(best) or gains_share(world, here_of(world, best), unheld(world, best.members), best.members)
        if not seems and world.plays_all:
            return (best, world, remains), None
        words = f"{', '.join(best.labels)} found, looking for what is beside"
        world.pace.say(words, ANOTHER, after=max(further(world, len(best.members)) - ANOTHER.most, REST.most))
        full = is_full(best.members, problem.measured)
        found = standing(world, best, doubt) if full else _next(world, best, seems, doubt)
        if isinstance(found, Mended):
            return (best, world, remains), found
        grown = found
        tasks = world.recs.tasks
        sharper = _sharper(world, best, grown) if grown is not None and is_next(best, grown, tasks) else None
        if grown is not None and sharper is not None and not is_next(sharper, grown, tasks):
            problem, best = world, sharper
            continue
        if grown is None or not is_next(best, grown, tasks):
            if joins_first(world, best):
                fitted = jointly(world, best)
                if fitted[0] is not best or not fitted[-1]:
                    return fitted, None
            if left_by(best) > RETRIED * best.gain:
                world.pace.told("trying other effects in place of what was found early")
                # But of tosses, each member of what is found is challenged in the end, for less.
                grown = (_further(world, best, grown) or _swapped(world, best)) if world.plays_all else None
                grown = grown or moved(world, best) or shared(world, best, alone)
                grown = grown or paired(world, best, alone) or _retraced(world, best)
            else:
                grown = moved(world, best)
        if grown is None:
            return (best, world, remains), None
        problem, best = world, grown


def joins_first(problem: Problem, best: Fit) -> bool:
    """Tell whether a joint fit is tried before other members in the place of those of a set: of full ones, not tosses'.

    Where everything is a little wrong, no three effects explain it, and a joint fit tells so for a fraction of what
    trying others in the place of each costs.
    """
    return is_full(best.members, problem.measured) and not problem.plays_all


def compared(problem: Problem, chosen: Fit, tied: list[Fit], remains: bool) -> tuple[list[Fit], Grown]:
    """Return which of tied first causes are still tied beside what else was found, the best first, and the best set.

    Alone they were compared under all that the other causes do.
    """
    first = tied[0].members[0][0]
    others = tuple(m for m in chosen.members if m[0].label != first.label)
    if len(others) == len(chosen.members):
        return tied[:1], (chosen, problem, remains)
    base = problem.score.loss(problem.nominal)
    rivals = [f for f in tied[1:] if f.members[0][0].name not in {c.name for c, _ in others}]
    pairs = [(tied[0], chosen), *((f, joint(problem, (*others, f.members[0]), base)) for f in rivals)]
    pairs.sort(key=lambda pair: float(pair[1].evidence.loss.mean()))
    best = pairs[0][1]
    left = [f for f, fit in pairs if is_tied(fit, best)]
    return left, (chosen, problem, remains) if best is chosen else judged(problem, best)


def standing(problem: Problem, best: Fit, doubt: Doubt | None) -> Mended | None:
    """Return the force that stands against a set that leaves something to speak of; None where none does."""
    return doubt.of(problem, here_of(problem, best)) if doubt and left_by(best) > LEFT else None


def _next(problem: Problem, best: Fit, seems: bool = True, doubt: Doubt | None = None) -> Fit | Mended | None:
    """Return the best set with one more effect: what passes, or a near rival of it; None where nothing passes.

    `seems` tells whether signatures are worth a look: of a large gap of which little is left, what promises nothing by
    them is simulated at once. The force of a doubt that stands, where they promise too little.
    """
    seeing = _beside(problem, best.members, here_of(problem, best), seems, partial(standing, problem, best, doubt))
    if isinstance(seeing, Mended):
        return seeing
    stage, seen = seeing
    front = _front(best, stage)
    if is_toss(problem.replayer.scene):
        return sharp(problem, front)
    some = brief(seen)
    now, sums = _moved_along(problem, best, as_simulated(seen, stage), some)
    found = sharp(problem, _moving(some[0], front, now, sums), best)
    if found is not None and is_next(best, found, problem.recs.tasks):
        return found
    return _along(problem, best, some[0], now, sums) or found


def _front(best: Fit, stage: Stage) -> list[Members]:
    """Return the set with the effect that passes, and with near rivals of it; nothing where nothing passes."""
    if stage.passing() is None:
        return []
    near = [f for f in stage.fits if f.gain > ROUGHLY * stage.best_gain or is_near(f, stage.fits[0])]
    return [(*best.members, f.members[0]) for f in near[: 1 + RIVALS]]


def _moved_along(
    problem: Problem, best: Fit, rough: Responses, some: tuple[Problem, Index]
) -> tuple[float, Sequence[Sum]]:
    """Return the loss of a set on a few episodes, and what each further effect leaves once what is held moves along.

    The responses `rough` are of `some` of the episodes.
    """
    part, index = some
    here = here_of(problem, best)[index]
    return float(part.score.loss(here).mean()), beside(part, here, pieces_of(best, here, index), rough)


def _moving(part: Problem, front: Sequence[Members], now: float, sums: Sequence[Sum]) -> list[Members]:
    """Return the sets of `front`, each where it begins better, and those that explain a few episodes about as well.

    In whose place what is held has moved promises little where that stands. (Beside a tracker's bias, read 1 mm off, an
    object's true size promised 1.0 of 4.2 floors, and one joint's offset 3.5; where the bias moves along, the size
    leaves less.) `now` and `sums` are those of `_moved_along`.
    """
    best = {one.members[-1][0].label: one for one in reversed(sums) if one.loss < now}
    first = sorted(best.values(), key=lambda one: one.loss)[:ADDED]
    losses = [lightly_fitted(part, members)[0] for members in front]
    pairs = [*zip(losses, front, strict=True), *(lightly_fitted(part, one.members) for one in first)]
    begun: dict[str, tuple[float, Members]] = {}
    for loss, members in pairs:
        label = members[-1][0].label
        if label not in begun or loss < begun[label][0]:
            begun[label] = loss, members
    passed = [begun.pop(members[-1][0].label) for members in front]
    near = passed[0][0] + ALIKE * max(now - passed[0][0], 0.0) if passed else now
    others = [pair for pair in sorted(begun.values(), key=lambda pair: pair[0]) if pair[0] < near]
    return [members for _, members in (*passed, *others[:RIVALS])]


def _along(problem: Problem, best: Fit, part: Problem, now: float, sums: Sequence[Sum]) -> Fit | None:
    """Return the set with the one more effect that explains most once what is held moves along; None of none.

    What is held makes up for what is missing: where it stands, the missing cause may gain nothing. (A tracker's bias,
    read 4 mm off, hid a friction cone worth 2 floors.) Each value of a choice is fitted whatever is read off: nothing
    lies between. (Of time steps, 3.3 ms promised more than the true 5 ms, and took too little for a name.) The best of
    each choice is fitted by simulated slopes: signatures are those of other solver settings. (Beside a pyramidal cone
    an `impratio` that had made up for it moved nowhere and left 0.66 floors, by simulated slopes none.)
    `now` and `sums` are those of `_moved_along`, on the episodes of `part`.
    """
    tried = [one for i, one in enumerate(sums) if (i < ADDED and one.loss < now) or one.members[-1][0].choices]
    fitted = lightly(part, [one.members for one in tried])
    choices = {members[-1][0].name: members for _, members in reversed(fitted) if members[-1][0].choices}
    others = [pair for pair in fitted if pair[1] is not choices.get(pair[1][-1][0].name)]
    sharper = [lightly_fitted(part, members, WIDTHS[:1]) for members in choices.values()]
    front = sorted((*others, *sharper), key=lambda pair: pair[0])[: 1 + RIVALS]
    base = problem.score.loss(problem.nominal)
    grown = [joint(problem, members, base, widths=()) for loss, members in front if loss < now]
    return sharpest(problem, [f for f in grown if is_next(best, f, problem.recs.tasks)])


def _sharper(problem: Problem, best: Fit, grown: Fit) -> Fit | None:
    """Return `best` refitted from where its members are in a grown set; None where they explain no more there.

    A fit that is not at its sharpest leaves what every further effect seems to take.
    """
    own = tuple(m for m in grown.members if m[0].label in best.labels)
    before = float(problem.score.loss(here_of(problem, best)).mean())
    if float(problem.score.loss(residuals_at(problem, own)).mean()) >= before:
        return None
    found = joint(problem, own, problem.score.loss(problem.nominal), WIDTHS[1:])
    return found if found.gain > best.gain else None


def _beside(
    problem: Problem, members: Members, here: Compact, seems: bool, force: Callable[[], Mended | None] = lambda: None
) -> tuple[Stage, Problem] | Mended:
    """Return the evidence of every candidate beside effects whose residuals are `here (E, K)`, and how it was seen.

    They are simulated there where signatures promise little, unless a `force` stands against the effects; and count if
    they promise more. (Beside a torque limit the object stays down, and a tracker that lags by 43 ms promised nothing
    of the 0.18 floors left, all its own.)
    """
    stage = look(problem, here, members) if seems else None
    if stage is not None and (problem.plays_all or _is_promising(stage)):
        return stage, problem
    if stands := force():
        return stands
    problem.pace.say("simulating every effect beside these on the recording itself", BESIDE)
    simulated = looked_into(problem, here)
    other = look(simulated, here, members, stage)
    return (other, simulated) if stage is None or other.best_gain > stage.best_gain else (stage, problem)


def _is_promising(stage: Stage) -> bool:
    """Tell whether the effects beside others promise enough of what these leave."""
    left = float(stage.base.mean()) - 1
    return left < LEFT or stage.best_gain > BELIEVED * left


def _further(problem: Problem, best: Fit, grown: Fit | None) -> Fit | None:
    """Return the set with two more effects: the next one, which takes too little by itself, and what it makes room for.

    None where the two are not worth their names. (In one split of cube tosses inertia took 0.148 of the 0.150 floors
    asked for, and beside it the contact's compliance takes 0.5.)
    """
    if grown is None or not worth_adding(extra_of(best, grown), best.gain) or is_full(grown.members, problem.measured):
        return None
    found = _next(problem, grown)
    if found is None or isinstance(found, Mended):
        return None
    return found if are_worth_two(best, found) else None


def _swapped(problem: Problem, best: Fit) -> Fit | None:
    """Return the set with an early member exchanged for what explains more beside the others; None where none does.

    The first of several causes is chosen while the others are missing; the last one was chosen beside all others. Not
    tried where each candidate is simulated on the recording: a look takes minutes there.
    """
    if problem.simulated:
        return None
    base = problem.score.loss(problem.nominal)
    for left in [m for m in best.members[:-1] if m[0].name not in {c.name for c, _ in problem.measured}]:
        others = tuple(m for m in best.members if m is not left)
        found = look(problem, residuals_at(problem, others), others).passing()
        if found is None or found.labels[0] == left[0].label:
            continue
        fit = joint(problem, (*others, found.members[0]), base)
        if worth_adding(best.evidence.loss - fit.evidence.loss, best.gain):
            return fit
    return None


def _retraced(problem: Problem, best: Fit) -> Fit | None:
    """Return the set with the next best effect in place of its last one and one more; None where that is no better.

    What was taken second was chosen while a third was missing: its rival may need the third to show what it is worth.
    """
    room = len(best.members) > 1 and not is_full(best.members, problem.measured)
    if problem.simulated or not room or left_by(best) < SETTLED:
        return None
    held, (last, _) = best.members[:-1], best.members[-1]
    stage = look(problem, residuals_at(problem, held), held)
    rivals = [f for f in stage.fits if f.members[0][0].name != last.name and f.gain > NEXT * stage.best_gain]
    if not rivals:
        return None
    other = joint(problem, (*held, rivals[0].members[0]), problem.score.loss(problem.nominal))
    grown = _next(problem, other)
    if grown is None or isinstance(grown, Mended):
        return None
    return grown if is_next(best, grown, problem.recs.tasks) else None


def with_measured(problem: Problem, best: Fit, remains: bool) -> Grown:
    """Return the set joined by what was measured directly: it needs no gain to be believed."""
    new = tuple((c, u) for c, u in problem.measured if c.name not in {m.name for m, _ in best.members})
    if not new:
        return best, problem, remains
    return judged(problem, joint(problem, (*best.members, *new), problem.score.loss(problem.nominal)))


def jointly(problem: Problem, best: Fit) -> Grown:
    """Return the joint fit over all effects where it closes clearly more than `best`, which is returned otherwise.

    Many names that leave most of the gap open are names at random, and so are such as make up for one another: then
    `best` stands too. Where beside a full set more names explain more, but together surely less than one is worth, what
    remains is many little things: no gap to be looked into.
    """
    base = problem.score.loss(problem.nominal)
    left = left_by(best)
    if not (left > OPEN and has_room(best)):
        return best, problem, True
    problem.pace.say("fitting all effects together", JOINT)
    least = MOST * float((base - 1).mean())
    found = sparse(problem, best, base, least)
    if found is None or found.gain < least:
        return best, problem, True
    extra = extra_of(best, found)
    if not worth_adding(extra, best.gain):
        return best, problem, not (is_full(best.members, problem.measured) and _are_little(extra, found, best))
    fewest = _rebuilt(problem, found, base)
    fewest = moved(problem, fewest) or fewest
    return (best, problem, True) if _cancels(problem, fewest) else judged(problem, fewest)


def _are_little(extra: Array, found: Fit, best: Fit) -> bool:
    """Tell whether many names gain something beyond a set, `extra (E,)`, and surely less than one name is worth."""
    most = extra.mean() + standard_error(extra)
    return len(found.members) > LARGEST and extra.mean() >= 0 and bool(most <= EXTRA * best.gain)


def _cancels(problem: Problem, fit: Fit) -> bool:
    """Tell whether a member only makes up for the others: without it, far more would be wrong than without all."""
    without = max(float(problem.score.loss(z).mean()) for z in problem.without_each(fit.members))
    return without - float(problem.score.loss(fit.plane.z).mean()) > CANCELS * fit.gain


def _rebuilt(problem: Problem, found: Fit, base: Array) -> Fit:
    """Return the fewest of the most worthy members of a joint fit that explain as much, refitted; itself if none do.

    Together, numbers that are a little off make up for one another; alone, the true ones need no such help.
    """
    losses = [problem.score.loss(z).mean() for z in problem.without_each(found.members)]
    order = [found.members[i] for i in np.argsort(losses)[::-1]]
    for count in range(1, min(LARGEST, len(order) - 1) + 1):
        # Each of a few names must be worth one; where everything is a little wrong, many are worth little each.
        names = len(order) - count if len(order) <= LARGEST else 1
        if _promised_without(problem, found, order[count:]) / names > HOPELESS * EXTRA * found.gain:
            continue
        fit = joint(problem, tuple(order[:count]), base)
        if is_tied(fit, found, UNSURE):
            return fit
    return found


def _promised_without(problem: Problem, found: Fit, left: Sequence[tuple[Candidate, Array]]) -> float:
    """Return how much more is left without some members, as slopes promise it once the others are refitted."""
    others = found.plane_without(left).least()
    return float((problem.score.loss(others) - problem.score.loss(found.plane.z)).mean())
