"""Which: screen candidates by responses, refine the best by rollouts, choose on held-out episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.candidates import Candidate, candidates, probes
from candata.gap.floor import FloorKind, floor, perturbed
from candata.gap.folds import CrossFit, cross_fit, null_threshold
from candata.gap.recordings import Recordings
from candata.gap.replay import EffectSet, Replayer, replay_all
from candata.gap.residuals import Layout, residual
from candata.gap.response import Curve, Plane
from candata.gap.score import Compact, Score, score
from candata.gap.starts import Starts
from candata.schema.scene import Noise

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Members = tuple[tuple[Candidate, Array], ...]
#: Candidates that get all their probes after the first two, and those that are refined by rollouts.
KEPT, REFINED = 7, 4
#: Rounds of refinement; each halves the bracket or re-linearises once.
REFINEMENTS = 2
#: A candidate whose probes move residuals by less than this (RMS, in units of the floor) cannot be seen here.
LIVELY = 0.05
#: Largest number of effects in a set.
LARGEST_SET = 3
#: Share of the gain so far below which another effect is not worth naming, significant or not.
EXTRA = 0.02
#: Null replays of each episode around an accepted set.
NULLS_AGAIN = 8
#: Nominal replays from other starts, which show how much of a loss is luck.
STARTS = 7


@dataclass(frozen=True)
class Problem:
    """What every step of the attribution needs."""

    replayer: Replayer
    recs: Recordings
    begin: Starts
    plan: Layout
    score: Score
    parts: list[Index]
    noise: Noise
    floor_kind: FloorKind
    rng: np.random.Generator

    def residuals(self, variants: Sequence[EffectSet], begin: Starts | None = None) -> list[Compact]:
        """Return normalised residuals `(E, K)` of each effect set, by rollouts."""
        found = replay_all(self.replayer, self.recs, begin or self.begin, variants)
        return [self.score.normal(residual(self.recs, self.plan, r)) for r in found]

    def setting(self, members: Sequence[tuple[Candidate, Array]]) -> EffectSet:
        """Return the effect settings of candidates at coordinates."""
        return tuple(c.setting(u, self.replayer.scene) for c, u in members)


@dataclass(frozen=True)
class Fit:
    """A set of candidates, fitted.

    Attributes
    ----------
    members : tuple of (Candidate, coordinates)
        Fitted on all episodes.
    response : Curve or Plane
        Around the fit; a plane's coordinates are the members' in order.
    evidence : CrossFit
        Held-out losses and gains over the empty set.
    """

    members: Members
    response: Curve | Plane
    evidence: CrossFit

    @property
    def gain(self) -> float:
        """Mean held-out gain in floors."""
        return float(self.evidence.gain.mean())

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the members."""
        return tuple(c.label for c, _ in self.members)

    def split(self, u: Array) -> Members:
        """Return the members at stacked coordinates `u (d,)`."""
        out, start = [], 0
        for c, _ in self.members:
            out.append((c, u[start : start + c.size]))
            start += c.size
        return tuple(out)


@dataclass(frozen=True)
class Stage:
    """One round of the search: every candidate on top of what is held.

    Attributes
    ----------
    base : (E,) float64
        Typical loss without another effect, in floors.
    fits : tuple of Fit
        Every lively candidate, best held-out gain first.
    threshold : float
        Held-out gain that null sets reach one time in a hundred.
    dead : tuple of str
        Candidates that this data cannot show.
    """

    base: Array
    fits: tuple[Fit, ...]
    threshold: float
    dead: tuple[str, ...]

    def passing(self) -> Fit | None:
        """Return the best fit if it beats both the nulls and one standard error of its own gain."""
        if not self.fits:
            return None
        best = self.fits[0]
        return best if best.gain > max(self.threshold, standard_error(best.evidence.gain)) else None


@dataclass(frozen=True)
class Attribution:
    """What the search found.

    Attributes
    ----------
    first : Stage
        Every candidate alone.
    chosen : Fit or None
        The set that passes, or None.
    tied : tuple of Fit
        Single fits that the held-out episodes cannot tell from the best; the best first.
    score : Score
        In units of the floor of the chosen world.
    remains : bool
        Whether the held-out loss of the chosen set (or of the nominal scene) lies above the nulls.
    """

    first: Stage
    chosen: Fit | None
    tied: tuple[Fit, ...]
    score: Score
    remains: bool


def attribute(problem: Problem, nominal: Compact) -> Attribution:
    """Return the effects that explain the gap, by forward selection on held-out episodes.

    Parameters
    ----------
    problem : Problem
    nominal : (E, K) float32
        Normalised residuals of the nominal scene.
    """
    first = _stage(problem, nominal, ())
    best = first.passing()
    if best is None:
        remains = bool(first.base.mean() > null_level(problem.score, problem.rng))
        return Attribution(first, None, (), problem.score, remains)
    best = _polished(problem, best, first.base)
    first = replace(first, fits=(best, *(f for f in first.fits if f.members[0][0] is not best.members[0][0])))
    tied = tied_with(best, first.fits)
    chosen, world, remains = _forward(problem, best, grow=len(tied) == 1)
    return Attribution(first, chosen, tuple(tied), world.score, remains)


def _stage(problem: Problem, here: Compact, held: Members) -> Stage:
    """Return every candidate's held-out evidence on top of the effects held."""
    channels = list(problem.recs.readings)
    taken = {c.name for c, _ in held}
    found = [c for c in candidates(problem.replayer.scene, channels) if c.name not in taken]
    base, luck = _base(problem, here, held)
    responses, dead = _respond(problem, here, found, held)
    threshold = null_threshold([r for _, r in responses], problem.score, problem.parts, luck, problem.rng)
    fits = _refined(problem, _fits(problem, responses, base), base, held)
    return Stage(base, tuple(fits), threshold, tuple(dead))


def _base(problem: Problem, here: Compact, held: Members) -> tuple[Array, Array]:
    """Return the typical loss `(E,)` over starts that are equally possible, and the luck `(J, E)` of each."""
    others = [perturbed(problem.replayer, problem.begin, problem.noise, problem.rng) for _ in range(STARTS)]
    world = problem.setting(held)
    losses = [problem.score.loss(here)]
    losses += [problem.score.loss(problem.residuals([world], begin)[0]) for begin in others]
    base = np.median(losses, axis=0)
    return base, base - np.stack(losses)


def _respond(
    problem: Problem, nominal: Compact, found: Sequence[Candidate], held: Members
) -> tuple[list[tuple[Candidate, Curve | Plane]], list[str]]:
    """Return responses to first probes of every candidate on top of `held`, and the labels of dead ones."""
    scene = problem.replayer.scene
    points = {c.label: probes(c, scene)[: 2 if c.size == 1 else None] for c in found}
    flat = [(c, u) for c in found for u in points[c.label]]
    zs = problem.residuals([problem.setting((*held, (c, u))) for c, u in flat])
    out: list[tuple[Candidate, Curve | Plane]] = []
    dead = []
    for c in found:
        mine = [(u, z) for (owner, u), z in zip(flat, zs, strict=True) if owner is c]
        moved = max(float(np.sqrt(((z - nominal)[problem.score.mask] ** 2).mean())) for _, z in mine)
        if moved < LIVELY:
            dead.append(c.label)
            continue
        out.append((c, _first_response(c, nominal, mine)))
    return out, dead


def _first_response(c: Candidate, nominal: Compact, mine: list[tuple[Array, Compact]]) -> Curve | Plane:
    """Return the response through the first probes: a curve for a scalar, a plane of secants for a vector."""
    if c.size == 1:
        start = Curve(c, c.neutral, nominal[None])
        return start.with_probes(np.concatenate([u for u, _ in mine]), np.stack([z for _, z in mine]))
    slope = []
    for i in range(c.size):
        pair = sorted(((u[i] - c.neutral[i], z) for u, z in mine if u[i] != c.neutral[i]), key=lambda p: p[0])
        (a, low), (b, high) = pair[0], pair[-1]
        slope.append((high - low) / np.float32(b - a) if a != b else (high - nominal) / np.float32(b))
    return Plane(c.low, c.high, c.neutral, nominal, np.stack(slope))


def _fits(problem: Problem, responses: Sequence[tuple[Candidate, Curve | Plane]], base: Array) -> list[Fit]:
    """Return single-candidate fits by interpolated responses, best held-out gain first."""
    return sorted((_fit_one(problem, c, r, base) for c, r in responses), key=lambda f: -f.gain)


def _fit_one(problem: Problem, c: Candidate, response: Curve | Plane, base: Array) -> Fit:
    """Return one candidate's fit on all episodes and its held-out evidence."""
    everyone = np.arange(len(base))
    if isinstance(response, Curve):
        u = response.best(response.table(problem.score), everyone)
    else:
        u = response.best(everyone)
    return Fit(((c, u),), response, cross_fit(response, problem.score, problem.parts, base))


def _refined(problem: Problem, fits: list[Fit], base: Array, held: Members) -> list[Fit]:
    """Return the fits with the best ones probed fully and refined by rollouts."""
    fits = _probe(problem, fits, base, held, [_missing_probes(problem, f) for f in fits[:KEPT]])
    for _ in range(REFINEMENTS):
        fits = _probe(problem, fits, base, held, [_closer_probes(f) for f in fits[:REFINED]])
    return fits


def _probe(
    problem: Problem, fits: list[Fit], base: Array, held: Members, points: list[list[Array]]
) -> list[Fit]:
    """Return the fits with the first ones simulated at more coordinates, sorted again."""
    count = len(points)
    flat = [(f.members[0][0], u) for f, some in zip(fits, points, strict=False) for u in some]
    if not flat:
        return fits
    zs = iter(problem.residuals([problem.setting((*held, member)) for member in flat]))
    out = list(fits[count:])
    for fit, some in zip(fits[:count], points, strict=True):
        response = _sharpened(fit, some, [next(zs) for _ in some]) if some else fit.response
        out.append(_fit_one(problem, fit.members[0][0], response, base))
    return sorted(out, key=lambda f: -f.gain)


def _missing_probes(problem: Problem, fit: Fit) -> list[Array]:
    """Return a scalar's probes that have not been simulated."""
    if not isinstance(fit.response, Curve):
        return []
    done = np.round(fit.response.at, 9)
    return [u for u in probes(fit.members[0][0], problem.replayer.scene) if round(float(u[0]), 9) not in done]


def _closer_probes(fit: Fit) -> list[Array]:
    """Return coordinates around the present best: both sides of it for a scalar, a simplex for a vector."""
    c, u = fit.members[0]
    if isinstance(fit.response, Plane):
        return _simplex(fit.response, u)
    if c.choices:
        return []
    at = fit.response.at
    right = int(np.clip(np.searchsorted(at, u[0]), 1, len(at) - 1))
    gap = at[right] - at[right - 1]
    around = np.array([u[0] - 0.3 * gap, u[0], u[0] + 0.3 * gap])
    if u[0] in (at[0], at[-1]):  # the best lies at the last probe: look beyond it
        outwards = 1 if u[0] == at[-1] else -1
        around = np.array(
            [u[0] - 0.3 * outwards * gap, u[0] + 0.6 * outwards * gap, u[0] + 1.5 * outwards * gap]
        )
    return [np.array([v]) for v in np.unique(np.clip(around, c.low[0], c.high[0]))]


def _simplex(plane: Plane, u: Array) -> list[Array]:
    """Return `u` and a step from it along each coordinate, half the way it has come, at least 3 % of the range."""
    size = np.maximum(0.5 * np.abs(u - plane.at), 0.03 * (plane.high - plane.low))
    steps = np.where(u + size > plane.high, -size, size)
    return [u, *(u + row for row in np.diag(steps))]


def _sharpened(fit: Fit, points: list[Array], zs: list[Compact]) -> Curve | Plane:
    """Return the response with new simulations in it."""
    if isinstance(fit.response, Curve):
        return fit.response.with_probes(np.concatenate(points), np.stack(zs))
    return _plane_from(fit.response, points, zs)


def _plane_from(plane: Plane, points: list[Array], zs: list[Compact]) -> Plane:
    """Return the plane through a simplex's corners."""
    slope = [
        (z - zs[0]) / np.float32((u - points[0])[i])
        for i, (u, z) in enumerate(zip(points[1:], zs[1:], strict=True))
    ]
    return replace(plane, at=points[0], z=zs[0], slope=np.stack(slope))


def tied_with(best: Fit, fits: Sequence[Fit]) -> list[Fit]:
    """Return the fits whose held-out loss is within one standard error of the best one's (Breiman et al. 1984).

    The error is that of the paired difference over episodes.
    """
    out = [best]
    for fit in fits:
        if fit is best:
            continue
        worse = fit.evidence.loss - best.evidence.loss
        if worse.mean() <= standard_error(worse):
            out.append(fit)
    return out


def _polished(problem: Problem, best: Fit, base: Array) -> Fit:
    """Return a vector's fit after Gauss-Newton with rollouts, if that lowers the held-out loss."""
    if isinstance(best.response, Curve):
        return best
    polished = _joint(problem, best.members, base)
    return polished if polished.gain > best.gain else best


def _forward(problem: Problem, best: Fit, grow: bool) -> tuple[Fit, Problem, bool]:
    """Return the best set that contains `best`, the problem in units of its floor, and whether a gap remains.

    Grows while the held-out loss lies above the nulls of the world found so far and another effect passes.
    """
    while True:
        world, best, nominal = _rescored(problem, best)
        remains = bool(best.evidence.loss.mean() > null_level(world.score, world.rng))
        if not remains or not grow or len(best.members) == LARGEST_SET:
            return best, world, remains
        here = world.residuals([world.setting(best.members)])[0]
        added = _stage(world, here, best.members).passing()
        if added is None:
            return best, world, remains
        grown = _joint(world, (*best.members, added.members[0]), world.score.loss(nominal))
        extra = best.evidence.loss - grown.evidence.loss
        if extra.mean() <= max(standard_error(extra), EXTRA * best.gain):
            return best, world, remains
        problem, best = world, grown


def _rescored(problem: Problem, best: Fit) -> tuple[Problem, Fit, Compact]:
    """Return problem, fit and nominal residuals in units of the floor of the fitted world."""
    world = problem.setting(best.members)
    spread = floor(
        problem.replayer, problem.recs, problem.begin, problem.plan, problem.rng, NULLS_AGAIN, world
    )
    raw = residual(
        problem.recs, problem.plan, replay_all(problem.replayer, problem.recs, problem.begin, [()])[0]
    )
    new = replace(problem, score=score(raw, spread))
    factor = np.where(new.score.mask, problem.score.sigma / new.score.sigma, 0).astype(np.float32)
    response = best.response.rescaled(factor)
    nominal = new.score.normal(raw)
    evidence = cross_fit(response, new.score, new.parts, new.score.loss(nominal))
    return new, replace(best, response=response, evidence=evidence), nominal


def standard_error(values: Array) -> float:
    """Return the standard error of the mean of independent episodes."""
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def null_level(score: Score, rng: np.random.Generator, quantile: float = 0.99, sets: int = 1000) -> float:
    """Return the quantile of the mean loss of null sets, in floors."""
    count = score.null_loss.shape[1]
    chosen = rng.integers(len(score.null_loss), size=(sets, count))
    return float(np.quantile(score.null_loss[chosen, np.arange(count)].mean(1), quantile))


def _joint(problem: Problem, members: Members, base: Array) -> Fit:
    """Return a set refitted by Gauss-Newton with rollouts: re-linearise, step, keep what lowers the loss."""
    free = [i for i, (c, _) in enumerate(members) if not c.choices]
    fit = Fit(members, _constant(problem, members), CrossFit(base, base, np.zeros((0, 0))))
    plane = fit.response
    for _ in range(REFINEMENTS + 1):
        if not isinstance(plane, Plane) or not free:
            break
        plane = _linearised(problem, fit, plane)
        target = plane.best(np.arange(len(base)))
        trials = [plane.at + share * (target - plane.at) for share in (1.0, 0.5, 0.2)]
        zs = problem.residuals([problem.setting(fit.split(u)) for u in trials])
        losses = [float(problem.score.loss(z).mean()) for z in zs]
        if min(losses) >= float(problem.score.loss(plane.z).mean()):
            break
        at = int(np.argmin(losses))
        plane = replace(plane, at=trials[at], z=zs[at])
    return replace(
        fit,
        members=fit.split(plane.at),
        response=plane,
        evidence=cross_fit(plane, problem.score, problem.parts, base),
    )


def _constant(problem: Problem, members: Members) -> Plane:
    """Return a flat plane at the members' coordinates."""
    at = np.concatenate([u for _, u in members])
    z = problem.residuals([problem.setting(members)])[0]
    low, high = (np.concatenate([getattr(c, side) for c, _ in members]) for side in ("low", "high"))
    return Plane(low, high, at, z, np.zeros((len(at), *z.shape), np.float32))


def _linearised(problem: Problem, fit: Fit, plane: Plane) -> Plane:
    """Return the plane with slopes by finite differences; choices keep a slope of zero."""
    number = np.concatenate([np.full(c.size, not c.choices) for c, _ in fit.members])
    size = 0.02 * (plane.high - plane.low)
    steps = np.where(plane.at + size > plane.high, -size, size)
    moved = [i for i in range(len(steps)) if number[i]]
    points = [plane.at + steps[i] * np.eye(len(steps))[i] for i in moved]
    zs = problem.residuals([problem.setting(fit.split(u)) for u in points])
    slope = np.zeros_like(plane.slope)
    for i, z in zip(moved, zs, strict=True):
        slope[i] = (z - plane.z) / np.float32(steps[i])
    return replace(plane, slope=slope)
