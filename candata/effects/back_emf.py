"""Motors have less torque the faster they turn, as they generate a voltage against their supply.

Within that limit the servo gives the torque that its law asks for: a motor whose voltage is not limited differs from a
position servo in its damping alone, which `servo_damping` is.
"""

from __future__ import annotations

import mujoco

from candata.effects import _motor, _select
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
    """Let the torque limit fall by x N m for each rad/s; zero leaves the servos as they are."""
    if x[0]:
        _motor.set_slope(model, scene, _motor.saturating(scene, _select.actuators(scene, element)), x[0])


EFFECT = Effect(
    about="torque limit of the servos falls with speed: back-EMF of their motors",
    advice=Advice(
        "Let the torque limit of {servo} fall by {x} with speed",
        "turn <position> into <dcmotor>: K^2 / R is {raw}, K Vmax / R the torque limit",
    ),
    parameters=(
        Parameter(
            "emf_Nms_rad",
            "N m s/rad",
            scaled_bounds(_motor.stall_slope, 0.0, 8.0),
            scaled_probes(_motor.stall_slope, 0.7, 1.8, 5.0),
            scaled_spans(_motor.stall_slope, (1.5, 5.0)),
            "data sheets of geared servos: stall torque over no-load speed",
            always(0.0),
            rails=_select.per_rail(_motor.stall_slope),
        ),
    ),
    acts_on="joint",
    possible=_motor.has_saturating,
    edit=_edit,
)
