"""The residual generalised force: what would have to be added for the simulator to follow the recording.

The replay is pulled along by a spring and a damper on every joint and on the object (a disturbance observer); their
force, the change of the servo's own force that goes with the remaining error, and the inertia times the remaining
difference of acceleration make up the residual. What the recorded fingertips felt more than the simulated ones is no
external force: it is taken off the object, and off the joints that carry them.

Source: the disturbance observer of Ohnishi, Shibata & Murakami 1996, "Motion control for advanced mechatronics",
section III, with known inertia and servo gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.effects import Forces
from candata.effects import _residual_terms as dictionary
from candata.gap.data.recordings import Recordings
from candata.gap.force.target import Target, followed, smoothed
from candata.gap.replay.replayer import EffectSet, Replayer, _shift, commands_before, true_start
from candata.gap.replay.starts import Starts
from candata.rotation import conjugate, difference, rotate
from candata.scenes import Scene
from candata.scenes.motors import affine_law
from candata.simulate import Observer, followed_readings, rollout

Array = NDArray[np.float64]
#: Bandwidth of the pull [rad/s], critically damped; well below the control rate, above hand motions.
BANDWIDTH = 15.0


@dataclass(frozen=True)
class Residual:
    """Residual forces and the dictionary, by episode and row.

    Attributes
    ----------
    force : (E, T, J + 6) float64
        Joints in the scene's order [N m, or N of a slide], then the object: world force [N], body torque [N m];
        NaN where not known.
    tip : (E, T, F, 3) float64
        Recorded minus simulated fingertip force [N].
    felt : (E, T, F, 3) float64
        Simulated fingertip force [N].
    joint : (E, T, J, K) float64
        Terms of the joints, at wave number 1.
    object : (E, T, K, 6) float64
        Terms of the object.
    position : (E, T, J) float64
        Simulated joint positions [rad or m].
    """

    force: Array
    tip: Array
    felt: Array
    joint: Array
    object: Array
    position: Array

    def take(self, index: NDArray[np.int64]) -> Residual:
        """Return the residual of some episodes."""
        parts = (self.force, self.tip, self.felt, self.joint, self.object, self.position)
        return Residual(*(part[index] for part in parts))


def residual_force(replayer: Replayer, recs: Recordings, begin: Starts, world: EffectSet = ()) -> Residual:
    """Return what must be added to a world for it to follow the recording.

    Parameters
    ----------
    replayer : Replayer
    recs : Recordings
        E recorded episodes.
    begin : Starts
        Where they start.
    world : tuple of EffectSetting
        Effects of the simulator that is to follow: none, or the repaired one's.
    """
    scene = replayer.scene
    true = followed_readings(scene, recs.compared, world)
    shifted = {name: _shift(values, begin.rows) for name, values in true.items()}
    target = followed(scene, shifted, recs)
    state = true_start(scene, recs, begin, world)
    commands = _shift(recs.commands, begin.rows, hold=True)
    count = len(recs)
    log: list[tuple[Forces, Array]] = []

    def push(row: int, x: Forces) -> Array:
        force = _pull(scene, target, row, x)
        log.append((x, force))
        return force

    rollout(
        scene,
        commands,
        state.qpos,
        state.qvel,
        [world] * count,
        memory=state.memory,
        earlier_commands=commands_before(recs.commands, begin.rows),
        supply=None if recs.supply is None else _shift(recs.supply, begin.rows, hold=True),
        observer=Observer(shifted, free_gain=0.02),
        push=push,
        instant_force=recs.instant_force,
        threads=replayer.threads,
    )
    replayer.count(count * commands.shape[1] * scene.substeps)
    return _residual(scene, shifted, target, log)


def _pull(scene: Scene, target: Target, row: int, x: Forces) -> Array:
    """Return `(n, nv)` the force of springs and dampers towards the recording."""
    out = np.zeros_like(x.added)
    shift, speed = _error(scene, target, row, x)
    inertia = scene.model.dof_M0[_dofs(scene)]
    force = inertia * (BANDWIDTH**2 * shift + 2 * BANDWIDTH * speed)
    out[:, _dofs(scene)] = np.where(target.seen[:, row][:, _known(scene)], force, 0.0)
    return out


def _dofs(scene: Scene) -> NDArray[np.int64]:
    """Return the addresses in qvel of the joints, then of the object."""
    own = [] if scene.object_id is None else list(range(scene.object_dof, scene.object_dof + dictionary.AXES))
    return np.concatenate([scene.joint_dof, np.array(own, int)])


def _known(scene: Scene) -> slice:
    """Return which of the J + 6 forces the scene has."""
    return slice(0, len(_dofs(scene)))


def _error(scene: Scene, target: Target, row: int, x: Forces) -> tuple[Array, Array]:
    """Return recorded minus simulated position and rate `(n, D)`; rotations in the body's frame."""
    shift = target.joints[:, row] - x.qpos[:, scene.joint_qpos]
    speed = target.rates[:, row] - x.qvel[:, scene.joint_dof]
    if scene.object_id is None:
        return shift, speed
    at, dof = scene.object_qpos, scene.object_dof
    pose, now = target.pose[:, row], x.qpos[:, at : at + 7]
    recorded = (pose[:, 3:] ** 2).sum(1, keepdims=True) > 0
    turn = difference(np.where(recorded, pose[:, 3:], now[:, 3:]), now[:, 3:])
    turn = rotate(conjugate(now[:, 3:]), turn)
    shift = np.concatenate([shift, pose[:, :3] - now[:, :3], turn], axis=1)
    return shift, np.concatenate([speed, target.velocity[:, row] - x.qvel[:, dof : dof + 6]], axis=1)


def _residual(scene: Scene, readings: dict[str, Array], target: Target, log: list[tuple[Forces, Array]]) -> Residual:
    """Return the residual forces and the terms of a replay that was pulled along."""
    count, rows, joints = target.joints.shape
    force = np.full((count, rows, joints + dictionary.AXES), np.nan)
    tips = len(scene.force_sensors)
    extra = np.full((count, rows, tips, 3), np.nan)
    table: list[dictionary.Terms] = []
    past, errors = None, []
    for row, (x, pulled) in enumerate(log):
        past, now = dictionary.terms(scene, past, x, np.ones((count, joints)))
        table.append(now)
        errors.append((*_error(scene, target, row, x), pulled[:, _dofs(scene)], x.effort[:, _dofs(scene)]))
        if "fingertip_force" in readings:
            extra[:, row] = readings["fingertip_force"][:, row] - x.tip_force
    shift, speed, pulled, effort = (np.stack(part, axis=1) for part in zip(*errors, strict=True))
    change = smoothed(scene, speed)[1]
    stiff, damp = _servo(scene, effort)
    inertia = scene.model.dof_M0[_dofs(scene)]
    known = inertia * change + stiff * shift + damp * speed + pulled
    force[:, : known.shape[1], _known(scene)] = known
    if "fingertip_force" in readings:
        force[:, : len(log), _known(scene)] -= _contact(scene, log, np.nan_to_num(extra[:, : len(log)]))
    force = np.where(target.seen, force, np.nan)
    position = np.stack([x.qpos[:, scene.joint_qpos] for x, _ in log], axis=1)
    felt = np.stack([x.tip_force for x, _ in log], axis=1)
    return Residual(
        force[:, : len(log)],
        extra[:, : len(log)],
        felt,
        np.stack([t.joint for t in table], axis=1),
        np.stack([t.object for t in table], axis=1),
        position,
    )


def _servo(scene: Scene, effort: Array) -> tuple[Array, Array]:
    """Return stiffness and damping `(E, T, D)` of servos and joints; a servo at its limit has none."""
    model = scene.model
    stiff, damp = np.zeros(model.nv), np.array(model.dof_damping, float)
    limit = np.full(model.nv, np.inf)
    pulled = [(a, joint, lever) for a, own in scene.levers.items() for joint, lever in own.items()]
    for actuator, joint, lever in pulled:
        dof = int(model.jnt_dofadr[joint])
        _, ((_, slope, speed_slope),) = affine_law(model, [actuator])
        stiff[dof] -= lever**2 * slope
        damp[dof] -= lever**2 * speed_slope
        if model.actuator_forcelimited[actuator]:
            limit[dof] = abs(lever) * model.actuator_forcerange[actuator, 1]
    dofs = _dofs(scene)
    free = np.abs(effort) < 0.999 * limit[dofs]
    own = np.array(model.dof_damping, float)[dofs]
    return np.where(free, stiff[dofs], 0.0), np.where(free, damp[dofs], own)


def _contact(scene: Scene, log: list[tuple[Forces, Array]], extra: Array) -> Array:
    """Return `(E, T, D)` generalised forces of fingertip forces `extra (E, T, F, 3)` on joints and object.

    A scene without an object has them on joints alone: what else a fingertip touches is taken to stand still. The
    recorded force of a row is the mean over the step before it, so it counts for that step.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    out = np.zeros((*extra.shape[:2], len(_dofs(scene))))
    frames, dofs = [_frame(scene, tip) for tip in range(extra.shape[2])], _dofs(scene)
    own, other = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    touched = 0 if scene.object_id is None else scene.object_id  # without an object, what does not move
    felt = np.abs(extra).sum((2, 3)) > 0
    for e, row in zip(*np.nonzero(felt[:, 1:]), strict=True):
        data.qpos[:] = log[row][0].qpos[e]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for tip in np.flatnonzero(extra[e, row + 1].any(1)).tolist():
            frame, body = frames[tip], int(scene.fingertip_bodies[tip])
            point = data.geom_xpos[frame.geoms].mean(0) if len(frame.geoms) else data.xipos[body]
            mujoco.mj_jac(model, data, own, None, point, body)
            mujoco.mj_jac(model, data, other, None, point, touched)
            axes = (data.site_xmat if frame.site else data.xmat)[frame.address].reshape(3, 3)
            out[e, row] += ((own - other).T @ (axes @ extra[e, row + 1, tip]))[dofs]
    return out


class _Frame(NamedTuple):
    """The body or site in whose axes a fingertip's force is read, and the geoms in whose middle it is taken to act."""

    address: int
    site: bool
    geoms: NDArray[np.int64]


def _frame(scene: Scene, tip: int) -> _Frame:
    """Return the frame of a fingertip."""
    model = scene.model
    sensor = int(np.flatnonzero(model.sensor_adr == scene.frame_sensors[tip, 0])[0])
    site = bool(model.sensor_objtype[sensor] == mujoco.mjtObj.mjOBJ_SITE)
    return _Frame(
        int(model.sensor_objid[sensor]), site, np.flatnonzero(model.geom_bodyid == scene.fingertip_bodies[tip])
    )
