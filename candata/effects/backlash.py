"""Gears have play: the joint follows its command only once the gap is closed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Advice,
    Array,
    Effect,
    Elements,
    Hook,
    Parameter,
    always,
    scaled_bounds,
    scaled_probes,
    scaled_spans,
)
from candata.scenes.assemble import Scene


class _Gears(NamedTuple):
    """What the output side stands at `(n, A)` after the last step, half gaps `(n, A)`."""

    output: Array | None
    half_gap: Array


def _start(scene: Scene, x: Array, elements: Elements) -> _Gears:
    """Return gears in the middle of their gap, in units of the command; what drives no hinge has none."""
    half_gap = np.zeros((len(x), len(scene.actuator_ids)))
    ids = scene.actuator_ids.tolist()
    for row, element in enumerate(elements):
        for a in _select.actuators(scene, element).tolist():
            half_gap[row, ids.index(a)] = x[row, 0] / 2 * _select.command_per_rad(scene, a)
    return _Gears(None, half_gap)


def _apply(gears: _Gears, u: Array) -> tuple[_Gears, Array]:
    """Return commands `(n, S, A)` of the output side: within half a gap of what is asked, at rest in between.

    Source: the play operator (Visintin 1994, "Differential models of hysteresis", section III.2).
    """
    output = u[:, 0] if gears.output is None else gears.output
    out = np.empty_like(u)
    for step in range(u.shape[1]):
        output = np.clip(output, u[:, step] - gears.half_gap, u[:, step] + gears.half_gap)
        out[:, step] = output
    return gears._replace(output=output), out


EFFECT = Effect(
    about="gears have play, a dead zone of the command",
    advice=Advice("Give the gears of {joint} a play of {x}"),
    parameters=(
        Parameter(
            "gap_rad",
            "rad",
            scaled_bounds(_select.drive_reach, 0.0, 0.3),
            scaled_probes(_select.drive_reach, 0.01, 0.03, 0.08, 0.16),
            scaled_spans(_select.drive_reach, (0.03, 0.12)),
            "small gear trains and tendons: 0.5 to 5 degrees at the joint",
            always(0.0),
            rails=_select.per_rail(_select.drive_reach),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.motor_places,
    command=Hook(_start, _apply),
)
