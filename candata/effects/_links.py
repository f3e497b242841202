"""Links: the bodies that finger joints move, those whose weight or inertia the drives feel, and the joints that do."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects import _select
from candata.errors import UnknownNameError
from candata.scenes.assemble import Scene, subtree

Ids = NDArray[np.int64]
Array = NDArray[np.float64]
#: Usual acceleration of a joint [rad/s^2]: a swing of 1 rad to each side once a second, (2 pi)^2. Chosen.
ACCELERATION_RAD_S2 = (2 * np.pi) ** 2
#: Least share of a drive's torque that a link must take to matter. Chosen: geared servos lose 2 to 20 % of their torque
#: to dry friction (`joint_dry_friction`), in which smaller moments are lost.
FELT = 0.1


def links(scene: Scene, element: str | None = None) -> Ids:
    """Return ids of the bodies with mass that finger joints move; of the one, or the group of joints, named.

    A group stands for the bodies that carry its joints.

    Raises
    ------
    UnknownNameError
        When `element` is no such body and no group.
    """
    ids = _moved(scene)
    if element is None:
        return ids
    choices = {scene.model.body(int(b)).name: np.array([b]) for b in ids}
    choices = {name: body for name, body in choices.items() if name} | _groups(scene)
    if element not in choices:
        raise UnknownNameError("link or group", element, choices)
    return choices[element]


def has_felt(scene: Scene) -> bool:
    """Tell whether the drives feel the mass of some link."""
    return len(_felt(scene, _mass_torque)) > 0


def has_felt_inertia(scene: Scene) -> bool:
    """Tell whether the drives feel the inertia of some link about its own centre of mass."""
    return len(_felt(scene, _inertia_torque)) > 0


def names(scene: Scene) -> tuple[str, ...]:
    """Return the names of links whose mass the drives feel, and of groups that are neither one link nor all."""
    return _names(scene, _felt(scene, _mass_torque))


def inertia_names(scene: Scene) -> tuple[str, ...]:
    """Return the names as `names` does, of links whose inertia about their own centre of mass the drives feel."""
    return _names(scene, _felt(scene, _inertia_torque))


def members(scene: Scene, element: str) -> tuple[str, ...]:
    """Return the names of the links of a group; else the element alone."""
    if element not in _groups(scene):
        return (element,)
    return tuple(scene.model.body(int(b)).name for b in _groups(scene)[element])


def joints_of(scene: Scene, element: str) -> tuple[str, ...]:
    """Return the names of the joints whose drives feel the mass of a link, or of a group of links, most of all.

    Raises
    ------
    UnknownNameError
        When `element` is no link and no group.
    """
    share = _mass_torque(scene)[links(scene, element)]
    is_feeling = (share >= min(FELT, float(share.max()))).any(0)
    indices = _select.finger_joints(scene)[is_feeling]
    return tuple(scene.file.joints[i] for i in indices)


def extent(scene: Scene) -> float:
    """Return the largest half length [m] of the links whose mass is felt, of the box of their mass and inertia.

    A box of mass m and half lengths a, b, c has inertia m (b^2 + c^2) / 3 about the axis of a (and in turn).
    """
    ids = _felt(scene, _mass_torque)
    if not len(ids):
        return 0.05
    inertia, mass = scene.model.body_inertia[ids], scene.model.body_mass[ids]
    half_length = np.sqrt(1.5 * np.maximum(inertia.sum(1) - 2 * inertia.min(1), 0) / mass)
    from_joint = np.linalg.norm(scene.model.body_ipos[ids], axis=1)
    return float(np.maximum(half_length, from_joint).max())


def _names(scene: Scene, felt: Ids) -> tuple[str, ...]:
    """Return the names of felt links, and of groups that hold one and are neither one link nor all."""
    bodies = [scene.model.body(int(b)).name for b in felt]
    count = len(_moved(scene))
    groups = [n for n, ids in _groups(scene).items() if 1 < len(ids) < count and np.isin(ids, felt).any()]
    return tuple(dict.fromkeys(n for n in (*bodies, *groups) if n))


@lru_cache(maxsize=64)
def _groups(scene: Scene) -> dict[str, Ids]:
    """Return, for each group of the scene whose name is no link's, the links that carry its joints."""
    moved, groups = _moved(scene), {}
    for name, joint_names in scene.file.groups.items():
        carriers = [int(scene.model.jnt_bodyid[scene.model.joint(j).id]) for j in joint_names]
        is_body = mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_BODY, name) in moved
        if carriers and not is_body and np.isin(carriers, moved).all():
            groups[name] = np.unique(carriers)
    return groups


def _moved(scene: Scene) -> Ids:
    """Return ids of the bodies whose mass finger joints move."""
    arm, inertia = _levers(scene)
    return np.flatnonzero((arm + inertia).any(1))


def _felt(scene: Scene, torque: Callable[[Scene], Array]) -> Ids:
    """Return ids of the links that take at least `FELT` of a drive's torque."""
    return np.flatnonzero((torque(scene) >= FELT).any(1))


@lru_cache(maxsize=64)
def _mass_torque(scene: Scene) -> Array:
    """Return `(nbody, K)` the share of a drive's torque that weight and inertia of each link take, axis across gravity.

    Against gravity m g r, at the usual acceleration (m r^2 + I) a; of a slide m g and m a.
    """
    arm, inertia = _levers(scene)
    mass, gravity = scene.model.body_mass[:, None], float(np.linalg.norm(scene.model.opt.gravity))
    weight = mass * gravity * arm
    return (weight + (mass * arm**2 + inertia) * _accelerations(scene)) / _torques(scene)


@lru_cache(maxsize=64)
def _inertia_torque(scene: Scene) -> Array:
    """Return `(nbody, K)` the share of a drive's torque that the inertia of each link about its own centre takes."""
    return _levers(scene)[1] * _accelerations(scene) / _torques(scene)


@lru_cache(maxsize=64)
def _levers(scene: Scene) -> tuple[Array, Array]:
    """Return lever arms [m; 1 of slides] and own inertias [kg m^2] of bodies about finger joints, each `(nbody, K)`.

    At the model's own pose; zero where a joint does not move a body, or the body has no mass.
    """
    model, joints = scene.model, scene.joint_ids[_select.finger_joints(scene)]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    arm, inertia = np.zeros((model.nbody, len(joints))), np.zeros((model.nbody, len(joints)))
    for column, joint in enumerate(joints):
        ids = np.array([b for b in subtree(model, int(model.jnt_bodyid[joint])) if model.body_mass[b] > 0], int)
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
            arm[ids, column] = 1.0
            continue
        axis = data.xaxis[joint]
        away = np.cross(data.xipos[ids] - data.xanchor[joint], axis)
        principal = np.einsum("bij,i->bj", data.ximat[ids].reshape(-1, 3, 3), axis)
        arm[ids, column] = np.linalg.norm(away, axis=1)
        inertia[ids, column] = (principal**2 * model.body_inertia[ids]).sum(1)
    return arm, inertia


def _accelerations(scene: Scene) -> Array:
    """Return usual accelerations `(K,)` of the finger joints [rad/s^2, or m/s^2]."""
    reach = [_select.drive_reach(scene, scene.file.joints[i]) for i in _select.finger_joints(scene)]
    return ACCELERATION_RAD_S2 * np.array(reach)


def _torques(scene: Scene) -> Array:
    """Return the largest torques `(K,)` of the drives of the finger joints [N m, or N], above zero."""
    torques = [_select.joint_torque(scene, i) for i in _select.finger_joints(scene)]
    return np.maximum(torques, mujoco.mjMINVAL)
