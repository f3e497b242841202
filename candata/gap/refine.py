"""Refinement: more simulations where a fit is, until its coordinates are sharp."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.candidates import probes
from candata.gap.folds import CrossFit, cross_fit
from candata.gap.response import Curve, Plane
from candata.gap.search import Fit, Members, Problem, fit_one

Array = NDArray[np.float64]
World = Callable[[Array], Members]
#: Candidates that get all their probes after the first ones, and those that are refined by rollouts.
KEPT, REFINED = 5, 3
#: Rounds of refinement; each narrows the bracket or re-linearises once.
REFINEMENTS = 2
#: Most Gauss-Newton rounds of a joint fit; it ends earlier when no share of a step helps.
ROUNDS = 5
#: Shares of a Gauss-Newton step that are tried.
SHARES = (1.0, 0.5, 0.2)
#: Compass search: most coordinates, first and last step as shares of the range.
COMPASS_SIZE, COMPASS_FIRST, COMPASS_LAST = 3, 0.1, 0.01
#: Even points at which the winning scalar is simulated once more.
SCANNED = 9
#: Step of finite differences, as a share of a coordinate's range: well above the chaos of single contacts.
DIFFERENCE = 0.02


def refined(problem: Problem, fits: list[Fit], base: Array, held: Members) -> list[Fit]:
    """Return single fits with the best ones sharpened by rollouts, best held-out gain first.

    Scalars get the rest of their probes, then a closing bracket; every vector takes one Gauss-Newton step from the
    best of several trial points, as its first, wide secants say little about where it ends.
    """
    fits = _bracketed(problem, fits, base, held, [_missing_probes(problem, f) for f in fits[:KEPT]])
    fits = _sorted([_descended(problem, f, base, held) if _is_vector(f) else f for f in fits])
    for _ in range(REFINEMENTS):
        fits = _bracketed(problem, fits, base, held, [_closer_probes(f) for f in fits[:REFINED]])
    return _sorted([_descended(problem, f, base, held) if _is_vector(f) else f for f in fits[:1]] + fits[1:])


def _sorted(fits: list[Fit]) -> list[Fit]:
    """Return the fits, best held-out gain first."""
    return sorted(fits, key=lambda f: -f.gain)


def _is_vector(fit: Fit) -> bool:
    """Tell whether a single fit has several coordinates."""
    return isinstance(fit.response, Plane)


def _bracketed(problem: Problem, fits: list[Fit], base: Array, held: Members, points: list[list[Array]]) -> list[Fit]:
    """Return the fits with the first ones, scalars, simulated at more coordinates, sorted again."""
    count = len(points)
    flat = [(f.members[0][0], u) for f, some in zip(fits, points, strict=False) for u in some]
    if not flat:
        return fits
    zs = iter(problem.residuals([problem.setting((*held, member)) for member in flat]))
    out = list(fits[count:])
    for fit, some in zip(fits[:count], points, strict=True):
        if not some or not isinstance(fit.response, Curve):
            out.append(fit)
            continue
        response = fit.response.with_probes(np.concatenate(some), np.stack([next(zs) for _ in some]))
        out.append(fit_one(problem, fit.members[0][0], response, base))
    return _sorted(out)


def _missing_probes(problem: Problem, fit: Fit) -> list[Array]:
    """Return a scalar's probes that have not been simulated."""
    if not isinstance(fit.response, Curve):
        return []
    done = np.round(fit.response.at, 9)
    return [u for u in probes(fit.members[0][0], problem.replayer.scene) if round(float(u[0]), 9) not in done]


def _closer_probes(fit: Fit) -> list[Array]:
    """Return coordinates around a scalar's present best, on both sides of it."""
    c, u = fit.members[0]
    if not isinstance(fit.response, Curve) or c.choices:
        return []
    at = fit.response.at
    right = int(np.clip(np.searchsorted(at, u[0]), 1, len(at) - 1))
    gap = at[right] - at[right - 1]
    around = np.array([u[0] - 0.3 * gap, u[0], u[0] + 0.3 * gap])
    if u[0] in (at[0], at[-1]):  # the best lies at the last probe: look beyond it
        outwards = 1 if u[0] == at[-1] else -1
        around = np.array([u[0] - 0.3 * outwards * gap, u[0] + 0.6 * outwards * gap, u[0] + 1.5 * outwards * gap])
    return [np.array([v]) for v in np.unique(np.clip(around, c.low[0], c.high[0]))]


def _descended(problem: Problem, fit: Fit, base: Array, held: Members) -> Fit:
    """Return a vector's fit moved to the best of several trial points and linearised there."""
    plane = fit.response
    if not isinstance(plane, Plane):
        return fit
    c = fit.members[0][0]

    def world(u: Array) -> Members:
        return (*held, (c, u))

    target = plane.best(np.arange(len(base)))
    trials = [plane.at + share * (target - plane.at) for share in SHARES]
    trials += [p for p in (_best_axis(problem, plane),) if p is not None]
    moved = _best_of(problem, plane, trials, world)
    plane = _linearised(problem, moved, world, np.ones(c.size, bool))
    found = fit_one(problem, c, plane, base)
    return found if found.gain > fit.gain or moved is not fit.response else fit


def _best_axis(problem: Problem, plane: Plane) -> Array | None:
    """Return the best point along the coordinate that alone lowers the loss most, or None."""
    start = float(problem.score.loss(plane.z).mean())
    best: tuple[float, Array | None] = (start, None)
    for i in range(len(plane.at)):
        for end in (plane.low[i], plane.high[i]):
            for share in (0.15, 0.35, 0.6):
                u = plane.at.copy()
                u[i] += share * (end - plane.at[i])
                loss = float(problem.score.loss(plane.read(u)).mean())
                best = min(best, (loss, u), key=lambda b: b[0])
    return best[1]


def _best_of(problem: Problem, plane: Plane, trials: Sequence[Array], world: World) -> Plane:
    """Return the plane moved to the simulated trial of least loss, if that is less than at the plane's own point."""
    zs = problem.residuals([problem.setting(world(u)) for u in trials])
    losses = [float(problem.score.loss(z).mean()) for z in zs]
    if min(losses) >= float(problem.score.loss(plane.z).mean()):
        return plane
    at = int(np.argmin(losses))
    return replace(plane, at=trials[at], z=zs[at])


def _linearised(problem: Problem, plane: Plane, world: World, number: NDArray[np.bool_]) -> Plane:
    """Return the plane with slopes by finite differences; choices keep a slope of zero."""
    size = DIFFERENCE * (plane.high - plane.low)
    steps = np.where(plane.at + size > plane.high, -size, size)
    moved = np.flatnonzero(number)
    points = [plane.at + steps[i] * np.eye(len(steps))[i] for i in moved]
    zs = problem.residuals([problem.setting(world(u)) for u in points])
    slope = np.zeros_like(plane.slope)
    for i, z in zip(moved, zs, strict=True):
        slope[i] = (z - plane.z) / np.float32(steps[i])
    return replace(plane, slope=slope)


def joint(problem: Problem, members: Members, base: Array) -> Fit:
    """Return a set refitted by Gauss-Newton with rollouts: re-linearise, step, keep what lowers the loss."""
    fit = Fit(members, _constant(problem, members), CrossFit(base, base, np.zeros((0, 0))))
    number = np.concatenate([np.full(c.size, not c.choices) for c, _ in members])
    plane = fit.response
    for _ in range(ROUNDS):
        if not isinstance(plane, Plane) or not number.any():
            break
        plane = _linearised(problem, plane, fit.split, number)
        target = plane.best(np.arange(len(base)))
        stepped = _best_of(problem, plane, [plane.at + s * (target - plane.at) for s in SHARES], fit.split)
        if stepped is plane:
            break
        plane = stepped
    evidence = cross_fit(plane, problem.score, problem.parts, base)
    return replace(fit, members=fit.split(plane.at), response=plane, evidence=evidence)


def _constant(problem: Problem, members: Members) -> Plane:
    """Return a flat plane at the members' coordinates."""
    at = np.concatenate([u for _, u in members])
    z = problem.residuals([problem.setting(members)])[0]
    low, high = (np.concatenate([getattr(c, side) for c, _ in members]) for side in ("low", "high"))
    return Plane(low, high, at, z, np.zeros((len(at), *z.shape), np.float32))


def polished(problem: Problem, best: Fit, base: Array) -> Fit:
    """Return a fit after more rollouts: a scalar's around its best, a vector's by Gauss-Newton, if that gains."""
    if isinstance(best.response, Curve):
        return best if best.response.who.choices else _scanned(problem, best, base)
    found = _searched(problem, joint(problem, best.members, base), base)
    return found if found.gain > best.gain else best


def _scanned(problem: Problem, best: Fit, base: Array) -> Fit:
    """Return a scalar's fit simulated at even points between the probes around it.

    Residuals between far probes are no mixture of theirs (a late jump is no half jump), which can hide a minimum.
    """
    ((c, u),) = best.members
    marks = np.unique([c.neutral[0], c.low[0], c.high[0], *(p[0] for p in probes(c, problem.replayer.scene))])
    right = int(np.searchsorted(marks, u[0]))
    low, high = marks[max(right - 2, 0)], marks[min(right + 1, len(marks) - 1)]
    points = [np.array([v]) for v in np.linspace(low, high, SCANNED + 2)[1:-1]]
    finer = _bracketed(problem, [best], base, (), [points])
    return _bracketed(problem, finer, base, (), [_closer_probes(finer[0])])[0]


def _searched(problem: Problem, fit: Fit, base: Array) -> Fit:
    """Return a vector of few coordinates after a compass search by rollouts (Kolda, Lewis & Torczon 2003).

    Where contact is chaotic, finite differences say little; comparing whole rollouts still does.
    """
    plane = fit.response
    if not isinstance(plane, Plane) or len(plane.at) > COMPASS_SIZE:
        return fit
    start, share = plane, COMPASS_FIRST
    while share > COMPASS_LAST:
        steps = share * (plane.high - plane.low)
        trials = [np.clip(plane.at + side * row, plane.low, plane.high) for row in np.diag(steps) for side in (-1, 1)]
        moved = _best_of(problem, plane, trials, fit.split)
        share = share / 2 if moved is plane else share
        plane = moved
    if plane is start:
        return fit
    number = np.ones(len(plane.at), bool)
    plane = _linearised(problem, plane, fit.split, number)
    evidence = cross_fit(plane, problem.score, problem.parts, base)
    return replace(fit, members=fit.split(plane.at), response=plane, evidence=evidence)
