"""The fingertips' force scale is off."""

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
    always,
    constant_bounds,
    spans,
    values,
)
from candata.scenes.assemble import Scene


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the gains `(n, F, 1)`."""
    gains = np.ones((len(x), len(scene.file.fingertips), 1))
    for row, element in enumerate(elements):
        gains[row, _select.fingertips(scene, element)] = x[row, 0]
    return gains


def _apply(gains: Array, readings: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Return the readings with scaled forces."""
    return gains, {**readings, "fingertip_force": gains * readings["fingertip_force"]}


EFFECT = Effect(
    about="fingertip forces are scaled",
    advice=Advice("Correct the calibration of {tip}: forces read {x} times the true ones"),
    parameters=(
        Parameter(
            "gain",
            "1",
            constant_bounds(0.1, 6.0),
            values(0.5, 1.5),
            spans((0.5, 0.8), (1.25, 2.0)),
            "public users of one hand disagree by a factor of two on newtons a count",
            always(1.0),
        ),
    ),
    acts_on="fingertip",
    possible=_select.has_forces,
    elements=_select.fingertip_names,
    reading=Hook(_start, _apply),
    moves=("fingertip_force",),
    early=True,
)
