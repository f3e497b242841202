"""What disturbs an episode on purpose: noise on its commands, and kicks to the object or the hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError
from candata.policies import carrier, position_servo_columns
from candata.rotation import conjugate, rotate
from candata.scenes import Scene
from candata.schema.disturbance import CommandNoise, Disturbances, Kick, KickDraw

Array = NDArray[np.float64]
#: Smallest singular value of the hand's Jacobian that is inverted, as a share of the largest: along other directions
#: the joints hardly move the hand.
_LEAST_SHARE = 0.05


def check_disturbances(disturbances: Disturbances, scene: Scene) -> None:
    """Refuse disturbances of what a scene does not have.

    Raises
    ------
    UsageError
        When there is no object, no joint that carries the hand, or no position servo.
    """
    if disturbances.command_noise is not None and not len(position_servo_columns(scene)):
        raise UsageError(f"scene {scene.name} has no position servo to add noise to", fix="leave command_noise out")
    if disturbances.object_kicks is not None and scene.object_id is None:
        raise UsageError(f"scene {scene.name} has no object to kick", fix="leave object_kicks out")
    if disturbances.hand_kicks is not None and not len(carrier(scene).columns):
        raise UsageError(
            f"nothing carries the hand of scene {scene.name}, so it cannot be kicked",
            expected="an actuated joint above all fingertips",
            fix="leave hand_kicks out",
        )


def drawn_kicks(disturbances: Disturbances, rng: np.random.Generator, rows: int, rate_hz: float) -> tuple[Kick, ...]:
    """Return the kicks of an episode in the order of their times, none of which comes after the last step."""
    kicks = []
    for target, draw in (("object", disturbances.object_kicks), ("hand", disturbances.hand_kicks)):
        time_s = 0.0
        while draw is not None and (time_s := time_s + rng.uniform(*draw.interval_s)) * rate_hz < rows - 1.5:
            kicks.append(_drawn_kick(target, draw, rng, time_s))
    return tuple(sorted(kicks, key=lambda kick: kick.time_s))


def _drawn_kick(target: str, draw: KickDraw, rng: np.random.Generator, time_s: float) -> Kick:
    """Return one kick of isotropic direction."""
    directions = rng.standard_normal((2, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    speed, turn = directions * rng.uniform(0, 1, (2, 1)) * np.array([[draw.speed_m_s], [draw.turn_rad_s]]) + 0.0
    return Kick.model_validate({"time_s": time_s, "target": target, "speed_m_s": speed, "turn_rad_s": turn})


def drawn_command_noise(noise: CommandNoise, scene: Scene, rng: np.random.Generator, rows: int) -> Array:
    """Return noise to add to the commands, `(T, A)` in the actuators' units; none on motors without a servo."""
    model, size = scene.model, np.zeros(len(scene.actuator_ids))
    for column in position_servo_columns(scene).tolist():
        joint = scene.driven_joints.get(int(scene.actuator_ids[column]))
        if joint is not None and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE:
            size[column] = noise.joint_rad
    size[carrier(scene).columns] = carrier(scene).noise_of(noise.hand_m)
    return rng.standard_normal((rows, len(size))) * size


class Kicks:
    """The kicks of a batch, made ready for a run.

    Parameters
    ----------
    scene : Scene
    kicks : sequence of n sequences of Kick
        Those of each simulation.
    settle : int
        Rows before row 0.
    """

    def __init__(self, scene: Scene, kicks: Sequence[Sequence[Kick]], settle: int) -> None:
        self._scene = scene
        self._at_row: dict[int, list[tuple[int, Kick]]] = {}
        for i, episode_kicks in enumerate(kicks):
            for kick in episode_kicks:
                row = settle + round(kick.time_s * scene.file.rate_hz)
                self._at_row.setdefault(row, []).append((i, kick))

    def correct(self, row: int, state: Mapping[str, Array], touch: NDArray[np.bool_], qpos: Array, qvel: Array) -> None:
        """Add the kicks of a row to `qvel (n, nv)` in place."""
        for i, kick in self._at_row.get(row, ()):
            if kick.target == "object":
                self._kick_object(kick, qpos[i], qvel[i])
            else:
                self._kick_hand(kick, qpos[i], qvel[i])

    def _kick_object(self, kick: Kick, qpos: Array, qvel: Array) -> None:
        """Add to the velocity of a free body: along world axes, and about its own (MuJoCo manual, "free joint")."""
        at = self._scene.object_qpos
        dof = int(self._scene.model.jnt_dofadr[self._scene.model.body_jntadr[self._scene.object_id]])
        qvel[dof : dof + 3] += kick.speed_m_s
        qvel[dof + 3 : dof + 6] += rotate(conjugate(qpos[at + 3 : at + 7]), np.array(kick.turn_rad_s))

    def _kick_hand(self, kick: Kick, qpos: Array, qvel: Array) -> None:
        """Add to the velocity of the joints that carry the hand what moves it so, or comes nearest to it."""
        scene, model = self._scene, self._scene.model
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        joints = [scene.driven_joints[int(scene.actuator_ids[c])] for c in carrier(scene).columns]
        dofs = model.jnt_dofadr[joints]
        tips, body = scene.fingertip_bodies, int(model.jnt_bodyid[joints].max())
        middle = data.xpos[tips].mean(0) if len(tips) else data.xpos[body]
        jacobian = np.zeros((2, 3, model.nv))
        mujoco.mj_jac(model, data, jacobian[0], jacobian[1], middle, body)
        velocity = np.concatenate([kick.speed_m_s, kick.turn_rad_s])
        qvel[dofs] += np.linalg.pinv(jacobian.reshape(6, -1)[:, dofs], rcond=_LEAST_SHARE) @ velocity
