"""The fingertips do not feel small forces."""

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
    always,
    constant_bounds,
    spans,
    values,
)
from candata.scenes.assemble import Scene


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the bands `(n, F, 1)` [N]."""
    bands = np.zeros((len(x), len(scene.file.fingertips), 1))
    for row, element in enumerate(elements):
        bands[row, _select.fingertips(scene, element)] = x[row, 0]
    return bands


def _apply(bands: Array, readings: Readings) -> tuple[Array, Readings]:
    """Return the readings with every component below the band as zero, the others as they are."""
    force = readings["fingertip_force"]
    return bands, {**readings, "fingertip_force": np.where(np.abs(force) < bands, 0.0, force)}


EFFECT = Effect(
    about="components of fingertip forces below a band read zero",
    advice=Advice("Allow for the dead band of {tip}: forces below {x} read zero"),
    parameters=(
        Parameter(
            "band_N",
            "N",
            constant_bounds(0.0, 3.0),
            values(0.1, 0.3, 0.8),
            spans((0.2, 0.8)),
            "covers and thresholds of tactile sensors swallow tenths of a newton",
            always(0.0),
        ),
    ),
    acts_on="fingertip",
    possible=_select.has_forces,
    elements=_select.fingertip_names,
    reading=Hook(_start, _apply),
    moves=("fingertip_force",),
)
