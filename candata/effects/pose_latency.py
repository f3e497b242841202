"""The tracker reports the object's pose late."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
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
    sign = np.where((new[:, 3:] * old[:, 3:]).sum(1, keepdims=True) < 0, -1.0, 1.0)
    position = (1 - share) * new[:, :3] + share * old[:, :3]
    turn = normalise((1 - share) * new[:, 3:] + share * sign * old[:, 3:])
    # A world without latency keeps its bits whoever is simulated beside it.
    late = np.where((line.steps == 0)[:, None], pose, np.concatenate([position, turn], axis=1))
    return line._replace(past=track[:, 1:]), {**readings, "object_pose": late}


def _late(scene: Scene, x: Array) -> dict[str, float]:
    """Return by how many control steps poses are late."""
    return {"object_pose": float(x[0]) * scene.file.rate_hz}


EFFECT = Effect(
    about="the object's pose is reported late",
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
    late=_late,
)
