"""Which joints, actuators and geoms an effect touches in a scene."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import UnknownNameError
from candata.scenes.assemble import Scene, subtree
from candata.scenes.motors import affine_law

Ids = NDArray[np.int64]
#: Usual turn of a finger's hinge [rad], and usual travel of a jaw without limits [m]. Chosen.
TURN, TRAVEL_M = 1.5, 0.05


def has_drives(scene: Scene) -> bool:
    """Tell whether the scene has joints with an actuator, slides too."""
    return len(_driven_joints(scene)) > 0


def has_object(scene: Scene) -> bool:
    """Tell whether the scene has an object."""
    return scene.object_id is not None


def has_forces(scene: Scene) -> bool:
    """Tell whether the scene has force-sensing fingertips."""
    return len(scene.force_sensors) > 0


def fingers(scene: Scene) -> Ids:
    """Return indices into `scene.file.joints` of what joint and drive effects act on everywhere: the driven hinges.

    Where no hinge is driven, the jaws on rails; of slides that are no jaws, all.
    """
    if len(scene.driven_hinges):
        return scene.driven_hinges
    return jaws(scene) if len(jaws(scene)) else _driven_joints(scene)


@lru_cache(maxsize=64)
def jaws(scene: Scene) -> Ids:
    """Return indices of driven slides that move some of the fingertips and not all: jaws on rails, no wrist."""
    indices = []
    for i in _driven_joints(scene):
        joint = scene.joint_ids[i]
        bodies = subtree(scene.model, int(scene.model.jnt_bodyid[joint]))
        is_carried = np.isin(scene.fingertip_bodies, list(bodies))
        if _slides(scene, i) and is_carried.any() and not is_carried.all():
            indices.append(i)
    return np.array(indices, int)


def _slides(scene: Scene, index: int) -> bool:
    """Tell whether a joint of `scene.file.joints` slides."""
    return bool(scene.model.jnt_type[scene.joint_ids[index]] == mujoco.mjtJoint.mjJNT_SLIDE)


def finger_joints(scene: Scene) -> Ids:
    """Return indices of all joints that joint and drive effects may act on: `fingers`, and jaws on rails beside."""
    return _with_jaws(scene, fingers(scene))


def _with_jaws(scene: Scene, indices: Ids) -> Ids:
    """Return the joints chosen and the jaws on rails, in the order of `joint_position`."""
    return np.union1d(indices, jaws(scene)).astype(int)


def on_rails(scene: Scene, element: str | None) -> bool:
    """Tell whether the joints of `element`, or those of all fingers, slide: effects are in m and N there."""
    indices = moving_indices(scene, element)
    return len(indices) > 0 and all(_slides(scene, i) for i in indices)


def joints(scene: Scene, element: str | None) -> Ids:
    """Return indices into `scene.file.joints`: all of `fingers`, or the one, the jaw or the group named.

    Raises
    ------
    UnknownNameError
        When `element` is no driven hinge or jaw and no group of either.
    """
    return _select_joints(scene, fingers(scene), finger_joints(scene), element)


def _select_joints(
    scene: Scene, everywhere: Ids, selectable: Ids, element: str | None, allow_mixed: bool = False
) -> Ids:
    """Return the usual joints, or those of the possible joint or group named."""
    if element is None:
        return everywhere
    choices = {scene.file.joints[i]: np.array([i]) for i in selectable} | _groups(scene, selectable, allow_mixed)
    if element not in choices:
        raise UnknownNameError("joint or group", element, choices)
    return choices[element]


def _groups(scene: Scene, selectable: Ids, allow_mixed: bool) -> dict[str, Ids]:
    """Return the indices of each group that holds possible joints only, and of one kind if not `allow_mixed`."""
    groups = {
        name: np.array([scene.file.joints.index(j) for j in members], int)
        for name, members in scene.file.groups.items()
    }
    of_one_kind = {name: allow_mixed or len({_slides(scene, i) for i in ids}) == 1 for name, ids in groups.items()}
    return {
        name: ids for name, ids in groups.items() if len(ids) and of_one_kind[name] and np.isin(ids, selectable).all()
    }


def _places(
    scene: Scene, everywhere: Ids, extra_slides: Ids, selectable: Ids, allow_mixed: bool = False
) -> tuple[str, ...]:
    """Return the names of the joints of `everywhere`, of extra slides, and of groups that are neither one nor all.

    A lone joint is left out beside slides: the effect touches it anyway, so it would be the same cause twice. A slide
    that is in a group is left out for the same reason.
    """

    def is_one(ids: Ids) -> bool:
        """Tell whether one motor, named by its first joint, is all that pulls a group."""
        return len(ids) > 1 and len(np.intersect1d(ids, np.union1d(everywhere, extra_slides))) == 1

    groups = {
        n: ids
        for n, ids in _groups(scene, selectable, allow_mixed).items()
        if (np.setdiff1d(ids, everywhere).size or 1 < len(ids) < len(everywhere)) and not is_one(ids)
    }
    group_members = np.concatenate([np.zeros(0, int), *groups.values()])
    rails = np.setdiff1d(extra_slides, np.union1d(everywhere, group_members)).astype(int)
    lone = len(everywhere) == 1 and (len(groups) or len(rails))
    return (
        *(() if lone else (scene.file.joints[i] for i in everywhere)),
        *(scene.file.joints[i] for i in rails),
        *groups,
    )


def moving_joints(scene: Scene) -> Ids:
    """Return indices of the joints that resist motion: `fingers`, or all hinges where nothing drives (a toss)."""
    if len(scene.actuator_ids):
        return fingers(scene)
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return np.flatnonzero([scene.model.jnt_type[j] == hinge for j in scene.joint_ids]).astype(int)


def has_moving(scene: Scene) -> bool:
    """Tell whether the scene has joints that resist motion."""
    return len(moving_joints(scene)) > 0


def moving_places(scene: Scene) -> tuple[str, ...]:
    """Return the names of the joints that resist motion, in the order of `joint_position`, and of groups of them."""
    return _places(scene, moving_joints(scene), jaws(scene), _with_jaws(scene, moving_joints(scene)))


def joint_places(scene: Scene) -> tuple[str, ...]:
    """Return the names of the driven hinges and jaws, in the order of `joint_position`, and of groups of them."""
    return _places(scene, fingers(scene), jaws(scene), finger_joints(scene))


def motor_places(scene: Scene) -> tuple[str, ...]:
    """Return the names of the hinges and jaws that have a motor each, and of groups of them.

    Of several joints on one tendon the first stands for their motor.
    """
    return _places(scene, _first_joints(scene, fingers(scene)), _first_joints(scene, jaws(scene)), finger_joints(scene))


def servo_places(scene: Scene) -> tuple[str, ...]:
    """Return the names as `motor_places` does, and of groups of other driven slides, or of those in none: a wrist's.

    Where no hinge is driven, as of jaws that slide, the slides stand for the hinges.
    """
    slides = np.array([i for i in _driven_joints(scene) if _slides(scene, i)], int)
    return _places(
        scene,
        _first_joints(scene, shared_joints(scene)),
        _first_joints(scene, slides),
        _driven_joints(scene),
        allow_mixed=True,
    )


def _first_joints(scene: Scene, indices: Ids) -> Ids:
    """Return those of the joints chosen that are the first of an actuator."""
    order = {int(scene.joint_ids[i]): int(i) for i in indices}
    firsts = {min((order[j] for j in levers if j in order), default=-1) for levers in scene.levers.values()}
    return np.array(sorted(firsts - {-1}), int)


def shared_joints(scene: Scene) -> Ids:
    """Return indices of the driven hinges and jaws, whose shares and times mean the same; of all where no hinge is."""
    return _with_jaws(scene, scene.driven_hinges) if len(scene.driven_hinges) else _driven_joints(scene)


def _driven_joints(scene: Scene) -> Ids:
    """Return indices into `scene.file.joints` of the driven joints, slides too."""
    joint_ids = {joint for levers in scene.levers.values() for joint in levers}
    return np.flatnonzero(np.isin(scene.joint_ids, list(joint_ids)))


def fingertip_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of the fingertips."""
    return scene.file.fingertips


def dofs(scene: Scene, element: str | None) -> Ids:
    """Return addresses in qvel of the joints that resist motion, or of the one or the group named."""
    return scene.joint_dof[moving_indices(scene, element)]


def moving_indices(scene: Scene, element: str | None) -> Ids:
    """Return indices of the joints that resist motion, or of the one or the group named."""
    return _select_joints(scene, moving_joints(scene), _with_jaws(scene, moving_joints(scene)), element)


def actuators(scene: Scene, element: str | None) -> Ids:
    """Return actuator ids that drive the fingers, or the joint or the group named."""
    return _drives(scene, joints(scene, element))


def servos(scene: Scene, element: str | None) -> Ids:
    """Return actuator ids as `actuators` does; a group may hold slides too, for what has the same unit there."""
    return _drives(scene, _select_joints(scene, shared_joints(scene), _driven_joints(scene), element, allow_mixed=True))


def _drives(scene: Scene, indices: Ids) -> Ids:
    """Return the ids of the actuators that pull joints."""
    ids = set(scene.joint_ids[indices].tolist())
    return np.array([a for a in scene.actuator_ids.tolist() if ids.intersection(scene.levers.get(a, ()))], int)


def command_per_rad(scene: Scene, actuator: int) -> float:
    """Return by how much a servo's command rises when what it pulls turns by 1 rad, all joints alike; 1 for a motor."""
    (gain,), ((_, bias, _),) = affine_law(scene.model, [actuator])
    lever = sum(abs(v) for v in scene.levers[actuator].values())
    return abs(lever * bias / gain) if gain and bias < 0 else 1.0


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
    model, object_geoms = scene.model, set(scene.object_geoms.tolist())
    bodies = subtree(model, scene.object_id) if scene.object_id is not None else set()
    partners = [
        g
        for g in range(model.ngeom)
        if model.geom_bodyid[g] not in bodies and any(collide(scene, g, o) for o in object_geoms)
    ]
    return tuple(sorted(object_geoms | set(partners)))


def collide(scene: Scene, geom: int, other_geom: int) -> bool:
    """Tell whether the bit masks let two geoms meet."""
    kind, affinity = scene.model.geom_contype, scene.model.geom_conaffinity
    return bool((kind[geom] & affinity[other_geom]) | (kind[other_geom] & affinity[geom]))


def drive_torque(scene: Scene, element: str | None = None) -> float:
    """Return the median torque limit of the fingers' motors [N m; N of jaws on rails], the measure of torques.

    Of `element` where one is given. Unlimited servos count as kp x 0.3 rad, a usual steady error under full load.
    """
    return float(np.median(_drive_limits(scene, element)))


def largest_drive_torque(scene: Scene) -> float:
    """Return the largest torque limit of the fingers' motors [N m; N of jaws on rails]."""
    return float(np.max(_drive_limits(scene, None)))


def _drive_limits(scene: Scene, element: str | None) -> NDArray[np.float64]:
    """Return the torque limits of the fingers' motors [N m; N of jaws on rails]; one entry of 1 without any."""
    ids = actuators(scene, element)
    if not len(ids):
        return np.ones(1)
    has_limit = scene.model.actuator_forcelimited[ids].astype(bool)
    assumed_limit = 0.3 * drive_reach(scene, element) * scene.stiffness(ids)
    return np.where(has_limit, scene.model.actuator_forcerange[ids, 1], assumed_limit)


def joint_torque(scene: Scene, index: int) -> float:
    """Return the largest torque [N m, or N] that the drives of a joint of `scene.file.joints` give it together.

    Unlimited servos count as in `drive_torque`.
    """
    joint = int(scene.joint_ids[index])
    ids = _drives(scene, np.array([index]))
    lever = np.array([abs(scene.levers[a][joint]) for a in ids.tolist()])
    assumed_limit = 0.3 * drive_reach(scene, scene.file.joints[index]) * lever * scene.stiffness(ids)
    has_limit = scene.model.actuator_forcelimited[ids].astype(bool)
    return float((lever * np.where(has_limit, scene.model.actuator_forcerange[ids, 1], assumed_limit)).sum())


def drive_spring(scene: Scene, element: str | None = None) -> float:
    """Return the stiffness [N m/rad; N/m of jaws on rails] of a spring that takes a motor's torque over a radian."""
    return drive_torque(scene, element) / drive_reach(scene, element)


def drive_damping(scene: Scene, element: str | None = None) -> float:
    """Return the median damping of the fingers' joints, joint and servo together [N m s/rad; N s/m of jaws on rails].

    Those of `element` where one is given. A joint without any counts as a tenth of critical damping, 0.2 sqrt(kp M).
    """
    ids = actuators(scene, element)
    if not len(ids):
        return 1.0
    model, firsts = scene.model, [next(iter(scene.levers[a].items())) for a in ids.tolist()]
    dof, lever = model.jnt_dofadr[[joint for joint, _ in firsts]], np.array([v for _, v in firsts])
    damping = model.dof_damping[dof] - lever**2 * affine_law(model, ids)[1][:, 2]
    critical = 0.2 * np.sqrt(lever**2 * np.maximum(scene.stiffness(ids), 0) * model.dof_M0[dof])
    return float(np.median(np.maximum(damping, critical)))


def drive_inertia(scene: Scene, element: str | None = None) -> float:
    """Return the median inertia that the fingers' joints see at rest pose [kg m^2; kg of jaws on rails] (`dof_M0`)."""
    dof = dofs(scene, element)
    return float(np.median(scene.model.dof_M0[dof])) if len(dof) else 1.0


def drive_reach(scene: Scene, element: str | None = None) -> float:
    """Return what a radian of a hinge is: 1, or of joints that slide the part of their travel [m].

    Chosen: a hinge of a hand turns by 1.5 rad, so that a slide's travel over `TURN` is as much to it; without limits it
    travels `TRAVEL_M`.
    """
    if not on_rails(scene, element):
        return 1.0
    ids = scene.joint_ids[joints(scene, element)]
    has_limit = scene.model.jnt_limited[ids].astype(bool)
    travel = np.where(has_limit, np.ptp(scene.model.jnt_range[ids], axis=1), TRAVEL_M)
    return float(np.median(travel) / TURN)


def per_rail(reference: Callable[..., float]) -> Callable[[Scene, str | None], float]:
    """Return by how much more a quantity is on an element than on the fingers as a whole."""
    return lambda scene, element: reference(scene, element) / reference(scene)


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
    positive_form = np.maximum(solref[:, 0], 2 * scene.model.opt.timestep)
    time = np.where(solref[:, 0] > 0, positive_form, 2 / np.maximum(-solref[:, 1], 1e-9))
    return float(np.median(time))
