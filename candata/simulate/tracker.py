"""Poses as a tracker gives them: slower than the log, late, drifting, and lost at times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.rotation import exp, multiply
from candata.schema.channels import VALID_SUFFIX
from candata.schema.scene import Noise, Tracker

Array = NDArray[np.float64]


def with_tracker(
    readings: dict[str, Array], noise: Noise | None, rate_hz: float, rng: np.random.Generator
) -> dict[str, NDArray]:
    """Return readings `(T, ...)` with `object_pose` as the scene's tracker gives it; as they are without one.

    Where the tracker loses the object, `object_pose_valid` is there too, in every episode of a set.
    """
    tracker = None if noise is None else noise.tracker
    if tracker is None or "object_pose" not in readings:
        return dict(readings)
    pose, valid = tracked_pose(readings["object_pose"], tracker, rate_hz, rng)
    flags = {f"object_pose{VALID_SUFFIX}": valid} if tracker.dropout_share else {}
    return {**readings, "object_pose": pose, **flags}


def tracked_pose(
    pose: Array, tracker: Tracker, rate_hz: float, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Return poses as a log at `rate_hz` holds them, and the rows in which there is one.

    A reading is the pose of the row in which it was captured. It arrives `delay_s` later and is held until the next
    arrives. Before the first one arrives, the pose of row 0 is held: episodes begin at rest. Rows of a drop-out hold
    no pose (NaN).

    Parameters
    ----------
    pose : (T, 7) float64
        Poses [m, w x y z] in each row, with their noise.
    tracker : Tracker
    rate_hz : float
        Rows a second.
    rng : numpy.random.Generator
        Source of phase, drift and drop-outs.

    Returns
    -------
    pose : (T, 7) float64
    valid : (T,) bool
    """
    rows = _captured_rows(len(pose), tracker, rate_hz, rng)
    drifting_pose = _with_drift(pose, tracker, rate_hz, rng)
    valid = ~_lost(len(pose), tracker, rate_hz, rng)
    return np.where(valid[:, None], drifting_pose[rows], np.nan), valid


def _captured_rows(count: int, tracker: Tracker, rate_hz: float, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return in which row the reading was captured that each row holds, `(T,)`; the first capture comes at random.

    Captures are moved to the next row, so that a tracker without delay is never late.
    """
    period_rows = max(rate_hz / tracker.rate_hz, 1.0)
    phase = rng.uniform(0, period_rows)
    latest_rows = np.floor(np.arange(count) - tracker.delay_s * rate_hz)
    captures = np.floor((latest_rows - phase) / period_rows)
    return np.clip(np.ceil(phase + captures * period_rows), 0, None).astype(np.int64)


def _with_drift(pose: Array, tracker: Tracker, rate_hz: float, rng: np.random.Generator) -> Array:
    """Return the poses with a random walk added to positions and, in the world, to rotations."""
    walk = np.cumsum(rng.standard_normal((len(pose), 6)), axis=0) / np.sqrt(rate_hz)
    shift, turn = tracker.drift[0] * walk[:, :3], tracker.drift[1] * walk[:, 3:]
    return np.concatenate([pose[:, :3] + shift, multiply(exp(turn), pose[:, 3:])], axis=1)


def _lost(count: int, tracker: Tracker, rate_hz: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the rows of drop-outs `(T,)`: they begin and end by chance, independent of what came before."""
    mean_rows = max(tracker.dropout_s * rate_hz, 1.0)
    share = tracker.dropout_share
    chance_to_begin, chance_to_end = share / (1 - share) / mean_rows, 1 / mean_rows
    draws = rng.uniform(size=count)
    lost = np.zeros(count, bool)
    is_lost = draws[0] < share
    for row in range(count):
        if row:
            is_lost = draws[row] >= chance_to_end if is_lost else draws[row] < chance_to_begin
        lost[row] = is_lost
    return lost
