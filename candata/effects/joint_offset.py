"""Encoders read an angle that is off by a constant, and the servos trust them."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _motor, _select
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
    Readings,
    always,
    scaled_bounds,
    scaled_probes,
    scaled_spans,
)
from candata.scenes.assemble import Scene


def _of_joints(scene: Scene, x: Array, element: str | None) -> Array:
    """Return the offsets `(J,)` [rad, or m]: zero where no finger is driven, or another joint is named."""
    out, indices = np.zeros(len(scene.file.joints)), _select.joints(scene, element)
    out[indices] = x[np.isin(_select.finger_joints(scene), indices)]
    return out


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Let the servo's law kp (u - length) see the readings: of each joint it pulls, lever times offset more."""
    offsets = dict(zip(scene.joint_ids.tolist(), _of_joints(scene, x, element), strict=True))
    for a in _select.actuators(scene, element):
        length_change = sum(lever * offsets[joint] for joint, lever in scene.levers[int(a)].items() if joint in offsets)
        _motor.shift_length(model, int(a), length_change)


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the offsets `(n, J)` [rad, or m]."""
    rows = [_of_joints(scene, row, element) for row, element in zip(x, elements, strict=True)]
    return np.stack(rows)


def _apply(offsets: Array, readings: Readings) -> tuple[Array, Readings]:
    """Return the readings with the offsets added."""
    return offsets, {**readings, "joint_position": readings["joint_position"] + offsets}


def _true_readings(scene: Scene, x: Array, element: str | None, readings: Readings) -> Readings:
    """Return the readings with the offsets taken off."""
    if "joint_position" not in readings:
        return readings
    return {**readings, "joint_position": readings["joint_position"] - _of_joints(scene, x, element)}


EFFECT = Effect(
    about="encoders read true angle plus a constant, which the servos follow",
    advice=Advice("Correct the encoders of {joint}: they read {x} too much"),
    parameters=(
        Parameter(
            "offset_rad",
            "rad",
            scaled_bounds(_select.drive_reach, -0.3, 0.3),
            scaled_probes(_select.drive_reach, 0.03),
            scaled_spans(_select.drive_reach, (-0.09, -0.03), (0.03, 0.09)),
            "a joint zeroed by eye or against a soft stop is off by 1 to 5 degrees",
            always(0.0),
            size=lambda scene: len(_select.finger_joints(scene)),
            owners=lambda scene: tuple(scene.file.joints[i] for i in _select.finger_joints(scene)),
            whole=lambda scene: tuple(scene.file.joints[i] for i in _select.fingers(scene)),
            rails=_select.per_rail(_select.drive_reach),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.joint_places,
    edit=_edit,
    reading=Hook(_start, _apply),
    moves=("joint_position", "object_pose", "fingertip_force"),
    unread=_true_readings,
)
