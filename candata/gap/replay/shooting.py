"""State that was not recorded, found by shooting: the start from which the model moves as its first rows show."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.replay.memory import ACT, State, recorded_dofs
from candata.rotation import difference
from candata.scenes import Scene
from candata.simulate import rollout

Array = NDArray[np.float64]
#: Rows by which a start is judged [s], and rounds of Gauss-Newton. Chosen: a finger forgets its start in about this
#: time, and a third round changes nothing.
HORIZON_S, ROUNDS = 0.3, 2
#: Plausible size of what was not recorded, one standard deviation before anything was seen: a joint's place and speed,
#: of joints that turn and that slide [rad, rad/s; m, m/s], and an activation as a share of its range [-], or plainly
#: where it has none [rad]. Chosen wide: the first rows tell more than this.
TURN, SPIN, SHIFT_M, SPEED_MPS, RANGE_SHARE, ACTIVATION = 0.1, 1.0, 0.01, 0.1, 0.25, 0.3
#: Share of a plausible size by which slopes are differenced. Chosen.
STEP = 0.1


class Shown(NamedTuple):
    """What rows from the start on show.

    Attributes
    ----------
    commands : (E, H, A) float64
    joints, pose : (E, H, J), (E, H, 7) float64
        Recorded rows; NaN where not seen.
    joint_noise, pose_noise : (J,), (6,) float64
        Noise of one row [rad or m; m and rad].
    """

    commands: Array
    joints: Array
    pose: Array
    joint_noise: Array
    pose_noise: Array


class Unknowns(NamedTuple):
    """What is looked for: activations by their place in memory, joints by theirs in qvel, with plausible sizes."""

    activations: NDArray[np.int64]
    activation_sizes: Array
    dofs: NDArray[np.int64]
    place_sizes: Array
    speed_sizes: Array

    @property
    def sizes(self) -> Array:
        """Plausible sizes `(U,)` of activations, places and speeds."""
        return np.concatenate([self.activation_sizes, self.place_sizes, self.speed_sizes])


def unknowns(scene: Scene, moving: bool) -> Unknowns:
    """Return what no lead tells surely: integrators, and of an episode that begins in motion also filters and joints.

    A lead forgets the unknown start of filters, and of joints that were not recorded, but never all of it.
    """
    model = scene.model
    integrates = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR
    remembers = np.flatnonzero(integrates | (moving & (model.actuator_actnum == 1)))
    low, high = model.actuator_actrange[remembers].T
    limited = np.asarray(model.actuator_actlimited[remembers], bool)
    spans = np.where(limited, RANGE_SHARE * (high - low), ACTIVATION)
    dofs = np.setdiff1d(np.arange(model.nv), recorded_dofs(scene)[1]) if moving else np.zeros(0, int)
    slides = np.array([_slides(model, int(d)) for d in dofs], bool)
    return Unknowns(
        ACT + model.actuator_actadr[remembers].astype(int),
        spans,
        dofs.astype(int),
        np.where(slides, SHIFT_M, TURN),
        np.where(slides, SPEED_MPS, SPIN),
    )


def _slides(model: mujoco.MjModel, dof: int) -> bool:
    """Tell whether a degree of freedom moves along a line."""
    joint = int(model.dof_jntid[dof])
    kind = model.jnt_type[joint]
    if kind == mujoco.mjtJoint.mjJNT_FREE:
        return dof - int(model.jnt_dofadr[joint]) < 3
    return bool(kind == mujoco.mjtJoint.mjJNT_SLIDE)


def shot(scene: Scene, shown: Shown, state: State, wanted: Unknowns, threads: int = 1) -> State:
    """Return the state with what was not recorded moved to where the model follows the rows best.

    Gauss-Newton on open-loop replays of the rows, every unknown held near what the lead says by its plausible size
    (maximum a posteriori). An episode keeps its state where a step does not help.
    """
    if not len(wanted.sizes):
        return state
    prior = np.zeros((len(state.qpos), len(wanted.sizes)))
    apart = _apart(scene, shown, state, threads)
    for _ in range(ROUNDS):
        slopes = []
        for j, size in enumerate(wanted.sizes):
            step = np.zeros_like(prior)
            step[:, j] = STEP * size
            slopes.append((_apart(scene, shown, _moved(scene, state, wanted, step), threads) - apart) / STEP)
        slope = np.stack(slopes, 1)
        normal = np.einsum("euk,evk->euv", slope, slope) + np.eye(len(wanted.sizes))
        step = -np.linalg.solve(normal, (np.einsum("euk,ek->eu", slope, apart) + prior)[..., None])[..., 0]
        new = _moved(scene, state, wanted, step * wanted.sizes)
        left = _apart(scene, shown, new, threads)
        better = (left**2).sum(1) + ((prior + step) ** 2).sum(1) < (apart**2).sum(1) + (prior**2).sum(1)
        state = State(*(np.where(better[:, None], a, b) for a, b in zip(new, state, strict=True)))
        prior, apart = np.where(better[:, None], prior + step, prior), np.where(better[:, None], left, apart)
    return state


def _moved(scene: Scene, state: State, wanted: Unknowns, step: Array) -> State:
    """Return the state with its unknowns moved by `step (E, U)`."""
    qpos, qvel, memory = (values.copy() for values in state)
    acts, places = len(wanted.activations), len(wanted.dofs)
    memory[:, wanted.activations] += step[:, :acts]
    qvel[:, wanted.dofs] += step[:, acts + places :]
    if places:
        move = np.zeros(scene.model.nv)
        for e in range(len(qpos)):
            move[wanted.dofs] = step[e, acts : acts + places]
            mujoco.mj_integratePos(scene.model, qpos[e], move, 1.0)
    return State(qpos, qvel, memory)


def _apart(scene: Scene, shown: Shown, state: State, threads: int) -> Array:
    """Return `(E, K)` recorded minus replayed rows, in their noise; zero where not seen."""
    played = rollout(
        scene, shown.commands, state.qpos, state.qvel, [()] * len(state.qpos), memory=state.memory, threads=threads
    ).readings
    parts = []
    if "joint_position" in played:
        parts.append((shown.joints - played["joint_position"]) / shown.joint_noise)
    if "object_pose" in played:
        turn = difference(shown.pose[..., 3:], played["object_pose"][..., 3:])
        apart = np.concatenate([shown.pose[..., :3] - played["object_pose"][..., :3], turn], axis=-1)
        parts.append(apart / shown.pose_noise)
    return np.nan_to_num(np.concatenate([p.reshape(len(p), -1) for p in parts], axis=1))
