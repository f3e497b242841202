"""The search: sets of effects compete in rungs of fidelity, and one rule says which takes another's place.

    proposed   by a move, with values from signatures; nothing is simulated
    shown      one replay of a few episodes
    moved      fitted to the few episodes, by slopes that are simulated over the widest width
    sharp      fitted to all episodes, by slopes that are simulated over narrower ones; only these are taken

A rung costs several times what the one before it does, and lets few sets through.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.acceptance import MOST, is_better, is_full, leaves, left_by
from candata.gap.fit.comparison import BLUNT, UNSURE, is_tied
from candata.gap.fit.fits import Fit, Members, key_of
from candata.gap.fit.problem import Problem
from candata.gap.fit.world_floor import in_units, rescored
from candata.gap.moves import MOVES, Move
from candata.gap.moves._view import View
from candata.gap.screening.episodes import brief
from candata.gap.screening.refinement import joint
from candata.gap.screening.set_slopes import WIDTHS
from candata.gap.screening.sums import Responses

Array = NDArray[np.float64]
#: Mean loss [floors] of the few episodes, and a set that leaves it.
Ranked = tuple[float, Members]
#: Sets larger than the incumbent, and sets no larger, that go on from each rung: a beam. Chosen for cost.
SHOWN, MOVED = 6, 2
#: Share of the loss that the incumbent explains which a set may leave beyond the incumbent's and go on, from the rungs
#: `shown` and `moved`: what fits of these rungs are off by. Chosen.
OFF_SHOWN, OFF_MOVED = 0.3, 0.1
#: Share of what the incumbent leaves which larger sets must take where they are shown, else a force is asked first.
#: Chosen for cost: playing a force and fitting such sets each take some tens of replays.
PROMISING = 0.25
#: Larger sets from which the search proposes where nothing takes the incumbent's place. Chosen for cost.
AHEAD = 2
#: Most rounds: a guard, since each takes another set or is one of the last two.
ROUNDS = 12
#: Share of the member worth most that one must be worth for its aliases to leave the whole set ambiguous. Chosen.
MINOR = 0.25


@dataclass(frozen=True)
class Search:
    """What a search knows.

    Attributes
    ----------
    root : Problem
        In units of the nominal world's floor.
    world : Problem
        In units of the floor of the incumbent's world.
    incumbent : Fit
        The set that no other took the place of, in the units of `world`.
    visited : dict
        Sets that were fitted sharply, by their keys, in the units of `root`.
    seen : frozenset
        Keys of all sets that were shown.
    """

    root: Problem
    world: Problem
    incumbent: Fit
    visited: dict[tuple[str, ...], Fit] = field(default_factory=dict)
    seen: frozenset[tuple[str, ...]] = frozenset()

    @property
    def remains(self) -> bool:
        """Whether the incumbent leaves more than nulls of its world."""
        return leaves(self.world, self.incumbent)

    def rivals(self) -> list[Fit]:
        """Return the visited sets of as many names that cannot be told from the incumbent, the best first."""
        own, size = self.incumbent.key, len(self.incumbent.members)
        same = [f for key, f in self.visited.items() if key != own and len(f.members) == size]
        near = [f for f in (in_units(f, self.root, self.world) for f in same) if is_tied(f, self.incumbent, UNSURE)]
        return sorted(near, key=lambda f: float(f.evidence.loss.mean()))


def search(problem: Problem, first: Fit, alone: Responses, ends: Callable[[Problem, Fit], bool]) -> Search:
    """Return the search that begins with a set of effects.

    Parameters
    ----------
    problem : Problem
    first : Fit
        In units of the problem's floor.
    alone : sequence of (Candidate, Curve or Plane)
        Every effect alone on a few episodes.
    ends : callable
        Asked once about an incumbent that leaves a gap, in units of its own world, where larger sets promise little or
        none takes its place. The search ends if it returns true.
    """
    world, best = rescored(problem, first)
    state = Search(problem, world, best)
    front, is_asked = [best], False
    for _ in range(ROUNDS):
        problem.sofar.best = state.incumbent
        state, shown = _shown(state, front, alone, tuple(MOVES.values()))
        if state.remains and not is_asked and not shown.promises():
            is_asked = True
            if ends(state.world, state.incumbent):
                break
        state, fitted = _fitted(state, shown)
        challenger = _challenger(state, fitted)
        if challenger is not None:
            state = _crowned(state, challenger)
            front, is_asked = [state.incumbent], False
            problem.pace.told(f"{', '.join(state.incumbent.labels)} found, looking for what is beside")
            continue
        larger = [f for f in fitted if len(f.members) > shown.size and not is_full(f.members, problem.measured)]
        if not state.remains or front[0] is not state.incumbent:
            break
        if (not is_asked and ends(state.world, state.incumbent)) or not larger:
            break
        front, is_asked = larger[:AHEAD], True
    return state


def begun(problem: Problem, first: Fit, alone: Responses) -> Fit | None:
    """Return the set of several effects to whose signatures the recording adds up, if it takes most of what is left.

    That is left by `first`, the best effect alone; None if no set does.
    """
    state = Search(problem, problem, first)
    state, shown = _shown(state, [first], alone, (MOVES["pair"],))
    _, fitted = _fitted(state, shown)
    return _challenger(state, [f for f in fitted if left_by(f) < MOST * left_by(first)])


def aliases(problem: Problem, best: Fit, rivals: Sequence[Fit]) -> list[Fit]:
    """Return the set and those that have an alias in place of one of its members, which each lead; nothing without one.

    An alias leaves more by less of what the member is worth than fits are sharp. A member that is worth little beside
    the others is named although it has one, as its rival: what most of the gap is due to is known.
    """
    if not rivals:
        return []
    now = float(problem.score.loss(best.plane.z).mean())
    worths = [float(problem.score.loss(z).mean()) - now for z in problem.without_each(best.members)]
    for label, worth in zip(best.labels, worths, strict=True):
        if worth < MINOR * max(worths):
            continue
        instead = [(f, name) for f in rivals if label not in f.labels for name in f.labels if name not in best.labels]
        more = [float((f.evidence.loss - best.evidence.loss).mean()) for f, _ in instead]
        same = [f.led_by(name) for (f, name), worse in zip(instead, more, strict=True) if worse <= BLUNT * worth]
        if same:
            return [best.led_by(label), *same]
    return []


def _crowned(state: Search, fit: Fit) -> Search:
    """Return the search with another incumbent, in units of the floor of its world."""
    world, best = rescored(state.root, in_units(fit, state.world, state.root))
    return replace(state, world=world, incumbent=best)


def _challenger(state: Search, fitted: Sequence[Fit]) -> Fit | None:
    """Return the set that takes the incumbent's place, None if none does. Sets with few names come first."""
    best = state.incumbent
    for fit in sorted(fitted, key=lambda f: len(f.members)):
        if is_better(best, fit, state.world.recs.tasks):
            best = fit
    return None if best is state.incumbent else best


@dataclass(frozen=True)
class Shown:
    """What moves proposed, simulated on a few episodes.

    Attributes
    ----------
    part : Problem
        The few episodes.
    ranked : list of (loss, Members)
        The least loss first, each set of names once.
    size : int
        How many effects the incumbent holds.
    now, explained : float
        Mean loss [floors] that the incumbent leaves of these episodes, and what it explains of them.
    """

    part: Problem
    ranked: list[Ranked]
    size: int
    now: float
    explained: float

    def promises(self) -> bool:
        """Tell whether a larger set takes a part of what the incumbent leaves."""
        larger = [loss for loss, members in self.ranked if len(members) > self.size]
        return self.now - min(larger, default=self.now) > PROMISING * (self.now - 1)


def _shown(state: Search, front: Sequence[Fit], alone: Responses, moves: Sequence[Move]) -> tuple[Search, Shown]:
    """Return the search and what moves propose from some sets and was not shown before."""
    world = state.world
    part, index = brief(world)
    views = [View(state.root, world, part, index, fit, alone, state.remains) for fit in front]
    proposed = [m for view in views for move in moves for m in move(view) if key_of(m) not in state.seen]
    zs = part.residuals([part.setting(members) for members in proposed]) if proposed else []
    losses = [float(part.score.loss(z).mean()) for z in zs]
    order = sorted(zip(losses, proposed, strict=True), key=lambda pair: -pair[0])
    best = {key_of(members): (loss, members) for loss, members in order}
    ranked = sorted(best.values(), key=lambda pair: pair[0])
    now = float(part.score.loss(world.where(state.incumbent)[index]).mean())
    explained = max(float(part.score.loss(part.nominal).mean()) - now, 0.0)
    seen = state.seen | {key_of(m) for m in proposed}
    return replace(state, seen=seen), Shown(part, ranked, len(state.incumbent.members), now, explained)


def _fitted(state: Search, shown: Shown) -> tuple[Search, list[Fit]]:
    """Return the search and the sets that were fitted sharply, in units of its world, those that leave least first."""
    world, part = state.world, shown.part
    near = _kept(shown.ranked, shown.size, SHOWN, shown.now + OFF_SHOWN * shown.explained)
    moved = sorted((_moved(part, members) for _, members in near), key=lambda pair: pair[0])
    moved = _kept(moved, shown.size, MOVED, shown.now + OFF_MOVED * shown.explained)
    base = world.score.loss(world.nominal)
    sharp = [joint(world, members, base, WIDTHS[1:]) for _, members in moved]
    new = {f.key: in_units(f, world, state.root) for f in sharp}
    state = replace(state, visited={**state.visited, **new})
    return state, sorted(sharp, key=lambda f: float(f.evidence.loss.mean()))


def _moved(problem: Problem, members: Members) -> Ranked:
    """Return a set fitted by slopes over the widest width, with the loss that it leaves."""
    fit = joint(problem, members, problem.score.loss(problem.nominal), WIDTHS[:1])
    return float(problem.score.loss(fit.plane.z).mean()), fit.members


def _kept(ranked: Sequence[Ranked], size: int, most: int, far: float) -> list[Ranked]:
    """Return the sets of a rung that go on, of those that leave less than `far`: some larger than `size`, some not.

    Each number of names has an equal part of the places: a set without an idle name leaves hardly more than with it,
    and would else have none.
    """
    near = sorted((pair for pair in ranked if pair[0] < far), key=lambda pair: len(pair[1]))
    kept: list[Ranked] = []
    for is_larger in (True, False):
        some = [pair for pair in near if (len(pair[1]) > size) is is_larger]
        groups = [list(pairs) for _, pairs in groupby(some, key=lambda pair: len(pair[1]))]
        kept += [pair for group in groups for pair in group[: max(most // len(groups), 1)]]
    return kept
