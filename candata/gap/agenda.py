"""The search: proposals of all moves compete in rungs of fidelity, and one evidence decides.

    proposed   values from signatures, on a few episodes; nothing simulated
    shown      one replay of the few episodes
    moved      fitted on the few episodes, by slopes over the first width
    fitted     fitted on all episodes, by slopes of signatures
    sharp      fitted on all episodes, by simulated slopes; only these can be taken
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from candata.gap.added import by_loss, lightly_fitted
from candata.gap.likelihood import SURE, names_key, odds
from candata.gap.moves import MOVES
from candata.gap.moves.view import View
from candata.gap.own_floor import rescored
from candata.gap.refine import WIDTHS, joint
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief
from candata.gap.together import Responses
from candata.gap.worth import EXTRA, leaves

#: How many sets go on from each rung, the best first: a beam.
SHOWN, MOVED, FITTED, SHARP = 16, 6, 3, 2
#: Share of the loss above the floor that is explained within which sets of a rung may still change places, by which
#: more of a rung are left out.
REACH = 0.3
#: Sets from which a round proposes.
FRONT = 3
#: Rounds at most.
ROUNDS = 8


@dataclass(frozen=True)
class Search:
    """What a search knows.

    Attributes
    ----------
    root : Problem
        In units of the nominal world's floor.
    world : Problem
        In units of the incumbent's.
    incumbent : Fit
    visited : dict
        Every set that was fitted sharply, in the world's units.
    seen : set
        Keys of all sets that were shown.
    """

    root: Problem
    world: Problem
    incumbent: Fit
    alternatives: int
    visited: dict[tuple[str, ...], Fit] = field(default_factory=dict)
    seen: frozenset[tuple[str, ...]] = frozenset()


def search(
    problem: Problem, first: Sequence[Fit], alone: Responses, say: Callable[[str], None] = lambda text: None
) -> Search:
    """Return the search that begins with the best effects alone."""
    world, best = rescored(problem, first[0])
    state = Search(problem, world, best, len(first) + 1, {names_key(best.members): best})
    front = [best, *first[1:FRONT]]
    misses = 0
    for _ in range(ROUNDS):
        remains = leaves(state.world, state.incumbent)
        state, sharp, rest = _round(state, front, alone, remains, say)
        challenger = min(sharp, key=lambda f: _cost(state, f), default=None)
        if challenger is not None and is_better(state, challenger):
            state = _crowned(state, challenger)
            front, misses = [state.incumbent, *rest][:FRONT], 0
            say(f"taken: {state.incumbent.labels}")
            continue
        misses += 1
        larger = [f for f in (*sharp, *rest) if len(f.members) > len(state.incumbent.members)]
        if not remains or not larger or misses > 1:
            return state
        front = larger[:FRONT]
    return state


def _cost(state: Search, fit: Fit) -> float:
    return -float(np.median(_odds(state, state.incumbent, fit)))


def _odds(state: Search, fit: Fit, other: Fit):
    return odds(
        state.world.score, (fit.evidence.loss, other.evidence.loss), (fit.members, other.members), state.alternatives
    )


def is_better(state: Search, fit: Fit) -> bool:
    """Tell whether a set takes the incumbent's place: surely if it says more, likely if it says no more."""
    held = state.incumbent
    share = float((_odds(state, held, fit) > 0).mean())
    if len(fit.members) <= len(held.members):
        return share > 0.5
    gained = float((held.evidence.loss - fit.evidence.loss).mean())
    return share >= SURE and gained > EXTRA * held.gain * (len(fit.members) - len(held.members))


def _crowned(state: Search, fit: Fit) -> Search:
    """Return the search with another incumbent, everything in units of the floor of its world."""
    world, best = rescored(state.root, replace(fit, response=fit.response.rescaled(_factor(state.world, state.root))))
    return replace(state, world=world, incumbent=best, visited={**state.visited, names_key(best.members): best})


def _factor(old: Problem, new: Problem):
    return np.where(new.score.mask, old.score.sigma / new.score.sigma, 0).astype(np.float32)


def _round(state: Search, front: Sequence[Fit], alone: Responses, remains: bool, say):
    """Return the search, the sets that were fitted sharply, and those that were fitted."""
    world = state.world
    part, index = brief(world)
    base = world.score.loss(world.nominal)
    proposed: dict[tuple[str, ...], Members] = {}
    for k, fit in enumerate(front):
        view = View(world, part, index, fit, alone)
        for name, propose in MOVES.items():
            if not remains and name in ("add", "pair"):
                continue
            if k and name in ("exchange", "drop", "place"):
                continue
            for members in propose(view):
                key = names_key(members)
                if key not in state.seen and key not in state.visited:
                    proposed.setdefault(key, members)
    state = replace(state, seen=state.seen | frozenset(proposed))
    if not proposed:
        return state, [], []
    nominal = float(part.score.loss(part.nominal).mean())
    shown = _ranked(by_loss(part, list(proposed.values())), nominal)
    say(f"shown {len(shown)}: " + ", ".join(f"{l:.2f} {'+'.join(c.label for c, _ in m)}" for l, m in shown[:4]))
    moved = _ranked([lightly_fitted(part, m, WIDTHS[:1]) for _, m in _near(shown, SHOWN, nominal)], nominal)
    say("moved " + ", ".join(f"{l:.2f} {'+'.join(c.label for c, _ in m)}" for l, m in moved[:4]))
    fitted = [joint(world, m, base, widths=()) for _, m in _near(moved, MOVED, nominal)]
    by_label = {id(f.members): f for f in fitted}
    pairs = _ranked([(float(f.evidence.loss.mean()), f.members) for f in fitted], float(base.mean()))
    fitted = [by_label[id(m)] for _, m in pairs]
    sharp = [joint(world, m, base) for _, m in _near(pairs, SHARP, float(base.mean()))]
    sharp.sort(key=lambda f: float(f.evidence.loss.mean()))
    say("sharp " + ", ".join(f"{float(f.evidence.loss.mean()):.3f} {'+'.join(f.labels)}" for f in sharp))
    visited = {**state.visited, **{names_key(f.members): f for f in sharp}}
    return replace(state, visited=visited), sharp, fitted


def _ranked(pairs, nominal: float):
    """Return sets by the loss that they leave, each name counted as what a name must be worth, the least first."""
    if not pairs:
        return []
    worth = EXTRA * max(nominal - min(loss for loss, _ in pairs), 0.0)
    return sorted(((loss, m) for loss, m in pairs), key=lambda pair: pair[0] + worth * len(pair[1]))


def _near(pairs, most: int, nominal: float):
    """Return the first of a rung, those out of reach of the best left out."""
    if not pairs:
        return []
    least = pairs[0][0]
    return [pair for pair in pairs[:most] if pair[0] - least <= REACH * max(nominal - least, 0.1)]
