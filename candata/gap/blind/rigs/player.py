"""The player of random small scenes: plain MuJoCo, one loop, the readings of an ideal rig.

Row k holds joints and pose at its time; its command is held until the next row; its force is the mean over the control
step before it of the net force that everything exerts on the fingertip, in the frame of the body that carries it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.rigs.design import Rig
from candata.gap.blind.rigs.motions import rest_command, start_of
from candata.schema.scene import SceneFile

Array = NDArray[np.float64]
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
#: What counts as at rest: speeds of joints [rad/s or m/s] and of the object [m/s], [rad/s], all of a while [s].
#: Chosen: what is left of a ringing spring is below the least noise that is drawn.
STILL, STILL_M_S, STILL_RADPS, QUIET_S = 0.002, 0.003, 0.05, 0.3
#: How long a rest is waited for, how long fingers take to close on what they hold [s], and how far above its place the
#: object is put down [m]. Chosen.
SETTLE_S, CLOSE_S, CLEARANCE_M = 8.0, 0.4, 0.0005
#: Readings of the object between which a later reading is interpolated: one each physics step.
Line = Callable[[Array], Array]


@dataclass(frozen=True)
class World:
    """A compiled scene and what is wrong with its commands.

    Attributes
    ----------
    model : mujoco.MjModel
    command : callable
        Commands `(R, S, A)` of all physics steps to what the motors get.
    lift_m : float
        By how much higher than modelled the object is put down before it settles.
    """

    model: mujoco.MjModel
    command: Line = lambda u: u
    lift_m: float = 0.0


class Log(NamedTuple):
    """What an ideal rig records: `(R, J)`, `(R, 7)`, `(R, F, 3)`, `(R, A)`, and what a check wants to know.

    `fine` is the pose after each physics step `(R S + 1, 7)`, the first row's before them; `touched` tells for each
    row whether anything but the support touched the object in the step before, `speed` is qvel, `warned` whether
    MuJoCo warned.
    """

    joint: Array
    pose: Array | None
    force: Array
    action: Array
    fine: Array | None
    touched: NDArray[np.bool_]
    speed: Array
    states: Array
    warned: bool


@dataclass(frozen=True)
class Parts:
    """Addresses of a scene's roles in a model."""

    qpos: NDArray[np.int64]
    dof: NDArray[np.int64]
    motors: NDArray[np.int64]
    substeps: int
    object_body: int
    object_qpos: int
    object_dof: int
    tips: list[set[int]] = field(default_factory=list)
    tip_bodies: list[int] = field(default_factory=list)
    support: frozenset[int] = frozenset()


def parts(model: mujoco.MjModel, file: SceneFile) -> Parts:
    """Return where a scene's roles lie in a model."""
    joints = [model.joint(j).id for j in file.joints]
    body = model.body(file.object).id if file.object else -1
    first = model.body_jntadr[body] if body >= 0 else 0
    bodies, tips = [], []
    for tip in file.fingertips:
        carrier = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
        own = carrier if carrier >= 0 else int(model.geom_bodyid[model.geom(tip).id])
        bodies.append(own)
        tips.append(
            {g for g in range(model.ngeom) if _inside(model, int(model.geom_bodyid[g]), own)}
            if carrier >= 0
            else {model.geom(tip).id}
        )
    return Parts(
        model.jnt_qposadr[joints],
        model.jnt_dofadr[joints],
        np.array([model.actuator(a).id for a in file.actuator_names], int),
        max(1, round(1 / file.rate_hz / model.opt.timestep)),
        body,
        int(model.jnt_qposadr[first]),
        int(model.jnt_dofadr[first]),
        tips,
        bodies,
        frozenset(g for g in range(model.ngeom) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE),
    )


def _inside(model: mujoco.MjModel, body: int, root: int) -> bool:
    """Tell whether a body is `root` or carried by it."""
    while body > root:
        body = int(model.body_parentid[body])
    return body == root


def tip_forces(model: mujoco.MjModel, data: mujoco.MjData, where: Parts) -> Array:
    """Return `(F, 3)` net contact forces on the fingertips [N], in their bodies' frames, of the last physics step.

    MuJoCo's contact frame has its first axis from the first geom to the second; the force along it acts on the second.
    """
    out, six = np.zeros((len(where.tips), 3)), np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        first, second = int(contact.geom1), int(contact.geom2)
        for f, own in enumerate(where.tips):
            sign = (second in own) - (first in own)
            if sign:
                mujoco.mj_contactForce(model, data, i, six)
                out[f] += sign * (contact.frame.reshape(3, 3).T @ six[:3])
    for f, body in enumerate(where.tip_bodies):
        out[f] = data.xmat[body].reshape(3, 3).T @ out[f]
    return out


def touches(model: mujoco.MjModel, data: mujoco.MjData, where: Parts) -> bool:
    """Tell whether anything but the table touches the object."""
    for i in range(data.ncon):
        contact = data.contact[i]
        one, two = int(contact.geom1), int(contact.geom2)
        is_first, is_second = (int(model.geom_bodyid[g]) == where.object_body for g in (one, two))
        if (is_first and two not in where.support) or (is_second and one not in where.support):
            return True
    return False


def settled(world: World, rig: Rig, placed: Array) -> Array | None:
    """Return the state `(n,)` at rest under the first command; None where it does not come to rest.

    Parameters
    ----------
    world : World
    rig : Rig
    placed : (3,) float64
        Where the object is put down: x and y [m] and the turn about z [rad], from its place in the model.
    """
    model, where = world.model, parts(world.model, rig.file)
    data = _put_down(world, rig, where, placed)
    rate, integrates = rig.file.rate_hz, np.array([d.integrates for d in rig.drives])
    starts, rests = np.array([start_of(d, rig) for d in rig.drives]), np.array([d.servo.rest for d in rig.drives])
    close, quiet = round(CLOSE_S * rate), 0
    for k in range(round(SETTLE_S * rate)):
        share = min(max(k - close, 0) / close, 1.0)  # first the object comes to rest, then fingers close on it
        data.ctrl[where.motors] = np.where(integrates, rest_command(rig), rests + share * (starts - rests))
        mujoco.mj_step(model, data, where.substeps)
        quiet = quiet + 1 if _still(data, where) else 0
        if k > 2 * close and quiet >= QUIET_S * rate:
            state = np.zeros(mujoco.mj_stateSize(model, STATE))
            mujoco.mj_getState(model, data, state, STATE)
            return state if np.isfinite(state).all() and not _warned(data) else None
    return None


def _put_down(world: World, rig: Rig, where: Parts, placed: Array) -> mujoco.MjData:
    """Return the data of a world whose joints are at rest and whose object is about to be put down."""
    model, data = world.model, mujoco.MjData(world.model)
    for drive, motor in zip(rig.drives, where.motors, strict=True):
        data.qpos[model.joint(drive.servo.joint).qposadr[0]] = drive.servo.rest
        if model.actuator_actnum[motor]:
            data.act[model.actuator_actadr[motor]] = start_of(drive, rig)
    for follower, leader, ratio in rig.follows:
        data.qpos[model.joint(follower).qposadr[0]] = ratio * data.qpos[model.joint(leader).qposadr[0]]
    if where.object_body >= 0:
        at = where.object_qpos
        data.qpos[at : at + 2] += placed[:2]
        data.qpos[at + 2] += world.lift_m + CLEARANCE_M
        data.qpos[at + 3 : at + 7] = [np.cos(placed[2] / 2), 0, 0, np.sin(placed[2] / 2)]
    return data


def _still(data: mujoco.MjData, where: Parts) -> bool:
    """Tell whether all joints and the object are at rest."""
    speed = data.qvel.copy()
    if where.object_body >= 0:
        own = speed[where.object_dof : where.object_dof + 6]
        if np.abs(own[:3]).max() > STILL_M_S or np.abs(own[3:]).max() > STILL_RADPS:
            return False
        own[:] = 0
    return bool(np.abs(speed).max(initial=0.0) < STILL)


def _warned(data: mujoco.MjData) -> bool:
    """Tell whether MuJoCo warned."""
    return any(w.number > 0 for w in data.warning)


def play(world: World, file: SceneFile, state: Array, actions: Array) -> Log:
    """Return what an ideal rig records under commands `(R, A)` from a state on.

    The first row's force is not known, as nothing was stepped before it: it is that of the first step.
    """
    model, data = world.model, mujoco.MjData(world.model)
    where = parts(model, file)
    mujoco.mj_setState(model, data, state, STATE)
    fine_commands = world.command(np.repeat(actions[:, None], where.substeps, axis=1))
    has_object, at = where.object_body >= 0, where.object_qpos
    rows, joints, poses, forces, touched, speeds, states = len(actions), [], [], [], [], [], []
    fine = [data.qpos[at : at + 7].copy()] if has_object else []
    for k in range(rows):
        joints.append(data.qpos[where.qpos].copy())
        poses.append(data.qpos[at : at + 7].copy() if has_object else np.zeros(7))
        speeds.append(data.qvel.copy())
        now = np.zeros(len(state))
        mujoco.mj_getState(model, data, now, STATE)
        states.append(now)
        total, touch = np.zeros((len(where.tips), 3)), False
        for s in range(where.substeps):
            data.ctrl[where.motors] = fine_commands[k, s]
            mujoco.mj_step(model, data)
            total += tip_forces(model, data, where)
            touch = touch or (has_object and touches(model, data, where))
            if has_object:
                fine.append(data.qpos[at : at + 7].copy())
        forces.append(total / where.substeps)
        touched.append(touch)
    return Log(
        np.array(joints),
        np.array(poses) if has_object else None,
        np.array([forces[0], *forces[:-1]]),
        actions,
        np.array(fine) if has_object else None,
        np.array([touched[0], *touched[:-1]]),
        np.array(speeds),
        np.array(states),
        _warned(data),
    )
