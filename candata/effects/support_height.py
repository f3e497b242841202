"""The table is higher or lower than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.rotation import conjugate, rotate
from candata.scenes.assemble import Scene


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Move the support along world z."""
    geom = model.geom(scene.file.support).id
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn = np.array(data.xquat[model.geom_bodyid[geom]])
    model.geom_pos[geom] += rotate(conjugate(turn), np.array([0.0, 0.0, x[0]]))


def _can_act(scene: Scene) -> bool:
    """Tell whether the scene has an object and a support that stands still."""
    if scene.object_id is None or scene.file.support is None:
        return False
    model = scene.model
    return int(model.body_weldid[model.geom(scene.file.support).bodyid[0]]) == 0


EFFECT = Effect(
    about="support is raised or lowered",
    advice=Advice("Move the support by {x} along world z", "add {raw} to z in pos of its <geom>"),
    traits=frozenset({"tracked_length"}),
    parameters=(
        Parameter(
            "height_m",
            "m",
            constant_bounds(-0.05, 0.05),
            values(-0.008, 0.008),
            spans((-0.015, -0.004), (0.004, 0.015)),
            "a robot's base is placed on its table to some millimetres",
            always(0.0),
        ),
    ),
    acts_on="world",
    possible=_can_act,
    edit=_edit,
    set_const=True,
)
