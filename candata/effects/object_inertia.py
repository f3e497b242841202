"""The object's mass lies closer to its centre, or farther, than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _select
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale the inertia; the mass stays (`object_mass` scales both)."""
    model.body_inertia[scene.object_id] *= x[0]


EFFECT = Effect(
    about="inertia of the object is scaled, its mass stays",
    advice=Advice("Multiply the object's inertia by {x}, its mass unchanged", "multiply diaginertia of its <inertial>"),
    parameters=(
        Parameter(
            "inertia_scale",
            "1",
            constant_bounds(0.15, 6.0),
            values(0.4, 0.7, 1.5, 2.5),
            spans((0.25, 0.55), (1.8, 3.5)),
            "a hollow body has 5/3 of a solid one's inertia, a weight in the middle a fraction of it",
            always(1.0),
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
    set_const=True,
)
