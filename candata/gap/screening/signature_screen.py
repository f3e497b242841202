"""Screening: what signatures promise of every candidate, without a simulation on the recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import FEW_NUMBERS, Candidate, first_probes, probes
from candata.gap.fit.fits import Members
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve, Plane
from candata.gap.fit.signatures import is_read_at_start
from candata.gap.measure.score import Compact
from candata.gap.replay.replayer import needs_simulation

Array = NDArray[np.float64]
#: A candidate whose signatures are smaller than this (RMS, in units of the floor) cannot be seen here.
LIVELY = 0.05
#: Share of the nearest probes' distances at which a scalar is looked at nearer: a quarter of a clear effect. Chosen.
NEARER = 0.25
#: Width over which slopes are read off signatures: this share of the distance from neutral, within these shares of the
#: range.
WIDTH, NARROWEST, WIDEST = 0.1, 0.002, 0.02


def respond(
    problem: Problem, here: Compact, found: Sequence[Candidate], held: Members = ()
) -> tuple[list[tuple[Candidate, Curve | Plane]], list[str]]:
    """Return the response of every candidate on top of the residuals `here (E, K)`, and the labels of dead ones.

    Tosses are simulated on the recording itself, beside the effects `held`: where a toss lands decides how it goes on,
    so that a signature of another landing says little, and a toss is short. So are choices beside effects: what a
    solver setting does in one world it does not do in another, and there is nothing in between to mend it by; and all
    candidates where the problem says so. Where no signatures are shared, all that is tried alone was simulated there.
    """
    out: list[tuple[Candidate, Curve | Plane]] = []
    dead = []
    own = [problem.plays_all or bool(held and (c.choices or _is_read(problem, c))) for c in found]
    places = [_places(c, problem, held) for c in found]
    played = [
        tuple((c, u) for c, o, points in zip(found, own, places, strict=True) if o is kind for u in points)
        for kind in (True, False)
    ]
    seen = not held and problem.library.seen
    moved = {
        True: iter(_moves(problem, here, played[0], held) if played[0] else ()),
        False: iter(problem.signatures(played[1]) if played[1] else ()),
    }
    for c, is_own, points in zip(found, own, places, strict=True):
        moves = [next(moved[is_own]) for _ in points]
        if max(float(np.sqrt((move[problem.score.mask] ** 2).mean())) for move in moves) < LIVELY:
            dead.append(c.label)
        else:
            sure = is_own or (seen and not is_read_at_start(problem.setting([(c, c.neutral)])))
            sides = _sides(problem, c, here, points, moves) if c.size > 1 else np.zeros(1)
            response = _response(c, here, points, moves, sure, sides)
            out.append((c, _begun(problem, response, points, moves) if problem.simulated and not held else response))
    return out, dead


def _is_read(problem: Problem, c: Candidate) -> bool:
    """Tell whether a candidate alters forces only as they are read."""
    return not needs_simulation(problem.setting([(c, c.neutral)]))


def _moves(problem: Problem, here: Compact, points: Members, held: Members) -> list[Compact]:
    """Return what candidates take off the residuals `here`, by simulations on the recording."""
    zs = problem.residuals([problem.setting((*held, point)) for point in points])
    return [here - z for z in zs]


def screening(c: Candidate, problem: Problem) -> list[Array]:
    """Return the coordinates at which a candidate's signatures are read; fewer of one element, or in brief."""
    scene = problem.replayer.scene
    return first_probes(c, scene) if c.element or problem.brief else probes(c, scene)


def _places(c: Candidate, problem: Problem, held: Members) -> list[Array]:
    """Return the coordinates at which a candidate is looked at.

    Where all are simulated on the recording, what was simulated of a few episodes serves for all of them. A scalar is
    then looked at twice on each side beside other effects. Where it is because none explains it alone, it is looked at
    nearer and between, too: what a faint effect does, as a support that is 2 mm too high, need not be a share of what a
    strong one does. So are few numbers.
    """
    if not problem.simulated:
        return screening(c, problem)
    points = first_probes(c, problem.replayer.scene)
    if c.choices or c.size > FEW_NUMBERS:
        return points
    if c.size > 1:
        return points if held else [*points, *(c.neutral + NEARER * (p - c.neutral) for p in points)]
    away = sorted(points, key=lambda p: float(abs(p[0] - c.neutral[0])))
    below, above = ([p for p in away if np.sign(p[0] - c.neutral[0]) == side] for side in (-1, 1))
    sides = [side for side in (below, above) if side]
    if held:
        return [side[i] for side in sides for i in sorted({(len(side) - 1) // 2, len(side) - 1})]
    between = [(a + b) / 2 for side in sides for a, b in pairwise(side)]
    return [*points, *between, *(c.neutral + NEARER * (side[0] - c.neutral) for side in sides)]


def _response(
    c: Candidate, here: Compact, points: Sequence[Array], moves: Sequence[Compact], sure: bool, sides: Array
) -> Curve | Plane:
    """Return what is promised: a curve for a scalar, a plane of secants towards `sides (d,)` for a vector."""
    if c.size == 1:
        start = Curve(c, c.neutral, here[None], np.ones(1, bool))
        return start.with_probes(np.concatenate(points), np.stack([here - move for move in moves]), sure)
    slope = np.stack([_secant(c, i, points, moves, float(side)) for i, side in enumerate(sides)])
    return Plane(c.low, c.high, c.neutral, here, slope)


def _begun(
    problem: Problem, response: Curve | Plane, points: Sequence[Array], moves: Sequence[Compact]
) -> Curve | Plane:
    """Return a vector's plane around the probe that leaves least, if less than none; all were simulated there.

    Slopes of contact that comes and goes lead nowhere from the neutral values.
    """
    if isinstance(response, Curve):
        return response
    zs = [response.z, *(response.z - move for move in moves)]
    best = int(np.argmin([float(problem.score.loss(z).mean()) for z in zs]))
    return replace(response, at=points[best - 1], z=zs[best]) if best else response


def _sides(problem: Problem, c: Candidate, here: Compact, points: Sequence[Array], moves: Sequence[Compact]) -> Array:
    """Return `(d,)` towards which probe of each number a vector leaves least, 0 where it was not probed.

    Contact is one-sided: a jar whose mass centre lies to one side leans into the hand, to the other it topples. Towards
    the farthest probe of that side, but where probes were simulated nearer because those told nothing.
    """
    sides, least = np.zeros(c.size), np.full(c.size, np.inf)
    for u, move in zip(points, moves, strict=True):
        (moved,) = np.flatnonzero(u != c.neutral)
        loss = float(problem.score.loss(here - move).mean())
        if loss < least[moved]:
            sides[moved], least[moved] = u[moved] - c.neutral[moved], loss
    return sides if problem.simulated else _farthest(sides)


def _farthest(sides: Array) -> Array:
    """Return the same sides, as far away as can be; 0 stays."""
    return np.where(sides == 0, 0.0, np.copysign(np.inf, sides))


def _secant(c: Candidate, i: int, points: Sequence[Array], moves: Sequence[Compact], side: float) -> Compact:
    """Return `(E, K)` the change of the residuals with coordinate i, to the probe next to a `side`; 0: across both.

    To the farthest one where the side is infinite; across both, too, where none lies there.
    """
    steps = [(float(u[i] - c.neutral[i]), m) for u, m in zip(points, moves, strict=True) if u[i] != c.neutral[i]]
    own = [(a, m) for a, m in steps if a * side > 0]
    if own:
        far = np.isinf(side)
        step, move = max(own, key=lambda s: abs(s[0])) if far else min(own, key=lambda s: abs(s[0] - side))
        return -move / np.float32(step)
    (a, low), (b, high) = min(steps, key=lambda s: s[0]), max(steps, key=lambda s: s[0])
    if a * b < 0:
        return (low - high) / np.float32(b - a)
    return -high / np.float32(b) if b > 0 else -low / np.float32(a)


def slopes(problem: Problem, c: Candidate, u: Array) -> Compact:
    """Return `(d, E, K)` how residuals change with a candidate's coordinates around `u (d,)`; zero for a choice."""
    points = screening(c, problem)
    moves = problem.signatures([(c, p) for p in points])
    response = _response(c, np.zeros_like(moves[0]), points, moves, False, _farthest(u - c.neutral))
    return slope_of(c, response, u, (NARROWEST, WIDEST))


def slope_of(c: Candidate, response: Curve | Plane, u: Array, within: tuple[float, float]) -> Compact:
    """Return `(d, E, K)` how a response changes with its coordinates around `u (d,)`; zero for a choice.

    A curve is read over a share of the distance from neutral, `within` these shares of the range.
    """
    if isinstance(response, Plane):
        return response.slope
    if c.choices:
        return np.zeros_like(response.z[:1])
    span = c.high - c.low
    width = np.clip(WIDTH * np.abs(u - c.neutral), within[0] * span, within[1] * span)
    low, high = np.maximum(u - width, c.low), np.minimum(u + width, c.high)
    return (response.read(high) - response.read(low))[None] / np.float32(high[0] - low[0])
