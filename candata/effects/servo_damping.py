"""The servo damps more or less than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _motor, _select
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene
from candata.scenes.motors import affine_law


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale the velocity gain; the position gain stays (`servo_gain` is another effect)."""
    _motor.scale_damping(model, _select.servos(scene, element), x[0])


def _has_damping(scene: Scene) -> bool:
    """Tell whether a servo has a velocity gain that could be scaled."""
    _, bias = affine_law(scene.model, _select.servos(scene, None))
    return bool(bias[:, 2].any())


EFFECT = Effect(
    about="velocity gain of the servos is scaled",
    advice=Advice("Multiply the velocity gain of {servo} by {x}", "multiply kv of the <position> actuator by {raw}"),
    parameters=(
        Parameter(
            "kv_scale",
            "1",
            constant_bounds(0.05, 8.0),
            values(0.2, 0.5, 2.0, 4.0),
            spans((0.2, 0.6), (1.6, 3.0)),
            "makers state stiffness more often than damping; public models of one hand differ severalfold",
            always(1.0),
        ),
    ),
    acts_on="joint",
    possible=_has_damping,
    elements=_select.servo_places,
    edit=_edit,
)
