"""The servo does not drive while its position error is small."""

from __future__ import annotations

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


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the bands `(n, A)` in units of the commands."""
    return _servo.in_commands(scene, x[:, 0], elements)


def _apply(band: Array, servos: Servos) -> tuple[Array, Servos]:
    """Return the commands, those within a band of no error as no error; the damping of the servo stays."""
    is_small = np.abs(servos.command - servos.idle) < band
    return band, servos._replace(command=np.where(is_small, servos.idle, servos.command))


EFFECT = Effect(
    about="servos do not drive at small position errors",
    advice=Advice("Let {servo} give no drive at position errors below {x}"),
    parameters=(
        Parameter(
            "band_rad",
            "rad",
            scaled_bounds(_select.drive_reach, 0.0, 0.1),
            scaled_probes(_select.drive_reach, 0.01, 0.02, 0.05),
            scaled_spans(_select.drive_reach, (0.015, 0.05)),
            "bus servos set it in steps of their encoders of 1.5 to 5 mrad, from none to ten or more",
            always(0.0),
            rails=_select.per_rail(_select.drive_reach),
        ),
    ),
    acts_on="joint",
    possible=_servo.has_law,
    elements=_select.motor_places,
    servo=Hook(_start, _apply),
)
