"""The tracker reports the object's position off by a constant."""

from __future__ import annotations

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
from candata.scenes.assemble import Scene


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the biases `(n, 3)` [m], world frame."""
    return x


def _apply(bias: Array, readings: Readings) -> tuple[Array, Readings]:
    """Return the readings with the bias added to the position."""
    return bias, {**readings, "object_pose": _shifted_readings(readings["object_pose"], bias)}


def _shifted_readings(pose: Array, shift: Array) -> Array:
    """Return poses `(..., 7)` moved by `shift (..., 3)`."""
    return np.concatenate([pose[..., :3] + shift, pose[..., 3:]], axis=-1)


def _true_readings(scene: Scene, x: Array, element: str | None, readings: Readings) -> Readings:
    """Return the readings with the bias taken off."""
    return (
        {**readings, "object_pose": _shifted_readings(readings["object_pose"], -x)}
        if "object_pose" in readings
        else readings
    )


EFFECT = Effect(
    about="a constant is added to the object's reported position, world frame",
    advice=Advice("Correct the object tracker: its positions are off by {x} along world x, y, z"),
    traits=frozenset({"tracked_length"}),
    parameters=(
        Parameter(
            "bias_m",
            "m",
            constant_bounds(-0.1, 0.1),
            values(-0.008, 0.008),
            spans((-0.015, -0.004), (0.004, 0.015)),
            "hand-eye calibration of a camera: some millimetres",
            always(0.0),
            size=lambda scene: 3,
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    reading=Hook(_start, _apply),
    moves=("object_pose",),
    unread=_true_readings,
)
