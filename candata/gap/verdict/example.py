"""One held-out episode, recorded, nominal and repaired: what a report draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem
from candata.gap.replay.replayer import replay
from candata.gap.replay.residuals import residual
from candata.gap.validation.closure import HeldOut
from candata.gap.verdict.figures import Example, Trace
from candata.rotation import difference
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Traces that are drawn.
TRACES = 4


def example(problem: Problem, held: HeldOut, fit: Fit | None) -> Example:
    """Return the held-out episode whose discrepancy falls most (without a fit: the middle one)."""
    drop = held.size_before - held.size_after if fit else -np.abs(held.size_before - np.median(held.size_before))
    e = int(np.argmax(drop))
    one, begin = held.recs.take([e]), problem.begin.take(np.array([e]))
    worlds = [()] + ([problem.setting(fit.split(held.points[e]))] if fit else [])
    played = [r["qpos"][0] for r in replay(problem.replayer, one, begin, worlds, keep_state=True)]
    rows = slice(int(begin.rows[0]), int(one.lengths[0]))
    scene = problem.replayer.scene
    return Example(
        one.ids[0],
        np.arange(rows.start, rows.stop) / scene.file.rate_hz,
        _traces(problem, held, e, rows, fit is not None),
        _recorded_qpos(scene, one, played[-1])[rows],
        played[0][rows],
        played[1][rows] if fit else None,
    )


def _traces(problem: Problem, held: HeldOut, e: int, rows: slice, repaired: bool) -> tuple[Trace, ...]:
    """Return the elements whose nominal residual stands out most in one episode, by channel at most two."""
    size = np.abs(residual(held.recs, problem.plan, held.before)[e]) / problem.score.sigma[e].reshape(
        len(problem.plan.phase[e]), -1
    )
    worst = np.argsort(-np.nan_to_num(np.nanmean(np.where(np.isfinite(size), size, 0.0), 0)))
    chosen: list[int] = []
    for column in worst:
        channel = problem.plan.columns[column][0]
        if sum(problem.plan.columns[c][0] == channel for c in chosen) < 2:
            chosen.append(int(column))
    out, compared = [], held.recs.compared
    for column in chosen[:TRACES]:
        channel, element, unit = problem.plan.columns[column]
        first = next(c for c, (ch, _, _) in enumerate(problem.plan.columns) if ch == channel)
        real, before, after = (
            element_values(source, channel, column - first, held.recs.readings, e)[rows]
            for source in (compared, held.before, held.after)
        )
        out.append(Trace(channel, element, unit, real, before, after if repaired else None))
    return tuple(out)


def element_values(source: dict[str, Array], channel: str, column: int, recorded: dict[str, Array], e: int) -> Array:
    """Return `(T,)` one element; rotations as the turn from the first recorded attitude."""
    values = source[channel][e]
    if channel == "object_pose" and column >= 3:
        first = recorded[channel][e][np.isfinite(recorded[channel][e]).all(1)][0]
        return difference(values[:, 3:], np.broadcast_to(first[3:], values[:, 3:].shape))[:, column - 3]
    return values.reshape(len(values), -1)[:, column]


def _recorded_qpos(scene: Scene, one: Recordings, fallback: Array) -> Array:
    """Return `(T, nq)` model positions as recorded; what was not recorded as simulated."""
    qpos = fallback.copy()
    if "joint_position" in one.readings:
        seen = one.readings["joint_position"][0]
        qpos[:, scene.joint_qpos] = np.where(np.isfinite(seen), seen, qpos[:, scene.joint_qpos])
    if "object_pose" in one.readings:
        at = scene.object_qpos
        seen = one.readings["object_pose"][0]
        qpos[:, at : at + 7] = np.where(np.isfinite(seen).all(1, keepdims=True), seen, qpos[:, at : at + 7])
    return qpos
