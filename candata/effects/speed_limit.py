"""Firmware moves the set point of the servos no faster than a limit."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from candata.effects import _motor, _select
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
    scaled_bounds,
    scaled_probes,
    scaled_spans,
)
from candata.errors import SceneError
from candata.scenes.assemble import Scene
from candata.scenes.motors import SLEW


class _SetPoint(NamedTuple):
    """Set points `(n, A)` after the last step, and the farthest that they move in a step `(n, A)`."""

    last: Array | None
    reach: Array


def _start(scene: Scene, x: Array, elements: Elements) -> _SetPoint:
    """Return set points that may move without limit, but those of the servos named by x a second."""
    reach = np.full((len(x), len(scene.actuator_ids)), np.inf)
    ids = scene.actuator_ids.tolist()
    for row, element in enumerate(elements):
        for a in _select.actuators(scene, element).tolist() if np.isfinite(x[row, 0]) else ():
            speed = x[row, 0] * _select.command_per_rad(scene, a)
            reach[row, ids.index(a)] = speed * scene.model.opt.timestep
    return _SetPoint(None, reach)


def _apply(point: _SetPoint, u: Array) -> tuple[_SetPoint, Array]:
    """Return the set points `(n, S, A)`, each within reach of the one before; the first command begins at rest.

    Source: MuJoCo XML reference, "dcmotor/controller", slewmax.
    """
    last = u[:, 0] if point.last is None else point.last
    out = np.empty_like(u)
    for step in range(u.shape[1]):
        last = np.clip(u[:, step], last - point.reach, last + point.reach)
        out[:, step] = last
    return point._replace(last=last), out


def _native(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Turn the servos into DC motors with a limit of the set point's speed.

    Raises
    ------
    SceneError
        When one of them cannot be a DC motor.
    """
    ids = _select.actuators(scene, element)
    if len(_motor.convertible(scene, ids)) < len(ids):
        raise SceneError(
            "a limit of the set point's speed is part of DC motors alone",
            expected="position servos without activation",
            found=", ".join(scene.model.actuator(a).name for a in np.setdiff1d(ids, _motor.convertible(scene, ids))),
            fix="limit the commands in the code that sends them",
        )
    _motor.convert(model, ids)
    model.actuator_dynprm[ids, SLEW] = [x[0] * _select.command_per_rad(scene, a) for a in ids.tolist()]


EFFECT = Effect(
    about="set points of the servos move no faster than a limit",
    advice=Advice(
        "Let the set point of {servo} move by at most {x}",
        "turn <position> into <dcmotor> with slewmax {raw}, and begin with `act` at the first command",
    ),
    parameters=(
        Parameter(
            "speed_rad_s",
            "rad/s",
            scaled_bounds(_select.drive_reach, 0.05, 20.0),
            scaled_probes(_select.drive_reach, 0.2, 0.5, 1.4, 4.0),
            scaled_spans(_select.drive_reach, (0.25, 0.8)),
            "speed profiles of servo firmware; usual commands of hands move by 0.5 to 5 rad/s",
            neutral=lambda scene: 20.0 * _select.drive_reach(scene),
            rails=_select.per_rail(_select.drive_reach),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.motor_places,
    command=Hook(_start, _apply),
    native=_native,
)
