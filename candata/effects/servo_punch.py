"""The servo drives harder at small position errors than its gain says: a least drive, or punch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.effects import _select, _servo
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
    Servos,
    always,
    scaled_bounds,
    scaled_probes,
    scaled_spans,
)
from candata.scenes.assemble import Scene

#: Error at which the punch is whole [rad; on rails this share of what a radian is]. Source: a step of an encoder of
#: 4096 steps a turn, below which a servo sees no error.
WHOLE_RAD = 2 * np.pi / 4096


class _Punch(NamedTuple):
    """Errors `(n, A)` in units of the commands: what the punch adds, and where it is whole (1 where none acts)."""

    added: Array
    whole: Array


def _start(scene: Scene, x: Array, elements: Elements) -> _Punch:
    """Return the punches of n simulations."""
    reach = np.array([WHOLE_RAD * _select.drive_reach(scene, element) for element in elements])
    whole = _servo.in_commands(scene, reach, elements)
    return _Punch(_servo.in_commands(scene, x[:, 0], elements), np.where(whole > 0, whole, 1.0))


def _apply(punch: _Punch, servos: Servos) -> tuple[_Punch, Servos]:
    """Return the commands that make the drive kp (e + p) of kp e, towards the target: the gain is kp (1 + p / |e|)."""
    share = np.clip(np.nan_to_num(servos.command - servos.idle) / punch.whole, -1, 1)
    return punch, servos._replace(command=servos.command + punch.added * share)


EFFECT = Effect(
    about="servos drive harder at small position errors than their gain says",
    advice=Advice("Let {servo} drive as if position errors were {x} larger: a least drive, or punch"),
    parameters=(
        Parameter(
            "punch_rad",
            "rad",
            scaled_bounds(_select.drive_reach, 0.0, 0.02),
            scaled_probes(_select.drive_reach, 0.004, 0.01),
            scaled_spans(_select.drive_reach, (0.006, 0.015)),
            "a bus servo on an oscilloscope: duty per rad 0.26 at 3 mrad, 0.17 at 50 mrad, that is 1.7 mrad",
            always(0.0),
            rails=_select.per_rail(_select.drive_reach),
        ),
    ),
    acts_on="joint",
    possible=_servo.has_law,
    elements=_select.motor_places,
    servo=Hook(_start, _apply),
)
