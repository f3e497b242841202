"""Everything a little wrong: a joint fit over all effects that keeps few, by reweighted L1 (Candes, Wakin & Boyd 2008).

Slopes come from signatures, those of tosses from rollouts, and are read again wherever the fit has moved; each step is
kept only where rollouts lower the loss. How strongly numbers are held back is decided on held-out episodes; those that
stay are refitted freely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.candidates import candidates
from candata.gap.compare import standard_error
from candata.gap.refine import WIDTHS, around, divided, joint, slopes_of, stepped
from candata.gap.response import Plane
from candata.gap.robust import weights
from candata.gap.score import Score
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Rounds of the joint fit at most.
ROUNDS = 7
#: Strengths that are tried, as shares of the one that holds every number at its neutral value.
STRENGTHS = np.geomspace(0.3, 1e-5, 12)
#: Sweeps of coordinate descent (Friedman, Hastie & Tibshirani 2010).
SWEEPS = 200
#: Floors from which an effect at its neutral value changes a few episodes. Chosen: contact deals a tenth by chance.
JUMP = 0.2
#: Share of the gain asked for that all effects together must reach. A refit of those that stay may add a little.
NEARLY = 0.9
#: Share of the gain below which a member is dropped, and how many standard errors its own must be; and the share below
#: which one is dropped whose slopes promise so little, without a simulation. (Of 42 members of one joint fit, slopes
#: told all that were worth more than 0.05 of the gain; simulations deal the others 0.01 to 0.06 floors of luck each.)
LEAST, SURE, HARDLY = 0.02, 1.64, 0.01
#: How many times as much a member must be worth as to be kept for it not to be asked again once others are left out.
#: Chosen.
PLENTY = 3.0


def sparse(problem: Problem, start: Fit, base: Array, least: float = 0.0) -> Fit | None:
    """Return the joint fit of few effects around `start`; None where no step from it helps enough, or no other stays.

    Parameters
    ----------
    problem : Problem
    start : Fit
        What is accepted so far; its choices stay.
    base : (E,) float64
        Loss of the nominal scene in the problem's floors.
    least : float
        Gain [floors] that the fit is to reach with few effects: where all together come nowhere near it, it ends.
    """
    members = _everything(problem, start)
    neutral = np.concatenate([c.neutral for c, _ in members])
    held = np.concatenate([np.full(c.size, bool(c.choices)) for c, _ in members])

    def world(u: Array) -> Members:
        return present(divided(members, u))

    plane = around(problem, members, world)
    # A choice has no slope: to the penalty it would be worth nothing.
    plane = replace(plane, low=np.where(held, plane.at, plane.low), high=np.where(held, plane.at, plane.high))
    pull = np.ones(len(neutral))
    for _ in range(ROUNDS):
        target, pull = _target(problem, plane, neutral, pull)
        moved = stepped(problem, plane, target, world)
        if moved is plane:
            break
        plane = replace(moved, slope=slopes_of(problem, divided(members, moved.at), world, moved.z))
    kept = world(plane.at)
    if len(kept) <= len(start.members) or float((base - problem.score.loss(plane.z)).mean()) < NEARLY * least:
        return None
    # What is worth nothing shows by slopes over one width: no sharp fit is made of it.
    rough = joint(problem, kept, base, WIDTHS[:1])
    found = thinned(problem, rough, base)
    if found is rough:
        return pruned(problem, joint(problem, kept, base, WIDTHS[1:]), base)
    if set(found.labels) <= set(start.labels) and found.gain <= start.gain:
        return None
    return _sharp(problem, found, base, WIDTHS[1:])


def _everything(problem: Problem, start: Fit) -> Members:
    """Return the members of `start` and, at their neutral values, all other candidates that are numbers.

    But those that change a few episodes even at these, as one value for contacts that are not alike does: no small step
    from there is a small one. (A depth of contacts that stood in for that of fingertips five times as deep went from
    0.8 floors left to 2.7, so that no step of all numbers together helped.)
    """
    taken = {c.name for c, _ in start.members} | problem.ruled_out
    every = candidates(problem.replayer.scene, problem.recs.channels)
    found = [(c, c.neutral.copy()) for c in every if c.name not in taken and not c.choices]
    part, _ = brief(problem)
    zs = part.residuals([part.setting((*start.members, *one)) for one in [(), *((m,) for m in found)]])
    now, *losses = (float(part.score.loss(z).mean()) for z in zs)
    return (*start.members, *(m for m, loss in zip(found, losses, strict=True) if abs(loss - now) < JUMP))


def present(members: Members) -> Members:
    """Return the members that are not at their neutral values."""
    return tuple((c, u) for c, u in members if not c.is_neutral(u))


@dataclass(frozen=True)
class _Quadratic:
    """The loss of each episode as a quadratic of the coordinates' distances t from neutral: t A t / 2 + b t."""

    a: Array
    b: Array

    def take(self, index: Index) -> tuple[Array, Array]:
        """Return the sums over some episodes."""
        return self.a[index].sum(0), self.b[index].sum(0)


def _target(problem: Problem, plane: Plane, neutral: Array, held: Array) -> tuple[Array, Array]:
    """Return the coordinates that the penalised fit asks for, and how strongly each is to be held back next time."""
    now = plane.at - neutral
    bounds = (plane.low - neutral, plane.high - neutral)
    quadratic = _quadratic(problem.score, plane, now)
    a, b = quadratic.take(np.arange(len(quadratic.a)))
    size = np.sqrt(np.maximum(np.diag(a), 1e-12))
    most = float(np.max(np.abs(b) / (held * size), initial=0.0))
    strength = _strength(problem, quadratic, held * size, most, bounds)
    t = _descent(a, b, strength * held * size, bounds, np.zeros(len(b)))
    effect = size * np.abs(t)
    return neutral + t, 1.0 / (effect / max(float(effect.max()), 1e-12) + 0.05)


def _quadratic(score: Score, plane: Plane, now: Array) -> _Quadratic:
    """Return the quadratic of the robust loss by the weights at its free fit: outliers there are outliers of all."""
    target = plane.best(np.arange(len(plane.z)))
    weight = np.where(score.mask, weights(plane.read(target)), 0).astype(np.float32)
    unit = np.maximum(score.mask.sum(1), 1) * score.floor
    slope = plane.slope.transpose(1, 0, 2)
    weighted = slope * weight[:, None, :]
    a = (weighted @ slope.transpose(0, 2, 1)).astype(float) / unit[:, None, None]
    b = np.einsum("edk,ek->ed", weighted, plane.z, dtype=np.float64) / unit[:, None]
    return _Quadratic(a, b - a @ now)


def _strength(problem: Problem, quadratic: _Quadratic, held: Array, most: float, bounds: tuple[Array, Array]) -> float:
    """Return the penalty with the least held-out loss."""
    loss = np.zeros((len(STRENGTHS), len(quadratic.a)))
    for test in problem.parts:
        a, b = quadratic.take(np.setdiff1d(np.arange(len(quadratic.a)), test))
        t = np.zeros(len(b))
        for i, share in enumerate(STRENGTHS):
            t = _descent(a, b, share * most * held, bounds, t)
            loss[i, test] = quadratic.b[test] @ t + 0.5 * np.einsum("i,eij,j->e", t, quadratic.a[test], t)
    return float(STRENGTHS[int(loss.mean(1).argmin())] * most)


def _descent(a: Array, b: Array, penalty: Array, bounds: tuple[Array, Array], start: Array) -> Array:
    """Return t of least `t a t / 2 + b t + penalty |t|` within bounds, by coordinate descent from `start`."""
    t, size = start.tolist(), np.maximum(np.diag(a), 1e-12).tolist()
    low, high, pull = bounds[0].tolist(), bounds[1].tolist(), penalty.tolist()
    down, columns = a @ start + b, a.T.copy()
    for _ in range(SWEEPS):
        before = list(t)
        for i, own in enumerate(size):
            wish = own * t[i] - float(down[i])
            moved = max(wish - pull[i], 0.0) + min(wish + pull[i], 0.0)
            moved = min(max(moved / own, low[i]), high[i])
            if moved != t[i]:
                down += (moved - t[i]) * columns[i]
                t[i] = moved
        if max(abs(x - y) for x, y in zip(t, before, strict=True)) <= 1e-6 * max(*map(abs, t), 1e-12):
            break
    return np.array(t)


def pruned(problem: Problem, fit: Fit, base: Array, widths: Sequence[float] = WIDTHS[1:]) -> Fit:
    """Return the fit without the members that are worth nothing, the others fitted sharply, until all are worth it.

    Where members are left out, slopes go on from the first of the `widths`.
    """
    light = thinned(problem, fit, base)
    return fit if light is fit else _sharp(problem, light, base, widths)


def _sharp(problem: Problem, light: Fit, base: Array, widths: Sequence[float]) -> Fit:
    """Return a light fit fitted sharply: there, a member may be worth nothing that was worth a little before."""
    fit = joint(problem, light.members, base, widths)
    return fit if len(_likely(problem, fit, base)) == len(fit.members) else pruned(problem, fit, base, WIDTHS[-1:])


def thinned(problem: Problem, fit: Fit, base: Array) -> Fit:
    """Return the fit without the members that are worth nothing, the others fitted lightly; itself where none is."""
    kept, sure = _worthy(problem, fit, base)
    while len(kept) < len(fit.members):
        fit = joint(problem, kept, base, widths=())
        kept, more = _worthy(problem, fit, base, sure)
        sure |= more
    return fit


def _likely(problem: Problem, fit: Fit, base: Array) -> Members:
    """Return the members that slopes promise something of."""
    left = float(problem.score.loss(fit.plane.z).mean())
    least = HARDLY * (float(base.mean()) - left)
    promised = [float(problem.score.loss(fit.plane_without([m]).z).mean()) - left for m in fit.members]
    return tuple(m for m, rise in zip(fit.members, promised, strict=True) if m[0].choices or rise > least)


def _worthy(
    problem: Problem, fit: Fit, base: Array, sure: frozenset[str] = frozenset()
) -> tuple[Members, frozenset[str]]:
    """Return the members that slopes promise something of, or, where those are all, that simulations say are worth it.

    All of them where none is. With them come the labels of those worth so much that they are not asked again once
    others are left out, which are `sure` from then on.
    """
    likely = _likely(problem, fit, base)
    if 0 < len(likely) < len(fit.members):
        return likely, frozenset()
    losses = problem.score.loss(fit.plane.z)
    gain = float((base - losses).mean())
    asked = tuple(m for m in fit.members if m[0].label not in sure and not m[0].choices)
    rises = [problem.score.loss(z) - losses for z in problem.without_each(fit.members, asked)]
    idle = [m for m, rise in zip(asked, rises, strict=True) if not _is_worth(rise, gain)]
    more = [m[0].label for m, rise in zip(asked, rises, strict=True) if _is_worth(rise / PLENTY, gain)]
    kept = tuple(m for m in fit.members if all(m is not one for one in idle))
    return kept or fit.members, frozenset(more)


def _is_worth(rise: Array, gain: float) -> bool:
    """Tell whether leaving a member out raises the losses by `rise (E,)`, enough of the `gain` of all."""
    return bool(rise.mean() > max(LEAST * gain, SURE * standard_error(rise)))
