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
    fixed,
    spans,
    values,
)
from candata.rotation import normalise
from candata.scenes.assemble import Scene

MAX_LATENCY_S = 0.25


class _Line(NamedTuple):
    """Past poses `(n, H, 7)` one a control step, latencies in control steps `(n,)`."""

    past: Array | None
    steps: Array
    history: int


def _start(scene: Scene, x: Array, elements: Elements) -> _Line:
    """Return an empty line."""
    rate = scene.file.rate_hz
    return _Line(None, x[:, 0] * rate, int(np.ceil(MAX_LATENCY_S * rate)) + 2)


def _apply(line: _Line, readings: dict[str, Array]) -> tuple[_Line, dict[str, Array]]:
    """Return the readings with the pose of `latency` ago, interpolated between control steps."""
    pose = readings["object_pose"]
    past = np.repeat(pose[:, None], line.history, axis=1) if line.past is None else line.past
    track = np.concatenate([past, pose[:, None]], axis=1)
    whole = np.floor(line.steps).astype(int)
    share = (line.steps - whole)[:, None]
    rows = np.arange(len(pose))
    new, old = track[rows, line.history - whole], track[rows, line.history - whole - 1]
    # A world without latency keeps its bits whoever is simulated beside it.
    late = np.where((line.steps == 0)[:, None], pose, _between(new, old, share))
    return line._replace(past=track[:, 1:]), {**readings, "object_pose": late}


def _between(one: Array, other: Array, share: Array | float) -> Array:
    """Return poses `(..., 7)` at a share of the way from one to the other."""
    sign = np.where((one[..., 3:] * other[..., 3:]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    position = (1 - share) * one[..., :3] + share * other[..., :3]
    turn = normalise((1 - share) * one[..., 3:] + share * sign * other[..., 3:])
    return np.concatenate([position, turn], axis=-1)


def _on_time(scene: Scene, x: Array, element: str | None, readings: Readings) -> Readings:
    """Return the readings `(E, T, D)` with poses as long before as they were late; NaN where they had not come yet."""
    steps = float(x[0]) * scene.file.rate_hz
    if "object_pose" not in readings or steps == 0:
        return readings
    pose, whole = readings["object_pose"], int(steps)
    ahead, rows = np.full_like(pose, np.nan), pose.shape[1] - whole - 1
    if rows > 0:
        ahead[:, :rows] = _between(pose[:, whole : whole + rows], pose[:, whole + 1 :], steps - whole)
    return {**readings, "object_pose": ahead}


EFFECT = Effect(
    about="the object's pose is reported late",
    advice=Advice("Correct the time stamps of the object tracker: its poses come {x} late"),
    parameters=(
        Parameter(
            "latency_s",
            "s",
            fixed(0.0, MAX_LATENCY_S),
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
