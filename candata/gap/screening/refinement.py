"""Refinement: simulations on the recording where signatures put a fit, until its coordinates are sharp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import FEW_NUMBERS, Candidate
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.folds import CrossFit, cross_fit
from candata.gap.fit.problem import Problem, fit_one
from candata.gap.fit.response import Curve, Plane
from candata.gap.measure.score import Compact
from candata.gap.screening.set_slopes import (
    FEW_EFFECTS,
    MOST_SLOPES,
    WIDTHS,
    World,
    around,
    differences,
    divided,
    slopes_of,
)

Array = NDArray[np.float64]
#: First fits that must have been simulated where they are, and most rounds of simulations of one of them.
FRONT, TRIES = 4, 3
#: Share of the best gain below which what signatures promise is too little to be looked at. Chosen: signatures are
#: off by a tenth or so.
PROMISE = 0.5
#: A scalar counts as simulated within this share of its distance from the neutral value, or of its range.
CLOSE, CLOSE_RANGE = 0.1, 0.005
#: How much farther from the neutral value a scalar is tried whose best is its farthest point.
OUTWARDS = 0.7
#: Shares of a Gauss-Newton step that are tried.
SHARES = (1.0, 0.5)
#: Most Gauss-Newton rounds of a joint fit; it ends earlier when no share of a step helps.
ROUNDS = 4
#: Share of the loss below which another round is not worth its rollouts.
ENOUGH = 0.02
#: Share of the loss that slopes must promise for a step to be simulated at all. Record 43.
PROMISED = 0.001
#: Share of what a set gains that it may leave for its slopes not to be simulated. Chosen: beside a gap of 16 floors a
#: hundredth hides what a third cause is worth. Record 43.
SHARP = 0.002
#: Most times that slopes are simulated again over the last width, the share of the loss that a time must gain to count,
#: and after how many in a row that do not it ends. Chosen.
AGAIN, WORTH_IT, IDLE = 4, 0.005, 2
#: Half width of the bracket around the best scalar, as a share of its distance from the neutral value. Chosen.
BRACKET = 0.1


def refined(problem: Problem, fits: list[Fit], base: Array) -> list[Fit]:
    """Return single fits, best held-out gain first, the first of them simulated on the recording where they are."""
    tries: dict[str, int] = {}
    while True:
        front = [f for i, f in enumerate(fits[:FRONT]) if i == 0 or f.gain > PROMISE * fits[0].gain]
        todo = [f for f in front if tries.get(f.labels[0], 0) < TRIES and _is_open(f, tries)]
        if not todo:
            return fits
        for f in todo:
            tries[f.labels[0]] = tries.get(f.labels[0], 0) + 1
        done = {f.labels[0]: f for f in _simulated(problem, todo, base)}
        fits = sorted((done.get(f.labels[0], f) for f in fits), key=lambda f: -f.gain)


def _is_open(fit: Fit, tries: dict[str, int]) -> bool:
    """Tell whether a fit lies where nothing was simulated on the recording."""
    ((c, u),) = fit.members
    if c.is_neutral(u):
        return False
    if isinstance(fit.response, Plane):
        return fit.labels[0] not in tries or bool((np.abs(u - fit.response.at) > _close(c, u)).any())
    return len(_points(fit)) > 0


def _points(fit: Fit) -> list[Array]:
    """Return the coordinates `(1,)` at which a scalar should be simulated next: its best, and beyond an end."""
    ((c, u),) = fit.members
    curve = fit.curve
    points = [u]
    if not c.choices and u[0] in (curve.at[0], curve.at[-1]):
        points.append(np.clip(u + OUTWARDS * (u - c.neutral), c.low, c.high))
    return [p for p in points if curve.nearest_sure(p) > float(_close(c, p)[0])]


def _close(c: Candidate, u: Array) -> Array:
    """Return `(d,)` distances below which coordinates count as the same."""
    return np.maximum(CLOSE * np.abs(u - c.neutral), CLOSE_RANGE * (c.high - c.low))


def _simulated(problem: Problem, fits: Sequence[Fit], base: Array) -> list[Fit]:
    """Return fits after simulations at their coordinates: scalars in one batch, vectors by shares of their step."""
    curves = [f for f in fits if isinstance(f.response, Curve)]
    out = _with_points(problem, curves, [_points(f) for f in curves], base)
    return out + [_stepped(problem, f, base) for f in fits if isinstance(f.response, Plane)]


def _with_points(problem: Problem, fits: Sequence[Fit], points: Sequence[Sequence[Array]], base: Array) -> list[Fit]:
    """Return scalar fits with more coordinates simulated on the recording."""
    flat = [(f.members[0][0], u) for f, some in zip(fits, points, strict=True) for u in some]
    zs = iter(problem.residuals([problem.setting((member,)) for member in flat]))
    out = []
    for fit, some in zip(fits, points, strict=True):
        response = fit.curve.with_probes(np.concatenate(some), np.stack([next(zs) for _ in some]))
        out.append(fit_one(problem, fit.members[0][0], response, base))
    return out


def _stepped(problem: Problem, fit: Fit, base: Array) -> Fit:
    """Return a vector's fit moved to the best simulated share of its step; flat where no share helps."""
    c, plane = fit.members[0][0], fit.plane
    target = plane.best(np.arange(len(base)))
    moved = stepped(problem, plane, target, lambda u: ((c, u),))
    return fit_one(problem, c, replace(moved, slope=np.zeros_like(moved.slope)) if moved is plane else moved, base)


def stepped(problem: Problem, plane: Plane, target: Array, world: World, far: bool = False) -> Plane:
    """Return the plane moved to the largest share of a step that lowers the simulated loss; itself where none does.

    A step may go `far` where slopes are simulated: the chaos of contact adds to them, so that they make every way seem
    dear, and steps too short (attenuation, Fuller 1987, section 1.1). It is doubled while it gains, where it gained
    more than slopes promise.
    """
    before, promised = (float(problem.score.loss(z).mean()) for z in (plane.z, plane.read(target)))
    for share in SHARES:
        moved, loss = _part_way(problem, plane, target, share, world)
        if loss < before:
            break
    else:
        return plane
    while far and loss < promised:
        share *= 2
        farther, less = _part_way(problem, plane, target, share, world)
        if less >= loss:
            break
        moved, loss = farther, less
    return moved


def _part_way(problem: Problem, plane: Plane, target: Array, share: float, world: World) -> tuple[Plane, float]:
    """Return the plane moved by a share of the way to `target (d,)`, inside bounds, and the simulated loss there."""
    u = np.clip(plane.at + share * (target - plane.at), plane.low, plane.high)
    z = problem.residuals([problem.setting(world(u))])[0]
    return replace(plane, at=u, z=z), float(problem.score.loss(z).mean())


def joint(problem: Problem, members: Members, base: Array, widths: Sequence[float] = WIDTHS) -> Fit:
    """Return a set refitted by Gauss-Newton: slopes from signatures, then by rollouts that differ by `widths`.

    Where the last of `WIDTHS` is among these, again over that one while it helps.
    """
    world = partial(divided, members)
    plane = around(problem, members, world)
    fit = Fit(members, plane, CrossFit(base, base, np.zeros((0, 0))))
    plane = _descended(problem, fit, plane, None)
    ahead = list(widths) if len(plane.at) <= MOST_SLOPES or len(members) <= FEW_EFFECTS else []
    ahead += WIDTHS[-1:] * AGAIN if WIDTHS[-1] in ahead else ()
    idle = 0
    while ahead:
        before, width = float(problem.score.loss(plane.z).mean()), ahead.pop(0)
        if before - 1 < SHARP * (float(base.mean()) - before):
            break
        slope = differences(problem, fit.split(plane.at), world, plane.z, width, plane.slope)
        moved = _descended(problem, fit, replace(plane, slope=slope), slope)
        gained = before - float(problem.score.loss(moved.z).mean())
        idle = 0 if gained > (WORTH_IT * before if width == WIDTHS[-1] else 0.0) else idle + 1
        if idle:
            # Where a width helps no more, the last one says how sure the numbers are.
            ahead = [w for w in ahead if w == WIDTHS[-1] and idle < IDLE]
        plane = moved
    evidence = cross_fit(plane, problem.score, problem.parts, base)
    return replace(fit, members=fit.split(plane.at), response=plane, evidence=evidence)


def _descended(problem: Problem, fit: Fit, plane: Plane, slope: Compact | None) -> Plane:
    """Return the plane after steps that each lower the simulated loss clearly; slopes from signatures if not given."""
    for _ in range(ROUNDS):
        before = float(problem.score.loss(plane.z).mean())
        target = plane.best(np.arange(len(plane.z)))
        if float(problem.score.loss(plane.read(target)).mean()) > (1 - PROMISED) * before:
            break
        moved = stepped(problem, plane, target, fit.split, slope is not None)
        if moved is plane:
            break
        here = fit.split(moved.at)
        plane = replace(moved, slope=slopes_of(problem, here, fit.split, moved.z) if slope is None else slope)
        if float(problem.score.loss(plane.z).mean()) > (1 - ENOUGH) * before:
            break
    return plane


def polished(problem: Problem, best: Fit, base: Array) -> Fit:
    """Return a fit after more rollouts: a scalar's at a bracket around its best and at the best that this shows, a
    vector's by Gauss-Newton, if that gains.
    """
    ((c, u),) = best.members
    if c.choices:
        return best
    if isinstance(best.response, Plane):
        found = joint(problem, _mirrored(problem, best, base), base)
        return found if found.gain > best.gain else best
    width = np.maximum(BRACKET * np.abs(u - c.neutral), CLOSE_RANGE * (c.high - c.low) / 2)
    best = _at(problem, best, [np.clip(u + side * width, c.low, c.high) for side in (-1, 1)], base)
    return _at(problem, best, [best.members[0][1]], base)


def _mirrored(problem: Problem, best: Fit, base: Array) -> Members:
    """Return a vector's fit, or that with one of its numbers on the other side of neutral, whichever leaves least.

    Contact is one-sided, so that slopes of one side lead nowhere on the other.
    """
    ((c, u),) = best.members
    now = float(problem.score.loss(best.plane.z).mean())
    if c.size > FEW_NUMBERS or now - 1 < SHARP * (float(base.mean()) - now):
        return best.members
    across = np.clip(2 * c.neutral - u, c.low, c.high)
    others = [np.where(np.arange(c.size) == i, across, u) for i in range(c.size)]
    losses = [
        float(problem.score.loss(z).mean()) for z in problem.residuals([problem.setting([(c, p)]) for p in others])
    ]
    i = int(np.argmin(losses))
    return ((c, others[i]),) if losses[i] < now else best.members


def _at(problem: Problem, fit: Fit, points: Sequence[Array], base: Array) -> Fit:
    """Return a scalar's fit with coordinates simulated on the recording that were not yet."""
    new = [p for p in points if not fit.curve.was_simulated(p)]
    return _with_points(problem, [fit], [new], base)[0] if new else fit
