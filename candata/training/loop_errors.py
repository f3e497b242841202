"""Errors of a closed loop at each row, and what they come to over episodes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from candata.training import metrics
from candata.training.contact_scores import contact_scores, event_timing
from candata.training.poses import position_error, rotation_error
from candata.training.results import ClosedLoopScores, LongLoopScores, Success
from candata.training.rollout import Course, Loop

#: Times after the beginning of a closed loop at which long loops are scored [s]. Chosen: one horizon, a grasp, a task.
LONG_LOOPS_S = (2.0, 5.0, 10.0)


@dataclass(frozen=True)
class LoopErrors:
    """Errors of a closed loop, `(E, N)`; ADD-S is None without point clouds."""

    position: NDArray
    rotation: NDArray
    adds: NDArray | None
    loop: Loop = field(repr=False)


def loop_errors(course: Course, loop: Loop, clouds: NDArray | None) -> LoopErrors:
    """Return the errors of a loop at each row of a course; `clouds` as `Windows.clouds`, or None."""
    adds = metrics.adds_of(clouds, course.cloud, loop.poses, course.truth) if clouds is not None else None
    return LoopErrors(position_error(loop.poses, course.truth), rotation_error(loop.poses, course.truth), adds, loop)


def area(course: Course, errors: LoopErrors) -> NDArray:
    """Return `(E,)`: what each episode's rows add to the area under the curve of ADD-S; 0 without ADD-S."""
    if errors.adds is None:
        return np.zeros(len(course.episodes))
    return np.where(course.valid, metrics.auc_share(errors.adds), 0.0).sum(axis=1)


def final_position_error(course: Course, errors: LoopErrors) -> NDArray:
    """Return the error `(E,) [m]` at each episode's last row that counts."""
    last_rows = course.valid.shape[1] - 1 - np.argmax(course.valid[:, ::-1], axis=1)
    return errors.position[np.arange(len(last_rows)), last_rows]


def closed_loop_scores(course: Course, errors: LoopErrors) -> ClosedLoopScores:
    """Return the closed-loop scores of a forecaster, without the interval of its area."""
    is_valid, final_m = course.valid, final_position_error(course, errors)
    contact, history_rows = course.contact, course.observed.shape[1]
    truth, present = (None, None) if contact is None else (contact[:, history_rows:], contact[:, history_rows - 1])
    timing = (errors.loop.contact, truth, present, is_valid, course.windows.rate_hz)
    return ClosedLoopScores(
        adds_auc=metrics.auc(errors.adds[is_valid]) if errors.adds is not None else None,
        adds_m=float(errors.adds[is_valid].mean()) if errors.adds is not None else None,
        position_error_m=float(errors.position[is_valid].mean()),
        rotation_error_rad=float(errors.rotation[is_valid].mean()),
        final_position_error_m=float(final_m.mean()),
        success=_success(final_m),
        contact=contact_scores(errors.loop.contact, truth, is_valid),
        onset=event_timing(*timing, is_onset=True),
        release=event_timing(*timing, is_onset=False),
        long_loops=tuple(_long_loop(course, errors, time_s) for time_s in LONG_LOOPS_S),
    )


def _success(final_m: NDArray) -> Success:
    """Return how many final positions are near the true ones."""
    count, total = int((final_m <= metrics.SUCCESS_M).sum()), len(final_m)
    low, high = map(float, binomtest(count, total).proportion_ci(0.95, "wilson"))
    return Success(count=count, total=total, share=count / total, low=low, high=high)


def _long_loop(course: Course, errors: LoopErrors, time_s: float) -> LongLoopScores:
    """Return the errors some time after the loops began, over the episodes whose pose is recorded then."""
    step = round(time_s * course.windows.rate_hz)
    is_long = course.valid[:, step - 1] if 1 <= step <= course.valid.shape[1] else np.zeros(len(course.steps), bool)
    if not is_long.any():
        return LongLoopScores(
            time_s=time_s, episodes=0, position_error_m=None, rotation_error_rad=None, adds_m=None, adds_auc=None
        )
    adds, rows = errors.adds, course.valid[is_long, :step]
    return LongLoopScores(
        time_s=time_s,
        episodes=int(is_long.sum()),
        position_error_m=float(errors.position[is_long, step - 1].mean()),
        rotation_error_rad=float(errors.rotation[is_long, step - 1].mean()),
        adds_m=None if adds is None else float(adds[is_long, step - 1].mean()),
        adds_auc=None if adds is None else metrics.auc(adds[is_long, :step][rows]),
    )
