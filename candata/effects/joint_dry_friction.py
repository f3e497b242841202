"""Dry friction in the joints that the model lacks."""

from __future__ import annotations

import mujoco

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


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Add to what the model has."""
    model.dof_frictionloss[_select.dofs(scene, element)] += x[0]


EFFECT = Effect(
    about="dry friction is added to the joints",
    advice=Advice("Add joint dry friction of {x} to {joint}", "add {raw} to frictionloss of the <joint>"),
    parameters=(
        Parameter(
            "frictionloss_Nm",
            "N m",
            scaled_bounds(_select.drive_torque, 0.0, 0.6),
            scaled_probes(_select.drive_torque, 0.01, 0.03, 0.08, 0.18),
            scaled_spans(_select.drive_torque, (0.04, 0.15)),
            "geared servos lose 2 to 20 % of their torque to dry friction",
            always(0.0),
            rails=_select.per_rail(_select.drive_torque),
        ),
    ),
    acts_on="joint",
    possible=_select.has_moving,
    elements=_select.moving_places,
    edit=_edit,
)
