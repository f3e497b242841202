"""The object is heavier or lighter than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _select
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale mass and inertia together: another density."""
    model.body_mass[scene.object_id] *= x[0]
    model.body_inertia[scene.object_id] *= x[0]


EFFECT = Effect(
    about="mass and inertia of the object are scaled",
    advice=Advice(
        "Multiply the object's mass and inertia by {x}",
        "multiply mass or density of its <geom>s, or mass and diaginertia of its <inertial>",
    ),
    parameters=(
        Parameter(
            "mass_scale",
            "1",
            constant_bounds(0.2, 5.0),
            values(0.5, 0.75, 1.35, 2.0),
            spans((0.5, 0.75), (1.3, 2.0)),
            "fill level, batteries, a label's weight against a scale's",
            always(1.0),
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
    set_const=True,
)
