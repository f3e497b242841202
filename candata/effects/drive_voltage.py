"""The supply of the servos is weaker than their torque limit takes for granted."""

from __future__ import annotations

import mujoco

from candata.effects import _motor, _select
from candata.effects._contract import Advice, Array, Effect, Parameter, constant_bounds, spans, values
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Limit the drive voltage: stall torque and no-load speed are `x` times those at which they are nominal."""
    _motor.set_stall_share(model, scene, _motor.saturating(scene, _select.servos(scene, element)), x[0])


EFFECT = Effect(
    about="drive voltage of the servos is limited: stall torque and no-load speed scale together",
    advice=Advice(
        "Give {servo} {x} times the supply at which the torque limit is the stall torque",
        "turn <position> into <dcmotor>, whose controller has Vmax",
    ),
    parameters=(
        Parameter(
            "voltage_scale",
            "1",
            constant_bounds(0.05, 2.0),
            values(0.15, 0.3, 0.55, 0.85, 1.2),
            spans((0.15, 0.35)),
            "supplies sag by tens of per cent; firmware limits the duty to a fraction",
            neutral=lambda scene: 2.0,
        ),
    ),
    acts_on="joint",
    possible=_motor.has_saturating,
    edit=_edit,
)
