"""Causes of random small scenes: edits of MuJoCo's model, of commands and of readings made here.

Values are drawn from the ranges that the effects of the library state; what they do is written again here, so that a
mistake in an effect's own hooks shows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.rigs.design import Rig
from candata.gap.blind.rigs.player import Log, parts
from candata.gap.blind.rigs.readings import Reading
from candata.gap.blind.rigs.situations import TOUCHED

Array = NDArray[np.float64]
Values = dict[str, Array]


class Target(NamedTuple):
    """What a cause is planted in: the rig, and the model to edit."""

    rig: Rig
    model: mujoco.MjModel


class Cause(NamedTuple):
    """A cause: whether it can act in a rig, and the three things it may change.

    `edit` changes the model; `command` gives what becomes of commands `(R, S, A)`; `read` what becomes of a reading.
    """

    acts: Callable[[Rig], bool]
    edit: Callable[[Target, Values], None] | None = None
    command: Callable[[Target, Values, Array], Array] | None = None
    read: Callable[[Target, Values, Log, Reading], Reading] | None = None


def _touched(rig: Rig) -> bool:
    """Tell whether something touches the object in a rig."""
    return rig.thing is not None and rig.situation in TOUCHED


def _feels(rig: Rig) -> bool:
    """Tell whether fingertips feel forces in a rig."""
    return bool(rig.file.fingertips) and rig.thing is not None and rig.situation in (*TOUCHED, "meeting", "pressing")


def _always(rig: Rig) -> bool:
    """Tell that a cause can act in any rig."""
    return True


# Joints and drives. Hinges that are driven; where none is, slides that move some of the fingertips and not all (jaws);
# where there are none of these, all driven slides.
def chosen(target: Target, beside_jaws: bool = False) -> list[int]:
    """Return the indices into the rig's drives on which joint and drive effects act; with the jaws beside hinges."""
    drives = target.rig.drives
    hinges = [i for i, d in enumerate(drives) if not d.servo.slides]
    jaws = [i for i, d in enumerate(drives) if d.servo.slides and _is_jaw(target, d.servo.joint)]
    if hinges:
        return sorted({*hinges, *jaws}) if beside_jaws else hinges
    return jaws or list(range(len(drives)))


def _is_jaw(target: Target, joint: str) -> bool:
    """Tell whether a slide moves some of the fingertips and not all."""
    model, root = target.model, int(target.model.joint(joint).bodyid[0])
    moved = []
    for body in parts(model, target.rig.file).tip_bodies:
        while body > root:
            body = int(model.body_parentid[body])
        moved.append(body == root)
    return any(moved) and not all(moved)


def _dofs(target: Target) -> list[int]:
    """Return the addresses in qvel on which joint effects act."""
    return [int(target.model.joint(target.rig.drives[i].servo.joint).dofadr[0]) for i in chosen(target)]


def _motors(target: Target, beside_jaws: bool = False) -> list[int]:
    """Return the ids of the actuators on which drive effects act."""
    return [int(target.model.actuator(target.rig.drives[i].name).id) for i in chosen(target, beside_jaws)]


def _gain(target: Target, v: Values) -> None:
    for m in _motors(target, beside_jaws=True):
        target.model.actuator_gainprm[m, 0] *= v["kp_scale"][0]
        target.model.actuator_biasprm[m, 0:2] *= v["kp_scale"][0]


def _damped_servo(target: Target, v: Values) -> None:
    for m in _motors(target, beside_jaws=True):
        target.model.actuator_biasprm[m, 2] *= v["kv_scale"][0]


def _limit(target: Target, v: Values) -> None:
    for m in _motors(target):
        target.model.actuator_forcelimited[m] = 1
        target.model.actuator_forcerange[m] = [-v["limit_Nm"][0], v["limit_Nm"][0]]


def _dry(target: Target, v: Values) -> None:
    for d in _dofs(target):
        target.model.dof_frictionloss[d] += v["frictionloss_Nm"][0]


def _viscous(target: Target, v: Values) -> None:
    for d in _dofs(target):
        target.model.dof_damping[d] += v["damping_Nms_rad"][0]


def _rotor(target: Target, v: Values) -> None:
    for d in _dofs(target):
        target.model.dof_armature[d] += v["armature_kgm2"][0]


def _late(target: Target, v: Values, u: Array) -> Array:
    """Return commands that come late: the mean, over each physics step, of the held commands shifted in time."""
    late = v["delay_s"][0] / target.model.opt.timestep
    flat = u.reshape(-1, u.shape[-1])
    columns = chosen(target, beside_jaws=True)
    at = np.arange(len(flat))
    whole = int(np.floor(late))
    newer, older = (flat[np.clip(at - whole - k, 0, None)] for k in (0, 1))
    out = flat.copy()
    out[:, columns] = ((1 - late + whole) * newer + (late - whole) * older)[:, columns]
    return out.reshape(u.shape)


def _offsets(target: Target, v: Values) -> dict[str, float]:
    """Return the encoder offset of each joint at fault: the numbers follow the order of `joints`."""
    at_fault = {target.rig.drives[i].servo.joint for i in chosen(target)}
    listed = [j for j in target.rig.file.joints if j in at_fault]
    return dict(zip(listed, v["offset_rad"].tolist(), strict=True))


def _misread(target: Target, v: Values) -> None:
    for joint, offset in _offsets(target, v).items():
        motor = next(d.name for d in target.rig.drives if d.servo.joint == joint)
        m = target.model.actuator(motor).id
        # The servo's law is bias0 + bias1 q + bias2 v: what it takes for q is off.
        target.model.actuator_biasprm[m, 0] += target.model.actuator_biasprm[m, 1] * offset


def _read_off(target: Target, v: Values, log: Log, reading: Reading) -> Reading:
    offsets = _offsets(target, v)
    return reading._replace(joint=reading.joint + np.array([offsets.get(j, 0.0) for j in target.rig.file.joints]))


# The object and what it touches.
def _body(target: Target) -> int:
    return int(target.model.body("object").id)


def _heavier(target: Target, v: Values) -> None:
    target.model.body_mass[_body(target)] *= v["mass_scale"][0]
    target.model.body_inertia[_body(target)] *= v["mass_scale"][0]


def _off_centre(target: Target, v: Values) -> None:
    # A body whose frame is its inertial frame is marked as simple, and its offset would be ignored.
    target.model.body_simple[_body(target)] = 0
    target.model.body_sameframe[_body(target)] = 0
    dof = int(target.model.body_dofadr[_body(target)])
    target.model.dof_simplenum[dof : dof + 6] = 0
    target.model.body_ipos[_body(target)] += v["offset_m"]


def _larger(target: Target, v: Values) -> None:
    shape = target.model.geom("shape").id
    for lengths in (target.model.geom_size, target.model.geom_rbound, target.model.geom_aabb):
        lengths[shape] *= v["scale"][0]


def _meeting_geoms(target: Target) -> list[int]:
    """Return the object's geom and all that can touch it."""
    model, shape = target.model, int(target.model.geom("shape").id)
    kind, affinity = model.geom_contype, model.geom_conaffinity
    others = [g for g in range(model.ngeom) if model.geom_bodyid[g] != model.geom_bodyid[shape]]
    return [shape, *(g for g in others if (kind[g] & affinity[shape]) | (kind[shape] & affinity[g]))]


def _rougher(target: Target, v: Values) -> None:
    target.model.geom_friction[_meeting_geoms(target), 0] *= v["scale"][0]


def _softer(target: Target, v: Values) -> None:
    target.model.geom_solref[_meeting_geoms(target), 0] = v["timeconst_s"][0]


# The world.
def _leaning(target: Target, v: Values) -> None:
    angle = np.array([v["tilt_x_rad"][0], v["tilt_y_rad"][0], 0.0])
    size, quat, out = float(np.linalg.norm(angle)), np.zeros(4), np.zeros(3)
    mujoco.mju_axisAngle2Quat(quat, angle / size, size)
    mujoco.mju_rotVecQuat(out, target.model.opt.gravity.copy(), quat)
    target.model.opt.gravity[:] = out


def _raised(target: Target, v: Values) -> None:
    target.model.geom_pos[target.model.geom("table").id, 2] += v["height_m"][0]


def lift_of(rig: Rig, name: str, v: Values) -> float:
    """Return by how much higher the object is put down before it settles [m]: above what would be in its way."""
    if name == "support_height":
        return max(float(v["height_m"][0]), 0.0)
    if name == "object_size" and rig.thing is not None:
        return max(float(v["scale"][0]) - 1.0, 0.0) * rig.thing.middle
    return 0.0


# Sensors.
def _known(pose: Array | None) -> Array:
    """Return a pose that a cause of an object's sensor is planted on."""
    if pose is None:
        raise ValueError("the scene has no object")
    return pose


def _late_pose(target: Target, v: Values, log: Log, reading: Reading) -> Reading:
    """Return the reading whose pose is that of a while ago, between two physics steps where it falls there."""
    fine = _known(log.fine)
    late = v["latency_s"][0] / target.model.opt.timestep
    substeps = (len(fine) - 1) // len(log.joint)
    at = np.clip(np.arange(len(log.joint)) * substeps - late, 0, None)
    whole = np.floor(at).astype(int)
    share = (at - whole)[:, None]
    old, new = fine[whole], fine[np.minimum(whole + 1, len(fine) - 1)]
    new = np.where((old[:, 3:] * new[:, 3:]).sum(1, keepdims=True) < 0, np.c_[new[:, :3], -new[:, 3:]], new)
    pose = (1 - share) * old + share * new
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    return reading._replace(pose=pose)


def _shifted_pose(target: Target, v: Values, log: Log, reading: Reading) -> Reading:
    pose = _known(reading.pose)
    return reading._replace(pose=np.c_[pose[:, :3] + v["bias_m"], pose[:, 3:]])


def _scaled_force(target: Target, v: Values, log: Log, reading: Reading) -> Reading:
    return reading._replace(force=reading.force * v["gain"][0])


def _biased_force(target: Target, v: Values, log: Log, reading: Reading) -> Reading:
    return reading._replace(force=reading.force + v["bias_N"].reshape(1, -1, 3))


def _slow_force(target: Target, v: Values, log: Log, reading: Reading) -> Reading:
    """Return the reading whose force goes, a row, the share 1 - exp(-dt / tau) of the way to the true one."""
    share = 1 - np.exp(-1 / (target.rig.file.rate_hz * v["timeconst_s"][0]))
    out = reading.force.copy()
    for k in range(1, len(out)):
        out[k] = out[k - 1] + share * (reading.force[k] - out[k - 1])
    return reading._replace(force=out)


CAUSES: dict[str, Cause] = {
    "actuation_delay": Cause(_always, command=_late),
    "servo_gain": Cause(_always, _gain),
    "servo_damping": Cause(_always, _damped_servo),
    "torque_limit": Cause(_always, _limit),
    "joint_dry_friction": Cause(_always, _dry),
    "joint_damping": Cause(_always, _viscous),
    "armature": Cause(_always, _rotor),
    "joint_offset": Cause(_always, _misread, read=_read_off),
    "object_mass": Cause(_touched, _heavier),
    "object_com": Cause(_touched, _off_centre),
    "object_size": Cause(_touched, _larger),
    "sliding_friction": Cause(_touched, _rougher),
    "contact_compliance": Cause(_touched, _softer),
    "gravity_tilt": Cause(_always, _leaning),
    "support_height": Cause(lambda rig: _touched(rig) and rig.situation != "carried", _raised),
    "pose_latency": Cause(_touched, read=_late_pose),
    "pose_bias": Cause(_touched, read=_shifted_pose),
    "tactile_gain": Cause(_feels, read=_scaled_force),
    "tactile_bias": Cause(_feels, read=_biased_force),
    "tactile_lag": Cause(_feels, read=_slow_force),
}
