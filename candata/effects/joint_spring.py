"""A torsion spring in the joints that the model lacks: a return spring, a cable, a stiff glove."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Parameter,
    always,
    scaled_bounds,
    scaled_probes,
    scaled_spans,
)
from candata.scenes.assemble import Scene

#: Farthest rest angle [rad, or m]: a torque without stiffness is a spring wound this far. Chosen: over the turn of a
#: joint its torque changes by a thousandth.
WOUND = 1000.0


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Add a spring to what the model has: torque - stiffness q, in the words of MuJoCo stiffness (rest - q)."""
    stiffness, torque = x
    joints = scene.joint_ids[_select.moving_indices(scene, element)]
    rest = model.jnt_qposadr[joints]
    total_torque = model.jnt_stiffness[joints] * model.qpos_spring[rest] + torque
    total = model.jnt_stiffness[joints] + stiffness
    total = np.maximum(total, np.abs(total_torque) / WOUND)
    has_spring = total > 0
    model.jnt_stiffness[joints] = total
    model.qpos_spring[rest[has_spring]] = (total_torque / np.where(has_spring, total, 1.0))[has_spring]


EFFECT = Effect(
    about="a torsion spring is added to the joints",
    advice=Advice(
        "Add a spring to {joint}, with stiffness and torque at the joint's zero of {x}",
        "add the first of {raw} to stiffness of the <joint>; springref is the second over the first",
    ),
    parameters=(
        Parameter(
            "stiffness_Nm_rad",
            "N m/rad",
            scaled_bounds(_select.drive_spring, 0.0, 1.0),
            scaled_probes(_select.drive_spring, 0.2),
            scaled_spans(_select.drive_spring, (0.12, 0.4)),
            "a return spring or a cable must leave the motor most of its torque over a radian",
            always(0.0),
            rails=_select.per_rail(_select.drive_spring),
        ),
        Parameter(
            "torque_Nm",
            "N m",
            scaled_bounds(_select.drive_torque, -0.6, 0.6),
            scaled_probes(_select.drive_torque, -0.1, 0.1),
            scaled_spans(_select.drive_torque, (-0.2, -0.06), (0.06, 0.2)),
            "what the spring pulls with at the joint's zero: its stiffness times its rest angle",
            always(0.0),
            rails=_select.per_rail(_select.drive_torque),
        ),
    ),
    acts_on="joint",
    possible=_select.has_moving,
    elements=_select.moving_places,
    edit=_edit,
)
