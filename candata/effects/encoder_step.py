"""Encoders read whole steps: joint positions are rounded."""

from __future__ import annotations

import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
    Readings,
    scaled_bounds,
    scaled_probes,
    scaled_spans,
)
from candata.scenes.assemble import Scene

#: Finest and coarsest step that is searched [rad]: 1/10 of that of 4096 steps a turn (1.53 mrad), and a potentiometer
#: read with 8 bits.
FINEST_RAD, COARSEST_RAD = 1e-4, 0.02


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the steps `(n, J)` [rad, or m]; zero where nothing is rounded."""
    steps = np.zeros((len(x), len(scene.file.joints)))
    for row, element in enumerate(elements):
        steps[row, _select.joints(scene, element)] = np.nan_to_num(x[row, 0])
    return steps


def _apply(steps: Array, readings: Readings) -> tuple[Array, Readings]:
    """Return the readings, joint positions as the nearest whole number of steps."""
    position = readings["joint_position"]
    rounded = steps * np.round(position / np.where(steps > 0, steps, 1.0))
    return steps, {**readings, "joint_position": np.where(steps > 0, rounded, position)}


EFFECT = Effect(
    about="encoders read whole steps",
    advice=Advice("Round the readings of {joint} to steps of {x}"),
    traits=frozenset({"reading_noise"}),
    parameters=(
        Parameter(
            "step_rad",
            "rad",
            scaled_bounds(_select.drive_reach, FINEST_RAD, COARSEST_RAD),
            scaled_probes(_select.drive_reach, 0.005, 0.012),
            scaled_spans(_select.drive_reach, (0.008, 0.018)),
            "4096 steps a turn are 1.53 mrad; cheap encoders and converters of 10 bits have 6 mrad",
            neutral=lambda scene: FINEST_RAD * _select.drive_reach(scene),
            rails=_select.per_rail(_select.drive_reach),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.joint_places,
    reading=Hook(_start, _apply),
    moves=("joint_position",),
)
