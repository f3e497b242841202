"""The tracker reports the object's rotation off by a constant turn."""

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
from candata.rotation import exp, multiply
from candata.scenes.assemble import Scene


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the biases `(n, 3)` [rad], rotation vectors in the world frame."""
    return x


def _apply(bias: Array, readings: Readings) -> tuple[Array, Readings]:
    """Return the readings with the rotation turned by the bias."""
    return bias, {**readings, "object_pose": _turned_readings(readings["object_pose"], bias)}


def _turned_readings(pose: Array, turn: Array) -> Array:
    """Return poses `(..., 7)` turned about their own place by `turn (..., 3)`, as they are where it is zero."""
    turned_pose = np.concatenate([pose[..., :3], multiply(exp(turn), pose[..., 3:])], axis=-1)
    return np.where((turn == 0).all(-1, keepdims=True), pose, turned_pose)


def _true_readings(scene: Scene, x: Array, element: str | None, readings: Readings) -> Readings:
    """Return the readings with the bias taken off."""
    return (
        {**readings, "object_pose": _turned_readings(readings["object_pose"], -x)}
        if "object_pose" in readings
        else readings
    )


EFFECT = Effect(
    about="the object's reported rotation is turned by a constant, world frame",
    advice=Advice("Correct the object tracker: its rotations are turned by {x} about world x, y, z"),
    parameters=(
        Parameter(
            "bias_rad",
            "rad",
            constant_bounds(-0.5, 0.5),
            values(-0.06, 0.06),
            spans((-0.12, -0.05), (0.05, 0.12)),
            "camera extrinsics and a model's frame drawn by eye: one to some degrees",
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
