"""What a command means to an actuator, whatever it pulls: joints, tendons, motors."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.policies._contract import Array
from candata.scenes import Scene
from candata.scenes.drives import position_servos
from candata.scenes.motors import affine_law

Ids = NDArray[np.int64]
#: Share of its range that a motor without a position servo is driven by: its command is a force, and a scripted
#: motion has nothing that would hold it back.
MOTOR_SHARE = 0.2


@lru_cache(maxsize=16)
def servos(scene: Scene) -> NDArray[np.bool_]:
    """Return `(A,)`: which actuators are position servos; read-only."""
    return _fixed(position_servos(scene.model, scene.actuator_ids))


def position_servo_columns(scene: Scene) -> Ids:
    """Return the columns of `action` that command position servos."""
    return np.flatnonzero(servos(scene))


def holding_commands(scene: Scene, length: Array) -> Array:
    """Return the commands `(A,)` at which servos rest at an actuator length `(A,)`; 0 for others."""
    model, ids = scene.model, scene.actuator_ids
    gain, bias = affine_law(model, ids)
    at = servos(scene)
    out = np.zeros(len(ids))
    out[at] = length[at] * (-bias[at, 1] / gain[at]) - bias[at, 0] / gain[at]
    return out


def lengths(scene: Scene, commands: Array) -> Array:
    """Return the actuator lengths `(A,)` at which servos rest under commands `(A,)`; the model's own for others."""
    model, ids = scene.model, scene.actuator_ids
    gain, bias = affine_law(model, ids)
    at = servos(scene)
    out = np.array(model.actuator_length0[ids], float)
    out[at] = commands[at] * (gain[at] / -bias[at, 1]) - bias[at, 0] / bias[at, 1]
    return out


@lru_cache(maxsize=16)
def command_range(scene: Scene) -> Array:
    """Return `(A, 2)` smallest and largest command: control range, else what it can travel, else +-1 about rest.

    Read-only.
    """
    model, ids = scene.model, scene.actuator_ids
    is_limited = model.actuator_ctrllimited[ids].astype(bool)[:, None]
    rest = holding_commands(scene, model.actuator_length0[ids])[:, None] + np.array([-1.0, 1.0])
    travel = _travel(scene)
    return _fixed(np.where(is_limited, model.actuator_ctrlrange[ids], np.where(np.isfinite(travel), travel, rest)))


@lru_cache(maxsize=16)
def useful_range(scene: Scene) -> Array:
    """Return `(A, 2)` the commands within both the control range and the travel; the control range where none is.

    Read-only.
    """
    allowed_range, travel = command_range(scene), _travel(scene)
    low, high = np.maximum(allowed_range[:, 0], travel[:, 0]), np.minimum(allowed_range[:, 1], travel[:, 1])
    return _fixed(np.where((low < high)[:, None], np.stack([low, high], axis=1), allowed_range))


def _fixed(values: NDArray) -> NDArray:
    """Return an array that can no longer be written: it is kept for the next call."""
    values.setflags(write=False)
    return values


def _travel(scene: Scene) -> Array:
    """Return `(A, 2)` the commands that lead to both ends of what an actuator drives; infinite where nothing ends."""
    limits = [_length_range(scene, int(a)) for a in scene.actuator_ids]
    has_ends = servos(scene) & np.array([r is not None for r in limits], bool)
    ends = np.array([r if r is not None else (0.0, 0.0) for r in limits]).reshape(-1, 2)
    end_commands = np.stack([holding_commands(scene, ends[:, 0]), holding_commands(scene, ends[:, 1])], axis=1)
    return np.where(has_ends[:, None], np.sort(end_commands, axis=1), np.array([-np.inf, np.inf]))


def _length_range(scene: Scene, actuator: int) -> tuple[float, float] | None:
    """Return the shortest and longest length of an actuator; None where nothing limits it."""
    model, gear = scene.model, float(scene.model.actuator_gear[actuator, 0])
    joint, limits = scene.driven_joints.get(actuator), None
    if joint is not None and model.jnt_limited[joint]:
        limits = model.jnt_range[joint]
    elif model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON:
        tendon = model.actuator_trnid[actuator, 0]
        limits = model.tendon_range[tendon] if model.tendon_limited[tendon] else None
    if limits is None:
        return None
    low, high = sorted(gear * float(v) for v in limits)
    return low, high


def open_commands(scene: Scene) -> Array:
    """Return the commands `(A,)` of the open hand: the keyframe `open`, or those that hold the model's own start."""
    model, ids = scene.model, scene.actuator_ids
    keys = {model.key(k).name: k for k in range(model.nkey)}
    if "open" in keys:
        return np.array(model.key_ctrl[keys["open"]][ids])
    return np.clip(holding_commands(scene, model.actuator_length0[ids]), *command_range(scene).T)


def start_qpos(scene: Scene, commands: Array) -> Array:
    """Return `(nq,)` the model's own start, or its keyframe `open`, with directly driven joints at the commands.

    What tendons and coupled joints do is left to the settling.
    """
    model = scene.model
    qpos = np.array(model.qpos0, float)
    for k in range(model.nkey):
        if model.key(k).name == "open":
            qpos[scene.joint_qpos] = model.key_qpos[k][scene.joint_qpos]
    length, servo = lengths(scene, commands), servos(scene)
    for i, a in enumerate(scene.actuator_ids.tolist()):
        joint, gear = scene.driven_joints.get(a), model.actuator_gear[a, 0]
        if servo[i] and gear != 0 and joint is not None and _is_scalar(model, joint):
            qpos[model.jnt_qposadr[joint]] = length[i] / gear
    return qpos


def _is_scalar(model: mujoco.MjModel, joint: int) -> bool:
    """Tell whether a joint has one number: a hinge or a slide."""
    return int(model.jnt_type[joint]) in {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}


@lru_cache(maxsize=16)
def carriers(scene: Scene) -> frozenset[int]:
    """Return the columns of `action` whose joint carries the whole hand: every fingertip, of two or more.

    Without fingertips it is the slides; of a single fingertip too, since its hinges are its finger.
    """
    model, columns = scene.model, set()
    for i, a in enumerate(scene.actuator_ids.tolist()):
        joint = scene.driven_joints.get(a)
        if joint is None:
            continue
        body = int(model.jnt_bodyid[joint])
        all_tips = all(_carries(model, body, int(tip)) for tip in scene.fingertip_bodies)
        has_several_tips = len(set(scene.fingertip_bodies.tolist())) > 1
        if all_tips and (has_several_tips or model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE):
            columns.add(i)
    return frozenset(columns)


def _carries(model: mujoco.MjModel, body: int, descendant: int) -> bool:
    """Tell whether `descendant` is `body` or hangs on it."""
    while descendant != body and descendant != 0:
        descendant = int(model.body_parentid[descendant])
    return descendant == body
