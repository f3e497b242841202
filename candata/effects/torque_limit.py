"""The motors saturate earlier or later than modelled."""

from __future__ import annotations

import mujoco

from candata.effects import _select
from candata.effects._contract import Advice, Array, Bounds, Effect, Parameter, scaled_probes, scaled_spans
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Replace the force range by +- x."""
    ids = _select.actuators(scene, element)
    model.actuator_forcelimited[ids] = True
    model.actuator_forcerange[ids] = (-x[0], x[0])


def _bounds(scene: Scene) -> Bounds:
    """Return limits from a fiftieth of the median motor's to twice that, or to the strongest motor's own."""
    usual_limit = _select.drive_torque(scene)
    return Bounds(0.02 * usual_limit, max(2.0 * usual_limit, _select.largest_drive_torque(scene)))


EFFECT = Effect(
    about="torque limit of the servos is replaced",
    advice=Advice("Limit the torque of {servo} to {x}", 'forcerange="-{raw} {raw}" of the actuator'),
    traits=frozenset({"one_for_all"}),
    parameters=(
        Parameter(
            "limit_Nm",
            "N m",
            _bounds,
            scaled_probes(_select.drive_torque, 0.08, 0.14, 0.22, 0.35, 0.55),
            scaled_spans(_select.drive_torque, (0.12, 0.3)),
            "data sheets state stall torque; current limits cut it to a fraction",
            neutral=_select.largest_drive_torque,
            rails=_select.per_rail(_select.drive_torque),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.motor_places,
    edit=_edit,
)
