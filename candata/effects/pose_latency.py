"""The tracker reports the object's pose late."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
    Readings,
    always,
    constant_bounds,
    spans,
    values,
)
from candata.rotation import normalise
from candata.scenes.assemble import Scene

MAX_LATENCY_S = 0.25


class _PoseHistory(NamedTuple):
    """Past poses `(n, H, 7)` one a control step, latencies in control steps `(n,)`."""

    poses: Array | None
    steps: Array
    history: int


def _start(scene: Scene, x: Array, elements: Elements) -> _PoseHistory:
    """Return an empty line."""
    rate = scene.file.rate_hz
    return _PoseHistory(None, x[:, 0] * rate, int(np.ceil(MAX_LATENCY_S * rate)) + 2)


def _apply(line: _PoseHistory, readings: dict[str, Array]) -> tuple[_PoseHistory, dict[str, Array]]:
    """Return the readings with the pose of `latency` ago, interpolated between control steps."""
    pose = readings["object_pose"]
    earlier_poses = np.repeat(pose[:, None], line.history, axis=1) if line.poses is None else line.poses
    track = np.concatenate([earlier_poses, pose[:, None]], axis=1)
    whole_rows = np.floor(line.steps).astype(int)
    share = (line.steps - whole_rows)[:, None]
    rows = np.arange(len(pose))
    later_pose, earlier_pose = track[rows, line.history - whole_rows], track[rows, line.history - whole_rows - 1]
    # A world without latency keeps its bits whoever is simulated beside it.
    delayed_pose = np.where((line.steps == 0)[:, None], pose, _interpolate(later_pose, earlier_pose, share))
    return line._replace(poses=track[:, 1:]), {**readings, "object_pose": delayed_pose}


def _interpolate(earlier: Array, later: Array, share: Array | float) -> Array:
    """Return poses `(..., 7)` at a share of the way from one to the other."""
    sign = np.where((earlier[..., 3:] * later[..., 3:]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    position = (1 - share) * earlier[..., :3] + share * later[..., :3]
    turn = normalise((1 - share) * earlier[..., 3:] + share * sign * later[..., 3:])
    return np.concatenate([position, turn], axis=-1)


def _on_time(scene: Scene, x: Array, element: str | None, readings: Readings) -> Readings:
    """Return the readings `(E, T, D)` with poses as long before as they were late; NaN where they had not come yet."""
    steps = float(x[0]) * scene.file.rate_hz
    if "object_pose" not in readings or steps == 0:
        return readings
    pose, whole_rows = readings["object_pose"], int(steps)
    timely_poses, rows = np.full_like(pose, np.nan), pose.shape[1] - whole_rows - 1
    if rows > 0:
        timely_poses[:, :rows] = _interpolate(
            pose[:, whole_rows : whole_rows + rows], pose[:, whole_rows + 1 :], steps - whole_rows
        )
    return {**readings, "object_pose": timely_poses}


EFFECT = Effect(
    about="the object's pose is reported late",
    advice=Advice("Correct the time stamps of the object tracker: its poses come {x} late"),
    parameters=(
        Parameter(
            "latency_s",
            "s",
            constant_bounds(0.0, MAX_LATENCY_S),
            values(0.012, 0.03, 0.06, 0.12),
            spans((0.03, 0.1)),
            "camera exposure, pose estimation and network: 20 to 100 ms",
            always(0.0),
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    reading=Hook(_start, _apply),
    moves=("object_pose",),
    on_time=_on_time,
)
