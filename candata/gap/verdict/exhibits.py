"""What a report draws beyond the record: elements by episode, how alike candidates are, where parameters may lie."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from candata.effects import parameters_on
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve
from candata.gap.measure.score import Compact, Score
from candata.gap.replay.residuals import Layout, residual
from candata.gap.validation.closure import HeldOut
from candata.gap.verdict.example import element_values
from candata.gap.verdict.figures import Collinearity, Course, Element, Elements, Range
from candata.scenes import Scene
from candata.schema.report import NamedEffect

Array = NDArray[np.float64]
#: Episodes of an element whose courses are kept, and points of a course: more cannot be told apart at their size.
COURSES, POINTS = 3, 100
#: Candidates whose signatures are compared.
COMPARED = 8


def elements(problem: Problem, held: HeldOut, repaired: bool) -> Elements:
    """Return every column of the residual by held-out episode, with the courses of a few episodes.

    Parameters
    ----------
    problem : Problem
        Where `held` was measured: its layout, floor and starts.
    held : HeldOut
    repaired : bool
        Whether `held.after` is a repair worth showing.
    """
    plan, score = problem.plan, problem.score
    before = _sizes(plan, score, score.normal(residual(held.recs, plan, held.before)))
    after = _sizes(plan, score, score.normal(residual(held.recs, plan, held.after))) if repaired else None
    null = np.mean([_sizes(plan, score, z) for z in score.null], axis=0)
    found = []
    for column, (channel, element, unit) in enumerate(plan.columns):
        own = None if after is None else after[:, column]
        courses = tuple(_course(problem, held, column, e, repaired) for e in _spread(before[:, column]))
        found.append(Element(channel, element, unit, before[:, column], own, null[:, column], courses))
    return Elements(held.recs.ids, tuple(found))


def _sizes(plan: Layout, score: Score, z: Compact) -> Array:
    """Return `(E, D)` the mean size of normalised residuals `(E, K)` by column, in its unit; NaN where unseen."""
    shape = (*plan.phase.shape, len(plan.columns))
    size = (np.abs(z) * score.sigma * score.mask).reshape(shape)
    count = score.mask.reshape(shape).sum(1)
    return np.where(count > 0, size.sum(1, dtype=np.float64) / np.maximum(count, 1), np.nan)


def _spread(size: Array) -> list[int]:
    """Return a few episodes from the largest to the smallest value; those that are not finite take no part."""
    order = np.argsort(-size, kind="stable")[: int(np.isfinite(size).sum())]
    places = np.linspace(0, len(order) - 1, min(COURSES, len(order))).round().astype(int)
    return [int(order[i]) for i in np.unique(places)]


def _course(problem: Problem, held: HeldOut, column: int, e: int, repaired: bool) -> Course:
    """Return one column over one episode at no more than `POINTS` points."""
    plan = problem.plan
    channel = plan.columns[column][0]
    first = next(c for c, (name, _, _) in enumerate(plan.columns) if name == channel)
    start, end = int(problem.begin.rows[e]), int(held.recs.lengths[e])
    rows = np.arange(start, end, max(1, -(-(end - start) // POINTS)))
    compared = held.recs.compared
    real, before, after = (
        element_values(source, channel, column - first, held.recs.readings, e)[rows]
        for source in (compared, held.before, held.after)
    )
    return Course(e, rows / problem.replayer.scene.file.rate_hz, real, before, after if repaired else None)


def collinearity(fits: Sequence[Fit], most: int = COMPARED) -> Collinearity | None:
    """Return the cosines between what the first `most` candidates change; None for fewer than two.

    Of an effect on several elements the best stands for all.
    1: alike up to their size, 0: nothing in common, -1: what one adds the other takes away. Of a vector it is the
    direction it was fitted with. Source: collinearity of sensitivities, Brun, Reichert & Kuensch 2001.
    """
    best: dict[tuple[str, ...], Fit] = {}
    for fit in fits:
        best.setdefault(tuple(c.name for c, _ in fit.members), fit)
    shown = list(best.values())[:most]
    changes = [(" + ".join(fit.labels), change(fit).ravel().astype(float)) for fit in shown]
    lively = [(label, z / np.linalg.norm(z)) for label, z in changes if np.linalg.norm(z) > 0]
    if len(lively) < 2:
        return None
    unit = np.stack([z for _, z in lively])
    return Collinearity(tuple(label for label, _ in lively), unit @ unit.T)


def change(fit: Fit) -> Compact:
    """Return `(E, K)` what a fit changes in the normalised residuals: from its absence to where it was fitted.

    A scalar that was fitted to its absence is read over its whole grid.
    """
    u = np.concatenate([u for _, u in fit.members])
    neutral = np.concatenate([c.neutral for c, _ in fit.members])
    response = fit.response
    if not isinstance(response, Curve):
        return np.tensordot((u - neutral).astype(np.float32), response.slope, 1)
    if np.allclose(u, neutral, atol=1e-9):
        return response.z[-1] - response.z[0]
    return response.read(u) - response.neutral()


def ranges(named: Iterable[NamedEffect], scene: Scene) -> dict[tuple[str, str | None, str], Range]:
    """Return where each number of the named effects was searched, by (effect, element, parameter); no choices."""
    found = {}
    for one in named:
        for p in parameters_on(one.name, scene, one.element):
            if not p.choices:
                low, high = p.bounds(scene)
                at = float(p.identity(scene))
                found[one.name, one.element, p.name] = Range(float(low), float(high), None if np.isnan(at) else at)
    return found
