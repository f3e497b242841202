"""The object's centre of mass is not where the model has it."""

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
    """Move the centre of mass in the object's frame; scenes set `simple="false"` on the object for this."""
    model.body_ipos[scene.object_id] += x


EFFECT = Effect(
    about="centre of mass of the object is moved",
    advice=Advice("Move the object's centre of mass by {x}, in its own frame", "add {raw} to pos of its <inertial>"),
    parameters=(
        Parameter(
            "offset_m",
            "m",
            scaled_bounds(_select.object_size, -0.9, 0.9),
            scaled_probes(_select.object_size, -0.4, 0.4),
            scaled_spans(_select.object_size, (-0.6, -0.25), (0.25, 0.6)),
            "contents and batteries sit off centre, at most within the object",
            always(0.0),
            size=lambda scene: 3,
        ),
    ),
    acts_on="object",
    possible=_select.has_object,
    edit=_edit,
    set_const=True,
)
