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
    constant_bounds,
    spans,
    values,
)
from candata.scenes.assemble import Scene


class _LagState(NamedTuple):
    """The last reading `(n, F, 3)`, and the share of the way to the force that a row goes `(n, F, 1)`."""

    force: Array | None
    share: Array


def _start(scene: Scene, x: Array, elements: Elements) -> _LagState:
    """Return sensors at rest: a first-order lag sampled at the control rate goes 1 - exp(-dt / tau) a row."""
    share = np.ones((len(x), len(scene.file.fingertips), 1))
    for row, element in enumerate(elements):
        if x[row, 0] > 0:
            share[row, _select.fingertips(scene, element)] = -np.expm1(-1 / (scene.file.rate_hz * x[row, 0]))
    return _LagState(None, share)


def _apply(state: _LagState, readings: Readings) -> tuple[_LagState, Readings]:
    """Return the readings with lagging forces; a lag begins at the first force that is known."""
    force = readings["fingertip_force"]
    last_force = force if state.force is None else np.where(np.isfinite(state.force), state.force, force)
    lagged_force = np.where(state.share == 1, force, last_force + state.share * (force - last_force))
    return state._replace(force=lagged_force), {**readings, "fingertip_force": lagged_force}


EFFECT = Effect(
    about="fingertip forces follow with a first-order lag",
    advice=Advice("Allow for the lag of {tip}: forces follow with a time constant of {x}"),
    parameters=(
        Parameter(
            "timeconst_s",
            "s",
            constant_bounds(0.0, 0.5),
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
