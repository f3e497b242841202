"""What no recorded position tells of a start: activations, delays, and joints that were not recorded."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.replay.smoother import half_rows
from candata.rotation import normalise
from candata.scenes import Scene
from candata.simulate import Prescribed, Trajectory, rollout
from candata.simulate.loop import memory_size

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Time for which a model is held at its first recorded pose, so that what hangs on it comes to rest [s]. Chosen: ten
#: time constants of MuJoCo's default constraints, five of a finger's springs.
SETTLE_S = 0.5
#: Share of its speed that what was not recorded keeps each row while the model settles. Chosen.
KEPT = 0.7
#: Rows of a recording that lead a moving model to its start, where something was not recorded [s], the time constants
#: of filters that it lasts, and the longest lead. Chosen: after three, a twentieth of what was not known remains.
LEAD_S, CONSTANTS, LONGEST_S = 0.15, 3.0, 0.5
#: Where activations begin in what a model remembers: after the time, see `candata.simulate.loop.MEMORY`.
ACT = 1


def recorded_dofs(scene: Scene) -> tuple[Index, Index]:
    """Return the addresses in qpos and in qvel of joints and object, as a recording tells them."""
    qpos, dofs = [scene.joint_qpos], [scene.joint_dof]
    if scene.object_id is not None:
        qpos.append(scene.object_qpos + np.arange(7))
        dofs.append(scene.object_dof + np.arange(6))
    return np.concatenate(qpos).astype(int), np.concatenate(dofs).astype(int)


def hides_state(scene: Scene) -> bool:
    """Tell whether the model has a state that no recorded position tells."""
    return memory_size(scene.model) > 0 or len(recorded_dofs(scene)[1]) < scene.model.nv


def lead_rows(scene: Scene) -> int:
    """Return how many rows of a moving episode lead to its start: those that the smoother needs at least.

    Filters forget their unknown start in a few of their time constants, delays once they have heard all commands.
    """
    rate, model = scene.file.rate_hz, scene.model
    if not hides_state(scene):
        return half_rows(rate)
    filters = np.isin(model.actuator_dyntype, (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT))
    forgets = CONSTANTS * model.actuator_dynprm[filters, 0].max(initial=0.0) + model.actuator_delay.max(initial=0.0)
    return max(half_rows(rate), round(min(max(LEAD_S, forgets), LONGEST_S) * rate))


class State(NamedTuple):
    """State at a row: `qpos (E, nq)`, `qvel (E, nv)` and what is remembered `(E, M)`."""

    qpos: Array
    qvel: Array
    memory: Array

    def take(self, index: NDArray) -> State:
        """Return the state of some episodes."""
        return State(self.qpos[index], self.qvel[index], self.memory[index])


def settled(scene: Scene, qpos: Array, commands: Array, threads: int = 1) -> State:
    """Return the state of models held at recorded poses until all else rests.

    Parameters
    ----------
    scene : Scene
    qpos : (E, nq) float64
        Recorded poses; what was not recorded as the model has it.
    commands : (E, A) float64
        Held all the while.
    threads : int
        Threads of the pool.
    """
    rows = max(2, round(SETTLE_S * scene.file.rate_hz))
    at, dofs = recorded_dofs(scene)
    path = np.repeat(qpos[:, None, at], rows, axis=1)
    still = np.zeros((len(qpos), rows, len(dofs)))
    played = _held(scene, np.repeat(commands[:, None], rows, axis=1), qpos, still[:, 0], path, still, KEPT, threads)
    state = _last(scene, played, qpos)
    # The last row was reached by a step in which the recorded joints were free.
    state.qpos[:, at], state.qvel[:, dofs] = qpos[:, at], 0.0
    return state


def led_state(scene: Scene, commands: Array, state: State, path: Array, speed: Array, threads: int = 1) -> State:
    """Return the state at the end of a path along which the recorded joints are led.

    Parameters
    ----------
    scene : Scene
    commands : (E, L + 1, A) float64
        Those of the path's rows.
    state : State
        State at its first row.
    path, speed : (E, L + 1, P), (E, L + 1, V) float64
        Positions and velocities of what was recorded, see `recorded_dofs`.
    threads : int
        Threads of the pool.
    """
    played = _held(scene, commands, state.qpos, speed[:, 0], path, speed, 1.0, threads, state.memory)
    return _last(scene, played, state.qpos)


def integrated(scene: Scene, state: State, qacc: Array, commands: Array) -> Array:
    """Return the memory `(E, M)` with the activations of integrating actuators that make the recorded motion.

    An integrator never forgets where it began, so no lead tells it. Its force does: what inverse dynamics ask for,
    less what the other actuators give (MuJoCo `mj_inverse`; manual, "Actuation model": gain times activation plus
    bias).

    Parameters
    ----------
    scene : Scene
    state : State
        The recorded motion at one row, and what else is remembered.
    qacc : (E, nv) float64
        Its acceleration.
    commands : (E, A) float64
        Commands at that row.
    """
    model = scene.model
    linear = np.isin(model.actuator_gaintype, (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE))
    which = np.flatnonzero((model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR) & linear)
    if not len(which):
        return state.memory
    out, data = state.memory.copy(), mujoco.MjData(model)
    others = np.setdiff1d(np.arange(model.nu), which)
    for e in range(len(qacc)):
        data.qpos[:], data.qvel[:], data.qacc[:] = state.qpos[e], state.qvel[e], qacc[e]
        data.ctrl[scene.actuator_ids] = commands[e]
        data.act[:] = state.memory[e, ACT : ACT + model.na]
        mujoco.mj_inverse(model, data)
        asked = data.qfrc_inverse.copy()
        mujoco.mj_forward(model, data)
        moment = np.zeros((model.nu, model.nv))
        rows = data.moment_rownnz, data.moment_rowadr, data.moment_colind
        mujoco.mju_sparse2dense(moment, data.actuator_moment, *rows)
        asked -= moment[others].T @ data.actuator_force[others]
        force = np.linalg.lstsq(moment[which].T, asked, rcond=None)[0]
        # A drive's own limits are left out, as the force that balances the motion lies within them.
        basis = np.stack([np.ones(len(which)), data.actuator_length[which], data.actuator_velocity[which]], axis=1)
        gain, bias = ((prm[which, :3] * basis).sum(1) for prm in (model.actuator_gainprm, model.actuator_biasprm))
        fixed = model.actuator_gaintype[which] == mujoco.mjtGain.mjGAIN_FIXED
        gain = np.where(fixed, model.actuator_gainprm[which, 0], gain)
        bias = np.where(model.actuator_biastype[which] == mujoco.mjtBias.mjBIAS_AFFINE, bias, 0.0)
        act = (force - bias) / np.where(gain == 0, np.inf, gain)
        low, high = model.actuator_actrange[which].T
        limited = np.asarray(model.actuator_actlimited[which], bool)
        out[e, ACT + model.actuator_actadr[which]] = np.where(limited, np.clip(act, low, high), act)
    return out


def _held(
    scene: Scene,
    commands: Array,
    qpos: Array,
    first_speed: Array,
    path: Array,
    speed: Array,
    kept: float,
    threads: int,
    memory: Array | None = None,
) -> Trajectory:
    """Return models whose recorded joints are set to a path row by row, while all else moves by itself."""
    at, dofs = recorded_dofs(scene)
    others = np.setdiff1d(np.arange(scene.model.nv), dofs)
    qvel = np.zeros((len(qpos), scene.model.nv))
    qvel[:, dofs] = first_speed
    prescribed = Prescribed(at, dofs, path, speed, others, kept)
    return rollout(
        scene,
        commands,
        qpos,
        qvel,
        [()] * len(qpos),
        observer=prescribed,
        keep_state=True,
        memory=memory,
        threads=threads,
    )


def _last(scene: Scene, played: Trajectory, qpos: Array) -> State:
    """Return the last state; where a simulation failed, the pose that it began from, at rest, as the model starts."""
    failed = played.failed < played.qpos.shape[1]
    last, speed, memory = played.qpos[:, -1].copy(), played.qvel[:, -1].copy(), played.memory.copy()
    last[failed], speed[failed] = qpos[failed], 0.0
    memory[failed] = played.first_memory
    if scene.object_id is not None:
        turn = slice(scene.object_qpos + 3, scene.object_qpos + 7)
        last[:, turn] = normalise(last[:, turn])
    return State(last, speed, memory)
