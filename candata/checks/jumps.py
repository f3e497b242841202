"""Rule: positions go on from row to row: nothing jumps, as it does where rows were lost and stamps made even."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: A step is a jump when it is so many times the steps on both sides of it, and so many times the noise.
TIMES, NOISES = 3.0, 8.0
#: Rows on both sides that are compared.
SIDE_ROWS = 3
#: Smallest jump of a joint [rad, m, 1] and of an object [m].
JOINT, OBJECT_M = 0.02, 0.004
#: Joints and poses that must jump in one row for rows to be lost there, and their share of all that moves.
FEWEST_STREAMS, STREAM_SHARE = 2, 0.5
#: A stream jumps alone by so many times the usual largest step (its 98 % quantile).
RARE = 4.0
REMEDY = "look for what the recorder dropped; cut the episode there"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield rows in which the streams that move jump all at once, and streams that jump alone."""
    if view.time_s is None or len(view.time_s) < 4 * SIDE_ROWS:
        return
    series = _series(view)
    if not series:
        return
    steps = {name: _steps(values) for name, (_, values, _) in series.items()}
    is_late = np.r_[False, np.diff(view.time_s) > 1.5 / view.rate_hz]  # a long step of time says by itself what is lost
    high = np.stack([_higher(step, side_step) for step, side_step in steps.values()]) & ~is_late
    is_moving = np.stack([np.r_[False, side_step > 3 * _grain(step)] for step, side_step in steps.values()])
    is_lost = ((high & is_moving).sum(axis=0) >= FEWEST_STREAMS) & (
        (high & is_moving).sum(axis=0) >= STREAM_SHARE * is_moving.sum(axis=0)
    )
    if is_lost.any():
        names = [n for n, at in zip(series, high, strict=True) if (at & is_lost).any()]
        text = f"{', '.join(names[:4])}{' and others' * (len(names) > 4)} at once, {is_lost.sum()} times"
        yield view.finding(
            "warning",
            "jumps",
            "all that moves jumps in one row: rows are lost there",
            text,
            None,
            is_lost,
            REMEDY,
            jumps=int(is_lost.sum()),
            streams=len(names),
        )
    for (name, (channel, _, least_jump)), (step, _), at in zip(series.items(), steps.values(), high, strict=True):
        usual_step = float(np.quantile(step[step > 0], 0.98)) if (step > 0).any() else 0.0
        jumps_alone = at & ~is_lost & np.r_[False, step > max(least_jump, RARE * usual_step)]
        if jumps_alone.any():
            largest_jump = float(step[jumps_alone[1:]].max())
            text = f"{name} by up to {largest_jump:.3g} in a row, {jumps_alone.sum()} times"
            yield view.finding(
                "info",
                "jumps",
                "a position jumps",
                text,
                channel,
                jumps_alone,
                "tracking noise, or a sensor that slips: mark these rows invalid",
                element=name,
                jumps=int(jumps_alone.sum()),
                largest=largest_jump,
            )


def _series(view: EpisodeView) -> dict[str, tuple[str, Array, float]]:
    """Return what must not jump: name to channel, `(T, N)` values and the smallest jump that is told."""
    out = {}
    joint = view.values("joint_position")
    if joint is not None:
        for k, name in enumerate(view.elements("joint_position")):
            out[f"joint {name}"] = ("joint_position", joint[:, k : k + 1], JOINT)
    for channel in ("object_pose", "hand_pose"):
        pose = view.complete_values(channel)
        if pose is not None:
            out[channel] = (channel, pose[:, :3], OBJECT_M)
    return out


def _steps(values: Array) -> tuple[Array, Array]:
    """Return `(T - 1,)` the size of each step, and the largest of those beside it."""
    step = np.nan_to_num(np.linalg.norm(np.diff(values, axis=0), axis=1))
    padded_steps = np.r_[np.zeros(SIDE_ROWS), step, np.zeros(SIDE_ROWS)]
    windows = np.lib.stride_tricks.sliding_window_view(padded_steps, 2 * SIDE_ROWS + 1)
    return step, np.delete(windows, SIDE_ROWS, axis=1).max(axis=1)


def _grain(step: Array) -> float:
    """Return the size of steps that are noise or rounding: the smaller of what a still stream makes."""
    return float(np.quantile(step, 0.3)) if len(step) else 0.0


def _higher(step: Array, side_step: Array) -> Mask:
    """Return `(T,) bool`: rows into which a step leads that is far larger than those beside it and than noise."""
    at = (step > TIMES * side_step) & (step > NOISES * _grain(step))
    at[:1] = at[-1:] = False  # the first and the last step have no step on one side
    return np.r_[False, at]


RULE = Rule(meaning="positions do not jump", episode=_episode)
