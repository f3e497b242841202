"""How far a hand is from what the object stands on, and whether it overlaps the object."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np

from candata.effects import _contact
from candata.policies import _drive as d
from candata.policies._contract import Array
from candata.rotation import exp, multiply, rotate
from candata.scenes import Scene

#: Gaps from here on are not told apart [m].
FAR_M = 0.5


@lru_cache(maxsize=16)
def _support_and_robot(scene: Scene) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return ids of the support's geoms, and of all others that can touch the object: those of the robot."""
    support = _contact.geoms(scene, scene.file.support).tolist() if scene.file.support else []
    others = {*scene.object_geoms.tolist(), *support}
    return tuple(support), tuple(g for g in _contact.geoms(scene, None).tolist() if g not in others)


def put(scene: Scene, data: mujoco.MjData, commands: Array, object_pose: Array) -> None:
    """Put the joints where servos rest under commands `(A,)`, and the object into a pose `(7,)`, in `data`."""
    data.qpos[:] = d.start_qpos(scene, commands)
    data.qpos[scene.object_qpos : scene.object_qpos + 7] = object_pose
    mujoco.mj_kinematics(scene.model, data)
    mujoco.mj_comPos(scene.model, data)


def height_m(scene: Scene, data: mujoco.MjData) -> float:
    """Return the least distance of the robot's geoms from the support [m]; `FAR_M` where it is more."""
    support, robot = _support_and_robot(scene)
    pairs = ((s, g) for s in support for g in robot)
    return min((mujoco.mj_geomDistance(scene.model, data, s, g, FAR_M, None) for s, g in pairs), default=FAR_M)


def lowest_fingertip(scene: Scene, data: mujoco.MjData) -> tuple[int, float]:
    """Return the geom of a fingertip that is nearest to the support, and its distance [m]."""
    support = _support_and_robot(scene)[0]
    tips = _contact.fingertip_geoms(scene, None).tolist()
    pairs = [(mujoco.mj_geomDistance(scene.model, data, s, g, FAR_M, None), g) for s in support for g in tips]
    height, geom = min(pairs)
    return geom, height


def touches(scene: Scene, data: mujoco.MjData) -> bool:
    """Tell whether the robot overlaps the object."""
    mujoco.mj_collision(scene.model, data)
    ends, robot = data.contact.geom, _support_and_robot(scene)[1]
    with_both = np.isin(ends, scene.object_geoms).any(1) & np.isin(ends, robot).any(1)
    return bool((with_both & (data.contact.dist < 0)).any())


def turned(scene: Scene, pose: Array, heading_rad: float) -> Array:
    """Return a pose `(7,)` of the object, turned about the vertical through its mass centre."""
    turn, offset = exp(np.array([0.0, 0.0, heading_rad])), rotate(pose[3:], scene.model.body_ipos[scene.object_id])
    return np.concatenate([pose[:3] + offset - rotate(turn, offset), multiply(turn, pose[3:])])
