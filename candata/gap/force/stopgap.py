"""The stop-gap: a described residual force put into the simulator, judged on episodes that took no part in its fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from candata.effects import effect, setting
from candata.effects._residual_terms import AXES, JOINT_TERMS, sizes
from candata.gap.fit.folds import rest
from candata.gap.fit.problem import Problem
from candata.gap.force.dictionary import fitted
from candata.gap.force.suspects import Suspect, tip_terms
from candata.gap.replay.replayer import EffectSet, replay_all
from candata.gap.replay.residuals import residual
from candata.gap.screening.episodes import taken
from candata.scenes import Scene
from candata.schema.effect import EffectSetting

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Name of the effect that plays a fitted residual force.
EFFECT = "learned_residual"
#: Multiples of the regressed force that are played to find how large it is: an observer shrinks what it sees.
SCALES = (0.5, 1.0, 1.5, 2.0)


@dataclass(frozen=True)
class Stopgap:
    """Residual forces in the simulator.

    Attributes
    ----------
    suspects : tuple of Suspect
        Where they act, the best first: one place, or several of a kind.
    scale : float
        What their regressed coefficients are multiplied by, from all episodes.
    settings : tuple of EffectSetting
        Of `learned_residual`; empty for a fault of a reading, which no force mends.
    loss, size : (E,) float64
        Held-out loss and discrepancy of each episode, in floors.
    before : (E,) float64
        Discrepancy without it.
    """

    suspects: tuple[Suspect, ...]
    scale: float
    settings: EffectSet
    loss: Array
    size: Array
    before: Array

    @property
    def closed(self) -> float:
        """Share of the gap that it closes on held-out episodes, between -1 and 1; none where all ask for no force."""
        before, after = float(self.before.mean()), float(self.size.mean())
        closed = float(np.clip(1 - (after - 1) / max(before - 1, 1e-6), -1, 1))
        return closed if self.scale else min(closed, 0.0)


def stopgap(
    problem: Problem,
    world: EffectSet,
    nominal: dict[str, Array],
    some: Sequence[Suspect],
    index: Index | None = None,
) -> Stopgap:
    """Return the forces of suspects as a stop-gap, with what it closes on held-out episodes.

    Which terms there are was chosen on all episodes; their coefficients and their size come from the other folds.

    Parameters
    ----------
    problem : Problem
        Episodes, folds and score.
    world : tuple of EffectSetting
        What the simulator holds already.
    nominal : dict of str to (E, T, ...) float64
        What sensors read in that world, replayed.
    some : sequence of Suspect
        One, or several of a kind: fingertips, or what forces act on.
    index : (P,) int64, optional
        Episodes that it is played on, at least one of each fold; all when not given.
    """
    index = np.arange(len(problem.recs)) if index is None else index
    part = replace(taken(problem, index), parts=[np.flatnonzero(np.isin(index, fold)) for fold in problem.parts])
    trains = [rest(problem.parts, fold) for fold in range(len(problem.parts))]
    before = {name: values[index] for name, values in nominal.items()}
    if some[0].place == "fingertip":
        return _reading(part, before, some, trains)
    scene = problem.replayer.scene

    def settings(scale: float, train: Index | None = None) -> EffectSet:
        """Return the suspects' forces, fitted to some episodes, times a scale."""
        fits = [
            s.description.coefficients if train is None else fitted(s.sample, s.description.terms, train) for s in some
        ]
        return tuple(_setting(scene, s, scale * fit) for s, fit in zip(some, fits, strict=True))

    readings = replay_all(part.replayer, part.recs, part.begin, [(*world, *settings(scale)) for scale in SCALES])
    losses = np.stack([_judged(part, r)[0] for r in (before, *readings)])
    after = {name: values.copy() for name, values in before.items()}
    for fold, (test, train) in enumerate(zip(part.parts, trains, strict=True)):
        own = settings(_best_scale(losses[:, rest(part.parts, fold)].mean(1)), train)
        played = replay_all(part.replayer, part.recs.take(test), part.begin.take(test), [(*world, *own)])[0]
        for name, values in played.items():
            after[name][test] = values
    scale = _best_scale(losses.mean(1))
    loss, size = _judged(part, after)
    return Stopgap(tuple(some), scale, settings(scale), loss, size, _judged(part, before)[1])


def _reading(problem: Problem, before: dict[str, Array], some: Sequence[Suspect], trains: Sequence[Index]) -> Stopgap:
    """Return a correction of what fingertips read, with what it closes on held-out episodes; fitted to `trains`."""
    scene = problem.replayer.scene
    tips = [scene.file.fingertips.index(s.element) for s in some]
    felt = np.nan_to_num(before["fingertip_force"])
    terms = [
        tip_terms(scene, felt[:, :, tip])[..., list(s.description.terms)] for tip, s in zip(tips, some, strict=True)
    ]

    def corrected(scales: Sequence[float], fits: Sequence[Sequence[Array]]) -> tuple[Array, Array]:
        """Return loss and discrepancy with each fold's readings corrected by its own fits."""
        force = before["fingertip_force"].copy()
        for test, scale, own in zip(problem.parts, scales, fits, strict=True):
            for tip, term, fit in zip(tips, terms, own, strict=True):
                force[test, :, tip] += scale * np.einsum("etak,ka->eta", term[test], fit)
        return _judged(problem, before | {"fingertip_force": force})

    folds = len(problem.parts)
    whole = [s.description.coefficients for s in some]
    losses = np.stack([corrected([s] * folds, [whole] * folds)[0] for s in (0.0, *SCALES)])
    fits = [[fitted(s.sample, s.description.terms, train) for s in some] for train in trains]
    scales = [_best_scale(losses[:, rest(problem.parts, fold)].mean(1)) for fold in range(folds)]
    loss, size = corrected(scales, fits)
    return Stopgap(tuple(some), _best_scale(losses.mean(1)), (), loss, size, _judged(problem, before)[1])


def _judged(problem: Problem, readings: dict[str, Array]) -> tuple[Array, Array]:
    """Return `(E,)` loss and discrepancy; infinite where the simulation broke."""
    broken = ~np.array([np.isfinite(v[:, -1].reshape(len(v), -1)).all(1) for v in readings.values()]).all(0)
    z = problem.score.normal(residual(problem.recs, problem.plan, readings))
    return tuple(np.where(broken, np.inf, value) for value in (problem.score.loss(z), problem.score.size(z)))  # type: ignore[return-value]


def _best_scale(losses: Array) -> float:
    """Return the multiple with the least loss on a cubic spline through 0 and `SCALES`; 0 where a replay broke."""
    if not np.isfinite(losses).all():
        return 0.0
    curve = CubicSpline((0.0, *SCALES), losses)
    grid = np.linspace(0, SCALES[-1], 81)
    return float(grid[np.argmin(curve(grid))])


def _setting(scene: Scene, suspect: Suspect, coefficients: Array) -> EffectSetting:
    """Return coefficients `(k, A)` of a suspect as a setting of the effect."""
    parameters = effect(EFFECT).parameters
    x = np.concatenate([np.full(p.size(scene), p.identity(scene)) for p in parameters])
    joints, total = sizes(scene)[0], sum(sizes(scene))
    for k, row in zip(suspect.description.terms, coefficients, strict=True):
        if suspect.place == "object":
            first = joints + k * AXES
            x[first + suspect.axes.start : first + suspect.axes.stop] = row
        else:
            j = scene.file.joints.index(suspect.element)
            x[j * len(JOINT_TERMS) + k] = row[0]
            x[total + j] = suspect.wave
    # A regression on little motion may ask for more than the effect takes: the largest stands for it.
    ends = np.concatenate([np.tile(p.bounds(scene), (p.size(scene), 1)) for p in parameters])
    return setting(EFFECT, np.clip(x, *ends.T), scene, suspect.element)
