"""The fingertips read a force when nothing touches them."""

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
    """Return the biases `(n, F, 3)` [N]; of a named fingertip only, where one is named."""
    bias = np.zeros((len(x), len(scene.file.fingertips), 3))
    for row, element in enumerate(elements):
        tips = _select.fingertips(scene, element)
        bias[row, tips] = x[row].reshape(-1, 3)[tips]
    return bias


def _apply(bias: Array, readings: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Return the readings with the bias added."""
    return bias, {**readings, "fingertip_force": bias + readings["fingertip_force"]}


EFFECT = Effect(
    about="a constant is added to fingertip forces",
    advice=Advice("Correct the zero of {tip}: forces are off by {x}"),
    parameters=(
        Parameter(
            "bias_N",
            "N",
            constant_bounds(-5.0, 5.0),
            values(-0.2, 0.2),
            spans((-0.4, 0.4)),
            "tare drift of tactile sensors: tenths of a newton to newtons",
            always(0.0),
            size=lambda scene: 3 * len(scene.file.fingertips),
            owners=lambda scene: tuple(tip for tip in scene.file.fingertips for _ in range(3)),
        ),
    ),
    acts_on="fingertip",
    possible=_select.has_forces,
    elements=_select.fingertip_names,
    reading=Hook(_start, _apply),
    moves=("fingertip_force",),
)
