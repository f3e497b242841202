"""The fingertips' readings follow the forces slowly."""

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
    Readings,
    always,
    fixed,
    spans,
    values,
)
from candata.scenes.assemble import Scene


class _Slow(NamedTuple):
    """The last reading `(n, F, 3)`, and the share of the way to the force that a row goes `(n, F, 1)`."""

    last: Array | None
    share: Array


def _start(scene: Scene, x: Array, elements: Elements) -> _Slow:
    """Return sensors at rest: a first-order lag sampled at the control rate goes 1 - exp(-dt / tau) a row."""
    share = np.ones((len(x), len(scene.file.fingertips), 1))
    for row, element in enumerate(elements):
        if x[row, 0] > 0:
            share[row, _select.fingertips(scene, element)] = -np.expm1(-1 / (scene.file.rate_hz * x[row, 0]))
    return _Slow(None, share)


def _apply(slow: _Slow, readings: Readings) -> tuple[_Slow, Readings]:
    """Return the readings with lagging forces."""
    force = readings["fingertip_force"]
    last = force if slow.last is None else slow.last
    now = np.where(slow.share == 1, force, last + slow.share * (force - last))
    return slow._replace(last=now), {**readings, "fingertip_force": now}


EFFECT = Effect(
    about="fingertip forces follow with a first-order lag",
    advice=Advice("Allow for the lag of {tip}: forces follow with a time constant of {x}"),
    parameters=(
        Parameter(
            "timeconst_s",
            "s",
            fixed(0.0, 0.5),
            values(0.01, 0.03, 0.08, 0.2),
            spans((0.025, 0.12)),
            "elastomer covers and filters in the sensor: 10 to 200 ms",
            always(0.0),
        ),
    ),
    acts_on="fingertip",
    possible=_select.has_forces,
    elements=_select.fingertip_names,
    reading=Hook(_start, _apply),
    moves=("fingertip_force",),
)
