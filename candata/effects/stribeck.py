"""Dry friction in the joints that falls with speed: more to break away than to keep moving."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.effects import _select
from candata.effects._contract import (
    Advice,
    Array,
    DryFriction,
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

#: Speed at which 37 % of the extra friction is left [rad/s]. Source: servos of 1 to 3 N m, 0.1 to 1 rad/s
#: (arXiv 2410.08650, models M4 to M6).
STRIBECK_RAD_S = 0.3


class _Breakaway(NamedTuple):
    """Extra friction at rest `(n, nv)` [N m], and the speed at which it fades `(n, nv)` [rad/s]."""

    limit: Array
    speed: Array


def _start(scene: Scene, x: Array, elements: Elements) -> _Breakaway:
    """Return the extra friction of the joints named."""
    limit = np.zeros((len(x), scene.model.nv))
    speed = np.full_like(limit, STRIBECK_RAD_S)
    for row, element in enumerate(elements):
        dofs = _select.dofs(scene, element)
        limit[row, dofs] = x[row, 0]
        speed[row, dofs] *= _select.drive_reach(scene, element)
    return _Breakaway(limit, speed)


def _apply(state: _Breakaway, x: DryFriction) -> tuple[_Breakaway, DryFriction]:
    """Return the limits with the extra friction at the speed that the control step begins with.

    Source: arXiv 2410.08650, section III, exp(-|w / w_s|^a) K_cs, with a = 2 as in MuJoCo's `lugre`.
    """
    return state, x._replace(added=x.added + state.limit * np.exp(-((x.qvel / state.speed) ** 2)))


EFFECT = Effect(
    about="dry friction that falls with speed is added to the joints",
    advice=Advice(
        "Add friction of {x} to {joint} that fades with speed",
        "<dcmotor> with lugre: static friction exceeds coulomb friction by {raw}",
    ),
    parameters=(
        Parameter(
            "breakaway_Nm",
            "N m",
            scaled_bounds(_select.drive_torque, 0.0, 0.6),
            scaled_probes(_select.drive_torque, 0.02, 0.07, 0.25),
            scaled_spans(_select.drive_torque, (0.08, 0.25)),
            "friction of servos of 1 to 3 N m: up to 0.2 N m more at rest than at speed (arXiv 2410.08650)",
            always(0.0),
            rails=_select.per_rail(_select.drive_torque),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.joint_places,
    friction=Hook(_start, _apply),
)
