"""What a scene is like: whether it is a toss, and how high its support is."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.scenes.assemble import Scene


def is_toss(scene: Scene) -> bool:
    """Tell whether the scene is an object alone, replayed open loop."""
    return len(scene.actuator_ids) == 0 and scene.object_id is not None


def support_height(scene: Scene) -> float:
    """Return the height of the support's top as the model begins [m]; 0 without one."""
    if scene.file.support is None:
        return 0.0
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_kinematics(model, data)
    geom = model.geom(scene.file.support).id
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        return float(data.geom_xpos[geom, 2])
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    up = data.geom_xmat[geom].reshape(3, 3)[2]
    return float(data.geom_xpos[geom, 2] + up @ centre + np.abs(up) @ half)
