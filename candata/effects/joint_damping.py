"""Viscous damping in the joints that the model lacks."""

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
    model.dof_damping[_select.dofs(scene, element)] += x[0]


EFFECT = Effect(
    about="viscous damping is added to the joints",
    advice=Advice("Add joint damping of {x} to {joint}", "add {raw} to damping of the <joint>"),
    parameters=(
        Parameter(
            "damping_Nms_rad",
            "N m s/rad",
            scaled_bounds(_select.drive_damping, 0.0, 15.0),
            scaled_probes(_select.drive_damping, 0.25, 0.7, 1.6, 3.5),
            scaled_spans(_select.drive_damping, (0.8, 3.0)),
            "grease and back-EMF, up to a few times the modelled damping",
            always(0.0),
            rails=_select.per_rail(_select.drive_damping),
        ),
    ),
    acts_on="joint",
    possible=_select.has_moving,
    elements=_select.moving_places,
    edit=_edit,
)
