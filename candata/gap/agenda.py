"""The search: sets of effects compete in rungs of fidelity, and one rule says when a set takes another's place.

    proposed   by a move, with values from signatures; nothing is simulated
    shown      one replay of a few episodes
    moved      fitted to the few episodes, by slopes that are simulated over the widest width
    sharp      fitted to all episodes, by slopes that are simulated over narrower ones; only these can be taken

What each rung lets through costs several times what the rung before it does, so that each keeps few.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.added import by_loss, here_of, lightly_fitted
from candata.gap.compare import UNSURE, is_tied
from candata.gap.folds import cross_fit
from candata.gap.likelihood import is_better, names_key
from candata.gap.moves import MOVES, Move
from candata.gap.moves.view import View
from candata.gap.own_floor import rescored
from candata.gap.refine import WIDTHS, joint
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief
from candata.gap.together import Responses
from candata.gap.worth import MOST, leaves, left_by

Array = NDArray[np.float64]
#: How many sets of a kind (larger than the incumbent, or not) go on from each rung: a beam.
SHOWN, MOVED, SHARP = 6, 3, 2
#: Share of the loss above the floor that is explained by which a set may leave more than the incumbent and go on, from
#: the rungs `shown` and `moved`: what such fits are off by.
OFF_SHOWN, OFF_MOVED = 0.3, 0.1
#: Sets from which the search proposes where no proposal of the incumbent is taken.
FRONT = 3
#: Rounds at most, a guard: each takes another set or ends.
ROUNDS = 12


def never(problem: Problem, fit: Fit) -> bool:
    """Return false: nothing ends a search but that no set takes another's place."""
    return False


def trace(text: str) -> None:
    if os.environ.get("TRACE"):
        print("   ", text, f"[{time.process_time():.1f}]", flush=True)


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
        In the units of `world`.
    visited : dict
        The sets that were fitted sharply, by names, in the units of `root`.
    seen : frozenset
        Names of all sets that were shown.
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

    def in_world(self, fit: Fit) -> Fit:
        """Return a visited fit in the units of the incumbent's world."""
        return in_units(fit, self.root, self.world)

    def rivals(self) -> list[Fit]:
        """Return the visited sets of as many names that cannot be told from the incumbent, the best first."""
        own, size = names_key(self.incumbent.members), len(self.incumbent.members)
        same = [self.in_world(f) for key, f in self.visited.items() if key != own and len(f.members) == size]
        near = [f for f in same if is_tied(f, self.incumbent, UNSURE)]
        return sorted(near, key=lambda f: float(f.evidence.loss.mean()))


def in_units(fit: Fit, old: Problem, new: Problem) -> Fit:
    """Return a fit in the units of another floor; it is cross-fitted there again."""
    if old is new:
        return fit
    factor = np.where(new.score.mask, old.score.sigma / new.score.sigma, 0).astype(np.float32)
    response = fit.response.rescaled(factor)
    return replace(
        fit, response=response, evidence=cross_fit(response, new.score, new.parts, new.score.loss(new.nominal))
    )


def search(problem: Problem, first: Fit, alone: Responses, ends: Callable[[Problem, Fit], bool] = never) -> Search:
    """Return the search that begins with a set of effects.

    Parameters
    ----------
    problem : Problem
    first : Fit
        In units of the problem's floor.
    alone : sequence of (Candidate, Curve or Plane)
        Every effect alone on a few episodes.
    ends : callable
        Called once with a set that no proposal takes the place of though it leaves a gap; the search ends where it
        returns true, else it looks ahead.
    """
    world, best = rescored(problem, first)
    state = Search(problem, world, best, {names_key(first.members): first})
    front: list[Fit] = [best]
    for _ in range(ROUNDS):
        state, fitted = _round(state, front, alone, tuple(MOVES.values()))
        challenger = _best(state, fitted)
        if challenger is not None:
            state = _crowned(state, challenger)
            front = [state.incumbent]
            trace(f"taken: {_text(state.incumbent.members)} {left_by(state.incumbent):.3f} remains {state.remains}")
            continue
        larger = [f for f in fitted if len(f.members) > len(state.incumbent.members)]
        if not state.remains or front[0] is not state.incumbent or ends(state.world, state.incumbent) or not larger:
            break
        front = larger[: FRONT - 1]
        trace("looking ahead from " + ", ".join("+".join(f.labels) for f in front))
    return state


def begun(problem: Problem, first: Fit, alone: Responses) -> Fit | None:
    """Return the set of several effects to whose signatures the recording adds up, where it takes most of what `first`
    leaves; else None.
    """
    state = Search(problem, problem, first)
    _, fitted = _round(state, [first], alone, (MOVES["pair"],))
    found = _best(state, [f for f in fitted if left_by(f) < MOST * left_by(first)])
    return found


def _best(state: Search, fitted: Sequence[Fit]) -> Fit | None:
    """Return the set that takes the incumbent's place, None where none does: one that no other takes the place of."""
    tasks, best = state.world.recs.tasks, state.incumbent
    for fit in sorted(fitted, key=lambda f: len(f.members)):
        if is_better(best, fit, tasks):
            best = fit
    return None if best is state.incumbent else best


def _crowned(state: Search, fit: Fit) -> Search:
    """Return the search with another incumbent, everything in units of the floor of its world."""
    world, best = rescored(state.root, in_units(fit, state.world, state.root))
    world.sofar.best = best
    return replace(state, world=world, incumbent=best)


def _round(state: Search, front: Sequence[Fit], alone: Responses, moves: Sequence[Move]) -> tuple[Search, list[Fit]]:
    """Return the search and what the moves lead to from some sets, sharply fitted, in units of its world."""
    world, best = state.world, state.incumbent
    part, index = brief(world)
    proposed = _proposed(state, front, alone, moves)
    if not proposed:
        return state, []
    state = replace(state, seen=state.seen | {names_key(m) for m in proposed})
    nominal = float(part.score.loss(part.nominal).mean())
    now = float(part.score.loss(here_of(world, best)[index]).mean())
    scale = max(nominal - now, 0.0)
    shown = _first_of_each(by_loss(part, proposed))
    trace(f"shown {len(shown)} beside {now:.2f}: " + ", ".join(f"{l:.2f} {_text(m)}" for l, m in shown[:5]))
    near = _near(shown, len(best.members), SHOWN, now + OFF_SHOWN * scale)
    moved = sorted((lightly_fitted(part, m, WIDTHS[:1]) for _, m in near), key=lambda pair: pair[0])
    trace(f"moved {len(moved)}: " + ", ".join(f"{l:.2f} {_text(m)}" for l, m in moved[:5]))
    near = _near(moved, len(best.members), SHARP, now + OFF_MOVED * scale)
    base = world.score.loss(world.nominal)
    sharp = [joint(world, m, base, WIDTHS[1:]) for _, m in near]
    sharp.sort(key=lambda f: float(f.evidence.loss.mean()))
    trace("sharp " + ", ".join(f"{float(f.evidence.loss.mean()):.3f} {_text(f.members)}" for f in sharp))
    new = {names_key(f.members): in_units(f, world, state.root) for f in sharp}
    return replace(state, visited={**state.visited, **new}), sharp


def _text(members: Members) -> str:
    return "+".join(c.label for c, _ in members)


def _proposed(state: Search, front: Sequence[Fit], alone: Responses, moves: Sequence[Move]) -> list[Members]:
    """Return what moves propose from some sets that was not shown yet."""
    part, index = brief(state.world)
    views = [View(state.root, state.world, part, index, fit, alone, state.remains) for fit in front]
    known = {*state.seen, *state.visited}
    return [m for view in views for propose in moves for m in propose(view) if names_key(m) not in known]


def _first_of_each(pairs: Sequence[tuple[float, Members]]) -> list[tuple[float, Members]]:
    """Return the sets without those that differ from an earlier one in values alone."""
    return list({names_key(pair[1]): pair for pair in reversed(pairs)}.values())[::-1]


def _near(pairs: Sequence[tuple[float, Members]], size: int, most: int, far: float) -> list[tuple[float, Members]]:
    """Return the sets of a rung that go on: the first of those with more names, and of those with no more."""
    within = [pair for pair in pairs if pair[0] < far]
    larger = [pair for pair in within if len(pair[1]) > size]
    others = [pair for pair in within if len(pair[1]) <= size]
    # Of sets that leave about as much, those with the fewest names.
    return [*_plainest(larger, most), *others[:most]]


def _plainest(pairs: Sequence[tuple[float, Members]], most: int) -> list[tuple[float, Members]]:
    sizes = sorted({len(m) for _, m in pairs})
    found: list[tuple[float, Members]] = []
    for size in sizes:
        own = [pair for pair in pairs if len(pair[1]) == size]
        found += own[: max(most // len(sizes), 1)]
    return found
