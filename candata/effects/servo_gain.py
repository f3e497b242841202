"""The servo is stiffer or softer than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _motor, _select
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale the whole position law kp (u - q - offset); the velocity gain stays (`servo_damping` is another)."""
    _motor.scale_stiffness(model, _select.servos(scene, element), x[0])


EFFECT = Effect(
    about="position gain of the servos is scaled",
    advice=Advice("Multiply the position gain of {servo} by {x}", "multiply kp of the <position> actuator by {raw}"),
    parameters=(
        Parameter(
            "kp_scale",
            "1",
            constant_bounds(0.1, 8.0),
            values(0.5, 0.75, 1.35, 2.0),
            spans((0.5, 0.8), (1.3, 2.0)),
            "drives of small hands vary by tens of per cent with supply voltage and temperature",
            always(1.0),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.servo_places,
    edit=_edit,
)
