"""Encoders read an angle that is off by a constant, and the servos trust them."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _select
from candata.effects._contract import Array, Effect, Elements, Hook, Parameter, Readings, always, fixed, spans, values
from candata.scenes.assemble import Scene


def _of_joints(scene: Scene, x: Array, element: str | None) -> Array:
    """Return the offsets `(J,)` [rad]: zero where there is no driven hinge, or another one is named."""
    out, chosen = np.zeros(len(scene.file.joints)), _select.joints(scene, element)
    out[chosen] = x[np.isin(scene.driven_hinges, chosen)]
    return out


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Let the servo's law kp (u - length) see the readings: of each joint it pulls, lever times offset more."""
    offsets = dict(zip(scene.joint_ids.tolist(), _of_joints(scene, x, element), strict=True))
    for a in _select.actuators(scene, element):
        longer = sum(lever * offsets[joint] for joint, lever in scene.levers[int(a)].items() if joint in offsets)
        model.actuator_biasprm[a, 0] += model.actuator_biasprm[a, 1] * longer


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the offsets `(n, J)` [rad]."""
    rows = [_of_joints(scene, row, element) for row, element in zip(x, elements, strict=True)]
    return np.stack(rows)


def _apply(offsets: Array, readings: Readings) -> tuple[Array, Readings]:
    """Return the readings with the offsets added."""
    return offsets, {**readings, "joint_position": readings["joint_position"] + offsets}


def _unread(scene: Scene, x: Array, element: str | None, readings: Readings) -> Readings:
    """Return the readings with the offsets taken off."""
    if "joint_position" not in readings:
        return readings
    return {**readings, "joint_position": readings["joint_position"] - _of_joints(scene, x, element)}


EFFECT = Effect(
    about="encoders read true angle plus a constant, which the servos follow",
    parameters=(
        Parameter(
            "offset_rad",
            "rad",
            fixed(-0.3, 0.3),
            values(0.03),
            spans((-0.09, -0.03), (0.03, 0.09)),
            "a joint zeroed by eye or against a soft stop is off by 1 to 5 degrees",
            always(0.0),
            size=lambda scene: len(scene.driven_hinges),
            owners=_select.joint_names,
        ),
    ),
    acts_on="joint",
    possible=_select.has_driven_hinges,
    elements=_select.joint_places,
    edit=_edit,
    reading=Hook(_start, _apply),
    moves=("joint_position", "object_pose", "fingertip_force"),
    unread=_unread,
)
