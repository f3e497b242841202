"""Closed loop: forecast, execute a few steps, feed the own poses back, to the end of the episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.loaders import Windows
from candata.loaders.increments import integrate
from candata.training.forecasters import Forecaster
from candata.training.poses import mean_pose

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
    """

    windows: Windows
    episodes: NDArray[np.int64]
    steps: NDArray[np.int64]
    observed: NDArray
    truth: NDArray
    valid: NDArray[np.bool_]
    contact: NDArray[np.bool_] | None

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
    """

    poses: NDArray
    contact: NDArray | None


def course(windows: Windows) -> Course:
    """Return the episodes that the windows are of, each from the first valid row with a whole history.

    An episode shorter than that begins at its first valid row, with the history padded; one without a valid row after
    its beginning is left out.

    Raises
    ------
    DataError
        When no episode has such a row.
    """
    found = _course(windows, np.unique(windows.owner))
    kept = found.valid.any(axis=1)
    if not kept.any():
        raise DataError("no episode can be followed in closed loop: no pose after its first rows is valid")
    return found if kept.all() else _course(windows, found.episodes[kept])


def _course(windows: Windows, episodes: NDArray[np.int64]) -> Course:
    """Return the course of these episodes."""
    first = windows.history - 1
    stride = windows.stride[episodes]
    rows = np.array(windows.cache.file.rows, np.int64)[episodes]
    in_all = (rows - 1) // stride
    begin = windows.cache.begin[episodes]
    start = _starts(windows, begin, stride, in_all)
    steps = in_all - start

    def gathered(offsets: NDArray[np.int64]) -> NDArray[np.int64]:
        wanted: NDArray[np.int64] = (start[:, None] + offsets) * stride[:, None]
        return begin[:, None] + np.clip(wanted, 0, (in_all * stride)[:, None])

    before, after = gathered(np.arange(-first, 1)), gathered(np.arange(1, steps.max() + 1))
    table, inside = windows.cache.rows, np.arange(1, steps.max() + 1) <= steps[:, None]
    has_contact = "contact" in windows.channels
    return Course(
        replace(windows, present_row=begin + start * stride, owner=episodes),
        episodes,
        steps,
        table["object_pose"][before].astype(np.float64),
        table["object_pose"][after].astype(np.float64),
        inside & windows.cache.valid[after] & _unbroken(windows, begin + start * stride, after),
        table["contact"][np.concatenate([before, after], axis=1)] if has_contact else None,
    )


def _unbroken(windows: Windows, present: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return `(E, N)`: rows with none missing since the loop began; the loop does not know how long a break was."""
    stretch = windows.cache.stretch
    return np.asarray(stretch[rows] == stretch[present][:, None])


def _starts(
    windows: Windows, begin: NDArray[np.int64], stride: NDArray[np.int64], in_all: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the step `(E,)` at which each episode's loop begins.

    What stands in for an invalid pose at an episode's beginning is the first valid one, which lies in the future.
    """
    first = windows.history - 1
    found = first * (in_all > first).astype(np.int64)
    for number, start in enumerate(found.tolist()):
        rows = begin[number] + np.arange(start, in_all[number] + 1) * stride[number]
        found[number] += np.argmax(windows.cache.valid[rows])
    return found


def at_rows(windows: Windows, chosen: NDArray[np.int64], step: NDArray[np.int64]) -> dict[str, NDArray]:
    """Return the windows `step` model steps after the first one of each chosen episode of a course."""
    index = np.searchsorted(windows.owner, chosen)
    present = windows.present_row[index] + step * windows.stride[chosen]
    return replace(windows, present_row=present, owner=chosen).batch(np.arange(len(chosen)))


def close_loop(given: Course, forecaster: Forecaster, execute: int, seed: int) -> Loop:
    """Return the poses of a forecaster that sees its own poses, and contacts where it forecasts them.

    Joints and actions are replayed from the recording, the planned ones too. The mean of the samples is executed.

    Parameters
    ----------
    given : Course
        Episodes.
    forecaster : Forecaster
        Who forecasts.
    execute : int
        Steps executed before the next forecast; at most the horizon.
    seed : int
        Seed of the noise.
    """
    past, longest = given.observed.shape[1], given.truth.shape[1]
    poses = np.concatenate([given.observed, np.zeros_like(given.truth)], axis=1)
    contact = None if given.contact is None else given.contact.astype(float)
    forecast_contact = False
    for done in range(0, longest, execute):
        alive = np.flatnonzero(given.steps > done)
        batch = at_rows(given.windows, given.episodes[alive], np.full(len(alive), done))
        # What the loop has made is known, whatever the recording has gaps in.
        batch["history_pad"] &= np.arange(1 - past, 1) + done <= 0
        batch["history/object_pose"] = poses[alive, done : done + past].astype(np.float32)
        if contact is not None:
            batch["history/contact"] = contact[alive, done : done + past] >= CONTACT_THRESHOLD
        found = forecaster.forecast(batch, (seed, done))
        ahead = min(execute, longest - done)
        part = slice(past + done, past + done + ahead)
        led = mean_pose(integrate(poses[alive, past + done - 1], found.increments[:, :, :ahead]))
        poses[alive, part] = led
        if contact is not None and found.contact is not None:
            contact[alive, part] = found.contact[:, :ahead]
            forecast_contact = True
    return Loop(poses[:, past:], contact[:, past:] if contact is not None and forecast_contact else None)


def shown(ranked: Sequence[float], count: int) -> list[int]:
    """Return `count` places evenly spread over the ranks of the values, the least first: no choice of the best."""
    order = np.argsort(np.asarray(ranked), kind="stable")
    places = np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int)
    return [int(order[place]) for place in places]
