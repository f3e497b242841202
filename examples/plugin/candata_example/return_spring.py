"""A spring, as of a cable or a cover, pulls every driven hinge back to where the model's own springs rest."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects import Advice, Bounds, Effect, Parameter
from candata.scenes import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: NDArray[np.float64], element: str | None) -> None:
    """Add the stiffness to the driven hinges."""
    joints = scene.joint_ids[scene.driven_hinges]
    model.jnt_stiffness[joints] += x[0]


def _gain(scene: Scene) -> float:
    """Return the median position gain of the actuators, the scale of what a spring is worth [N m/rad]."""
    gains = scene.stiffness(scene.actuator_ids)
    return float(np.median(gains)) if len(gains) else 1.0


EFFECT = Effect(
    about="a spring pulls the driven hinges back",
    advice=Advice("Add a return spring of {x} to {joint}", "add {raw} to stiffness of the <joint>"),
    parameters=(
        Parameter(
            "stiffness_Nm_rad",
            "N m/rad",
            bounds=lambda scene: Bounds(0.0, 2 * _gain(scene)),
            probes=lambda scene: (0.1 * _gain(scene), 0.5 * _gain(scene)),
            draws=lambda scene: ((0.1 * _gain(scene), 0.8 * _gain(scene)),),
            source="cables and covers of small hands: tenths of a servo's stiffness",
            identity=lambda scene: 0.0,
        ),
    ),
    acts_on="joint",
    possible=lambda scene: len(scene.driven_hinges) > 0,
    edit=_edit,
)
