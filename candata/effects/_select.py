"""Which joints, actuators and geoms an effect touches in a scene."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import UnknownNameError
from candata.scenes.assemble import Scene, subtree

Ids = NDArray[np.int64]


def has_driven_hinges(scene: Scene) -> bool:
    """Tell whether the scene has hinge joints with an actuator."""
    return len(scene.driven_hinges) > 0


def has_drives(scene: Scene) -> bool:
    """Tell whether the scene has joints with an actuator, slides too."""
    return len(_driven(scene)) > 0


def has_object(scene: Scene) -> bool:
    """Tell whether the scene has an object."""
    return scene.object_id is not None


def has_forces(scene: Scene) -> bool:
    """Tell whether the scene has force-sensing fingertips."""
    return len(scene.force_sensors) > 0


def joints(scene: Scene, element: str | None) -> Ids:
    """Return indices into `scene.file.joints`: all driven hinges, or the one or the group named.

    Raises
    ------
    UnknownNameError
        When `element` is no driven hinge and no group of them.
    """
    return _picked(scene, scene.driven_hinges, scene.driven_hinges, element)


def _picked(scene: Scene, usual: Ids, possible: Ids, element: str | None) -> Ids:
    """Return the usual joints, or those of the possible joint or group named."""
    if element is None:
        return usual
    known = {scene.file.joints[i]: np.array([i]) for i in usual} | _groups(scene, possible)
    if element not in known:
        raise UnknownNameError("joint or group", element, known)
    return known[element]


def _groups(scene: Scene, possible: Ids) -> dict[str, Ids]:
    """Return the indices of each group that holds possible joints only."""
    found = {name: np.array([scene.file.joints.index(j) for j in own], int) for name, own in scene.file.groups.items()}
    return {name: ids for name, ids in found.items() if len(ids) and np.isin(ids, possible).all()}


def _places(scene: Scene, usual: Ids, possible: Ids) -> tuple[str, ...]:
    """Return the names of the usual joints and of the groups that are not one of these or all.

    Beside groups of slides a lone usual joint is left out: the effect touches it anyway, so it is the same cause twice.
    """
    groups = [
        n for n, ids in _groups(scene, possible).items() if np.setdiff1d(ids, usual).size or 1 < len(ids) < len(usual)
    ]
    lone = len(usual) == 1 and groups
    return (*(() if lone else (scene.file.joints[i] for i in usual)), *groups)


def moving_hinges(scene: Scene) -> Ids:
    """Return indices of the hinges that resist motion: the driven ones, or all where nothing drives (a toss)."""
    if len(scene.actuator_ids):
        return scene.driven_hinges
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return np.flatnonzero([scene.model.jnt_type[j] == hinge for j in scene.joint_ids]).astype(int)


def has_moving_hinges(scene: Scene) -> bool:
    """Tell whether the scene has hinges that resist motion."""
    return len(moving_hinges(scene)) > 0


def moving_places(scene: Scene) -> tuple[str, ...]:
    """Return the names of the hinges that resist motion, in the order of `joint_position`, and of groups of them."""
    return _places(scene, moving_hinges(scene), moving_hinges(scene))


def joint_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of the driven hinges, in the order of `joint_position`."""
    return tuple(scene.file.joints[i] for i in scene.driven_hinges)


def joint_places(scene: Scene) -> tuple[str, ...]:
    """Return the names of the driven hinges, in the order of `joint_position`, and of groups of them."""
    return _places(scene, scene.driven_hinges, scene.driven_hinges)


def motor_places(scene: Scene) -> tuple[str, ...]:
    """Return the names of the hinges that have a motor each, and of groups of driven hinges.

    Of several joints on one tendon the first stands for their motor.
    """
    return _places(scene, _leading(scene, scene.driven_hinges), scene.driven_hinges)


def servo_places(scene: Scene) -> tuple[str, ...]:
    """Return the names as `motor_places` does, and of groups of driven slides: a wrist on rails.

    Where no hinge is driven, as of jaws that slide, the slides stand for the hinges.
    """
    return _places(scene, _leading(scene, _usual(scene)), _driven(scene))


def _leading(scene: Scene, chosen: Ids) -> Ids:
    """Return those of the joints chosen that are the first of an actuator."""
    order = {int(scene.joint_ids[i]): int(i) for i in chosen}
    firsts = {min((order[j] for j in own if j in order), default=-1) for own in scene.levers.values()}
    return np.array(sorted(firsts - {-1}), int)


def _usual(scene: Scene) -> Ids:
    """Return indices of the driven hinges; of all driven joints where there are none."""
    return scene.driven_hinges if len(scene.driven_hinges) else _driven(scene)


def _driven(scene: Scene) -> Ids:
    """Return indices into `scene.file.joints` of the driven joints, slides too."""
    pulled = {joint for own in scene.levers.values() for joint in own}
    return np.flatnonzero(np.isin(scene.joint_ids, list(pulled)))


def fingertip_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of the fingertips."""
    return scene.file.fingertips


def dofs(scene: Scene, element: str | None) -> Ids:
    """Return addresses in qvel of the hinges that resist motion, or of the one or the group named."""
    return scene.joint_dof[_picked(scene, moving_hinges(scene), moving_hinges(scene), element)]


def actuators(scene: Scene, element: str | None) -> Ids:
    """Return actuator ids that drive the hinges, or the one or the group named."""
    return _drives(scene, joints(scene, element))


def servos(scene: Scene, element: str | None) -> Ids:
    """Return actuator ids as `actuators` does; a group may hold slides too, for what has the same unit there."""
    return _drives(scene, _picked(scene, _usual(scene), _driven(scene), element))


def _drives(scene: Scene, chosen: Ids) -> Ids:
    """Return the ids of the actuators that pull joints."""
    ids = set(scene.joint_ids[chosen].tolist())
    return np.array([a for a in scene.actuator_ids.tolist() if ids.intersection(scene.levers.get(a, ()))], int)


def fingertips(scene: Scene, element: str | None) -> Ids:
    """Return indices into `scene.file.fingertips`: all, or the one named.

    Raises
    ------
    UnknownNameError
        When `element` is no fingertip.
    """
    names = scene.file.fingertips
    if element is None:
        return np.arange(len(names))
    if element not in names:
        raise UnknownNameError("fingertip", element, names)
    return np.array([names.index(element)])


@lru_cache(maxsize=64)
def contact_geoms(scene: Scene) -> tuple[int, ...]:
    """Return ids of every geom that can touch the object, and the object's own."""
    model, own = scene.model, set(scene.object_geoms.tolist())
    bodies = subtree(model, scene.object_id) if scene.object_id is not None else set()
    partners = [
        g for g in range(model.ngeom) if model.geom_bodyid[g] not in bodies and any(collide(scene, g, o) for o in own)
    ]
    return tuple(sorted(own | set(partners)))


def collide(scene: Scene, first: int, second: int) -> bool:
    """Tell whether the bit masks let two geoms meet."""
    kind, affinity = scene.model.geom_contype, scene.model.geom_conaffinity
    return bool((kind[first] & affinity[second]) | (kind[second] & affinity[first]))


def drive_torque(scene: Scene) -> float:
    """Return the median torque limit of the driven hinges [N m]: what joint torques are measured against.

    Unlimited servos count as kp x 0.3 rad, a usual steady error under full load.
    """
    return float(np.median(_drive_limits(scene)))


def largest_drive_torque(scene: Scene) -> float:
    """Return the largest torque limit of the driven hinges [N m]."""
    return float(np.max(_drive_limits(scene)))


def _drive_limits(scene: Scene) -> NDArray[np.float64]:
    """Return the torque limits of the driven hinges [N m]; one entry of 1 without any."""
    ids = actuators(scene, None)
    if not len(ids):
        return np.ones(1)
    limited = scene.model.actuator_forcelimited[ids].astype(bool)
    return np.where(limited, scene.model.actuator_forcerange[ids, 1], 0.3 * scene.stiffness(ids))


def drive_damping(scene: Scene) -> float:
    """Return the median damping of the driven hinges, joint and servo together [N m s/rad].

    A joint without any counts as a tenth of critical damping, 0.2 sqrt(kp M).
    """
    ids = actuators(scene, None)
    if not len(ids):
        return 1.0
    model, firsts = scene.model, [next(iter(scene.levers[a].items())) for a in ids.tolist()]
    dof, lever = model.jnt_dofadr[[joint for joint, _ in firsts]], np.array([v for _, v in firsts])
    own = model.dof_damping[dof] - lever**2 * model.actuator_biasprm[ids, 2]
    critical = 0.2 * np.sqrt(lever**2 * np.maximum(scene.stiffness(ids), 0) * model.dof_M0[dof])
    return float(np.median(np.maximum(own, critical)))


def drive_inertia(scene: Scene) -> float:
    """Return the median inertia that the driven hinges see at rest pose [kg m^2] (`dof_M0`)."""
    dof = dofs(scene, None)
    return float(np.median(scene.model.dof_M0[dof])) if len(dof) else 1.0


def object_size(scene: Scene) -> float:
    """Return the smallest half extent of the object [m], from the bounding boxes of its geoms."""
    if not len(scene.object_geoms):
        return 0.05
    return float(scene.model.geom_aabb[scene.object_geoms, 3:].min())


def contact_timeconst(scene: Scene) -> float:
    """Return the median contact time constant of the object's geoms [s], as MuJoCo takes it.

    Negative solref is (-stiffness, -damping): its time constant is 2 / damping (MuJoCo manual,
    "Solver parameters", with dampratio 1). A positive one counts as two physics steps at least (flag `refsafe`).
    """
    if not len(scene.object_geoms):
        return 0.02
    solref = scene.model.geom_solref[scene.object_geoms]
    given = np.maximum(solref[:, 0], 2 * scene.model.opt.timestep)
    time = np.where(solref[:, 0] > 0, given, 2 / np.maximum(-solref[:, 1], 1e-9))
    return float(np.median(time))
