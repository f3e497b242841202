"""Dry friction in the gears that grows with the torque they transmit."""

from __future__ import annotations

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
    constant_bounds,
    spans,
    values,
)
from candata.scenes.assemble import Scene


def _start(scene: Scene, x: Array, elements: Elements) -> Array:
    """Return the share of the motors' torque that friction takes, `(n, nv)`."""
    share = np.zeros((len(x), scene.model.nv))
    for row, element in enumerate(elements):
        joints = _select.shared_joints(scene) if element is None else _select.joints(scene, element)
        share[row, scene.joint_dof[joints]] = x[row, 0]
    return share


def _apply(share: Array, x: DryFriction) -> tuple[Array, DryFriction]:
    """Return the limits with a share of the motors' torque at the start of the control step.

    Source: arXiv 2410.08650, section III, K_l |tau_m - tau_e|: motor and outside torque balance but for friction and
    acceleration, tau_e = -tau_m, so that the share is 2 K_l.
    """
    return share, x._replace(added=x.added + share * np.abs(x.effort))


EFFECT = Effect(
    about="dry friction that grows with the torque of the motors is added to the joints",
    advice=Advice("Add friction to {joint}: {x} times the torque of the motor"),
    parameters=(
        Parameter(
            "torque_share",
            "1",
            constant_bounds(0.0, 0.95),
            values(0.1, 0.3, 0.7),
            spans((0.25, 0.7)),
            "geared servos: K_l of 0 to 0.5 (arXiv 2410.08650), which is a share of 0 to 1",
            always(0.0),
        ),
    ),
    acts_on="joint",
    possible=_select.has_drives,
    elements=_select.joint_places,
    friction=Hook(_start, _apply),
)
