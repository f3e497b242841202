"""Closed loop: forecast, execute a few steps, feed the own poses back, to the end of the episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.loaders import Windows
from candata.loaders.increments import integrate
from candata.training.forecasters import JOINTS_FED, Forecaster
from candata.training.poses import mean_pose

#: Steps of a chunk in closed loop, half the default horizon.
EXECUTE = 8
#: Probability from which a forecast of contact is fed back as contact.
CONTACT_THRESHOLD = 0.5


@dataclass(frozen=True)
class Course:
    """Recorded episodes at the model's rate, all from the row at which the loops begin.

    Attributes
    ----------
    windows : Windows
        Where they came from.
    episodes : (E,) int64
        Their numbers in `windows.episode_ids`.
    steps : (E,) int64
        Steps of each loop.
    observed : (E, K + 1, 7)
        Poses seen before a loop begins, the one it begins with last.
    truth : (E, N, 7)
        Recorded poses at the steps of the longest loop; those behind an episode's end repeat its last.
    valid : (E, N) bool
        Which of them count.
    contact : (E, K + 1 + N) bool or None
        Recorded contact, from the first row observed on.
    joints : (E, N, J) float64 or None
        What the loops are fed as joints; None replays the recorded ones.
    """

    windows: Windows
    episodes: NDArray[np.int64]
    steps: NDArray[np.int64]
    observed: NDArray
    truth: NDArray
    valid: NDArray[np.bool_]
    contact: NDArray[np.bool_] | None
    joints: NDArray | None = None

    @property
    def cloud(self) -> NDArray[np.int64]:
        """`(E,) int64`: index of each episode's point cloud, -1 without one."""
        return np.asarray(at_rows(self.windows, self.episodes, np.zeros(len(self.episodes), np.int64))["cloud"])


@dataclass(frozen=True)
class Loop:
    """What a forecaster made of a course.

    Attributes
    ----------
    poses : (E, N, 7) float64
        Its poses, at the steps of `Course.truth`.
    contact : (E, N) float64 or None
        Its probability of contact.
    joints : (E, N, J) float64 or None
        Its joints; None where it forecasts none.
    """

    poses: NDArray
    contact: NDArray | None
    joints: NDArray | None = None


@runtime_checkable
class FreeRunner(Protocol):
    """A forecaster that goes on from its own state, and so needs no forecast after forecast."""

    def free_run(self, course: Course) -> Loop:
        """Return the closed loop of a course, without a look at what was recorded after its beginning."""


def course(windows: Windows, rows_before: int | None = None) -> Course:
    """Return the episodes that the windows are of, each from the first valid row with a whole history.

    An episode shorter than that begins at its first valid row, with the history padded; one without a valid row after
    its beginning is left out.

    Parameters
    ----------
    windows : Windows
        What is followed.
    rows_before : int, optional
        Rows up to the one at which a loop begins, itself included, where they are more than the history: so that
        models with different histories begin at the same row.

    Raises
    ------
    DataError
        When no episode has such a row.
    """
    first_step = (rows_before or windows.history) - 1
    course_all = _course(windows, np.unique(windows.owner), first_step)
    has_valid_rows = course_all.valid.any(axis=1)
    if not has_valid_rows.any():
        raise DataError("no episode can be followed in closed loop: no pose after its first rows is valid")
    if has_valid_rows.all():
        return course_all
    return _course(windows, course_all.episodes[has_valid_rows], first_step)


def _course(windows: Windows, episodes: NDArray[np.int64], first_step: int) -> Course:
    """Return the course of these episodes, which begin at this step or later."""
    last_history_step = windows.history - 1
    stride = windows.stride[episodes]
    rows = np.array(windows.cache.file.rows, np.int64)[episodes]
    total_steps = (rows - 1) // stride
    begin = windows.cache.begin[episodes]
    start = _starts(windows, begin, stride, total_steps, first_step)
    steps = total_steps - start

    def rows_at(offsets: NDArray[np.int64]) -> NDArray[np.int64]:
        row_offsets: NDArray[np.int64] = (start[:, None] + offsets) * stride[:, None]
        return begin[:, None] + np.clip(row_offsets, 0, (total_steps * stride)[:, None])

    past_rows, future_rows = rows_at(np.arange(-last_history_step, 1)), rows_at(np.arange(1, steps.max() + 1))
    table, is_inside = windows.cache.rows, np.arange(1, steps.max() + 1) <= steps[:, None]
    has_contact = "contact" in windows.channels
    return Course(
        replace(windows, present_row=begin + start * stride, owner=episodes),
        episodes,
        steps,
        table["object_pose"][past_rows].astype(np.float64),
        table["object_pose"][future_rows].astype(np.float64),
        is_inside & windows.cache.valid[future_rows] & _unbroken(windows, begin + start * stride, future_rows),
        table["contact"][np.concatenate([past_rows, future_rows], axis=1)] if has_contact else None,
    )


def _unbroken(windows: Windows, present_rows: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return `(E, N)`: rows with none missing since the loop began; the loop does not know how long a break was."""
    stretch = windows.cache.stretch
    return np.asarray(stretch[rows] == stretch[present_rows][:, None])


def _starts(
    windows: Windows,
    begin: NDArray[np.int64],
    stride: NDArray[np.int64],
    total_steps: NDArray[np.int64],
    first_step: int,
) -> NDArray[np.int64]:
    """Return the step `(E,)` at which each episode's loop begins.

    What stands in for an invalid pose at an episode's beginning is the first valid one, which lies in the future.
    """
    start_steps = first_step * (total_steps > first_step).astype(np.int64)
    for number, start in enumerate(start_steps.tolist()):
        rows = begin[number] + np.arange(start, total_steps[number] + 1) * stride[number]
        start_steps[number] += np.argmax(windows.cache.valid[rows])
    return start_steps


def repeated(course: Course, numbers: NDArray[np.int64]) -> Course:
    """Return the course of some episodes of a course, by their numbers in it; one may be there several times."""
    return replace(
        course,
        episodes=course.episodes[numbers],
        steps=course.steps[numbers],
        observed=course.observed[numbers],
        truth=course.truth[numbers],
        valid=course.valid[numbers],
        contact=None if course.contact is None else course.contact[numbers],
        joints=None if course.joints is None else course.joints[numbers],
    )


def at_rows(windows: Windows, episodes: NDArray[np.int64], step: NDArray[np.int64]) -> dict[str, NDArray]:
    """Return the windows `step` model steps after the first one of each chosen episode of a course."""
    index = np.searchsorted(windows.owner, episodes)
    present_rows = windows.present_row[index] + step * windows.stride[episodes]
    return replace(windows, present_row=present_rows, owner=episodes).batch(np.arange(len(episodes)))


def close_loop(course: Course, forecaster: Forecaster, execute: int, seed: int) -> Loop:
    """Return the poses of a forecaster that sees its own poses, and contacts where it forecasts them.

    Actions are replayed from the recording, the planned ones too, and so are joints where the course has none. The mean
    of the samples is executed. A `FreeRunner` plays the whole course on its own.

    Parameters
    ----------
    course : Course
        Episodes.
    forecaster : Forecaster
        Who forecasts.
    execute : int
        Steps executed before the next forecast; at most the horizon.
    seed : int
        Seed of the noise.
    """
    if isinstance(forecaster, FreeRunner):
        return forecaster.free_run(course)
    history_rows, longest_steps = course.observed.shape[1], course.truth.shape[1]
    poses = np.concatenate([course.observed, np.zeros_like(course.truth)], axis=1)
    contact = None if course.contact is None else course.contact.astype(float)
    forecast_contact = False
    for step in range(0, longest_steps, execute):
        active = np.flatnonzero(course.steps > step)
        batch = at_rows(course.windows, course.episodes[active], np.full(len(active), step))
        # What the loop has made is known, whatever the recording has gaps in.
        batch["history_pad"] &= np.arange(1 - history_rows, 1) + step <= 0
        batch["history/object_pose"] = poses[active, step : step + history_rows].astype(np.float32)
        if course.joints is not None and "history/joint_position" in batch:
            steps_fed = np.arange(1 - history_rows, 1) + step
            joints = course.joints[np.ix_(active, steps_fed[steps_fed > 0] - 1)]
            batch["history/joint_position"][:, steps_fed > 0] = joints
            batch[JOINTS_FED] = np.ones(len(active), bool)
        if contact is not None:
            batch["history/contact"] = contact[active, step : step + history_rows] >= CONTACT_THRESHOLD
        forecast = forecaster.forecast(batch, (seed, step))
        step_count = min(execute, longest_steps - step)
        part = slice(history_rows + step, history_rows + step + step_count)
        predicted = mean_pose(integrate(poses[active, history_rows + step - 1], forecast.increments[:, :, :step_count]))
        poses[active, part] = predicted
        if contact is not None and forecast.contact is not None:
            contact[active, part] = forecast.contact[:, :step_count]
            forecast_contact = True
    return Loop(
        poses[:, history_rows:], contact[:, history_rows:] if contact is not None and forecast_contact else None
    )


def evenly_ranked(values: Sequence[float], count: int) -> list[int]:
    """Return `count` places evenly spread over the ranks of the values, the least first: no choice of the best."""
    order = np.argsort(np.asarray(values), kind="stable")
    places = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    return [int(order[place]) for place in places]
