"""Reflected rotor inertia in the joints that the model lacks."""

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
    model.dof_armature[_select.dofs(scene, element)] += x[0]


EFFECT = Effect(
    about="reflected rotor inertia is added to the joints",
    advice=Advice("Add rotor inertia of {x} to {joint}", "add {raw} to armature of the <joint>"),
    parameters=(
        Parameter(
            "armature_kgm2",
            "kg m^2",
            scaled_bounds(_select.drive_inertia, 0.0, 60.0),
            scaled_probes(_select.drive_inertia, 0.7, 2.0, 5.0, 12.0),
            scaled_spans(_select.drive_inertia, (3.0, 12.0)),
            "rotor inertia times gear ratio squared, often left out of models",
            always(0.0),
            rails=_select.per_rail(_select.drive_inertia),
        ),
    ),
    acts_on="joint",
    possible=_select.has_moving,
    elements=_select.moving_places,
    edit=_edit,
    set_const=True,
)
