"""Servos grow weak with their supply: position gain and torque limit follow the recorded voltage."""

from __future__ import annotations

import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Advice,
    Array,
    DriveStrength,
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
from candata.scenes.motors import affine_law


def _supplied(scene: Scene) -> _select.Ids:
    """Return the ids of the servos that follow a position."""
    ids = _select.servos(scene, None) if _select.has_drives(scene) else np.zeros(0, int)
    gain, bias = affine_law(scene.model, ids)
    return ids[(gain > 0) & (bias[:, 1] < 0)]


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the share of the sag that reaches each servo, `(n, A)`."""
    return x[:, :1] * np.isin(scene.actuator_ids, _supplied(scene))


def _apply(share: Array, x: DriveStrength) -> tuple[Array, DriveStrength]:
    """Return the strength as the share of the recorded change makes it; a supply does not turn round.

    Source: a DC motor without a current loop has torque (K/R)(v - K w), v its duty times the supply.
    """
    return share, x._replace(strength=x.strength * np.maximum(1 + share * (x.supply - 1), 0))


EFFECT = Effect(
    about="position gain and torque limit of the servos follow their recorded supply",
    advice=Advice(
        "Let position gain and torque limit of {servo} change with the recorded supply: by {x} of its relative change",
        "no attribute follows a recording: scale gainprm, biasprm and forcerange before each control step",
    ),
    parameters=(
        Parameter(
            "share",
            "1",
            constant_bounds(0.0, 1.5),
            values(0.4, 1.0),
            spans((0.5, 1.1)),
            "1 without a current loop, 0 with an ideal one; wires behind the reading lose more. Ends chosen",
            always(0.0),
        ),
    ),
    acts_on="joint",
    possible=lambda scene: len(_supplied(scene)) > 0,
    follows=("supply_voltage",),
    drive=Hook(_start, _apply),
)
