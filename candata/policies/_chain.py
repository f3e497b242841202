"""A row of joints that carries the hand: where it leads, and the moves that follow a path."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.policies import _drive as d
from candata.policies._contract import Array
from candata.policies._drive import Ids
from candata.scenes import Scene

#: Metres that count as much as a radian when errors of place and of turning are weighed. Chosen: the length of a hand.
HAND_M = 0.15
#: The search ends when the hand is this near to its path everywhere [m], or after so many steps. Chosen: a twentieth of
#: the noise of commands; each further step makes the rest about its square.
NEAR_M, MOST_STEPS = 1e-4, 30
#: Longest part of a path that is searched for at once [m, with radians as `HAND_M`].
STAGE_M = 0.2
#: Damping over the squared error, and its least value [m^2]. Source: T. Sugihara, "Solvability-unconcerned inverse
#: kinematics by the Levenberg-Marquardt method", IEEE T-RO 27(5), 2011; the share is chosen.
DAMPING_SHARE, LEAST_DAMPING_M2 = 0.5, 1e-8
#: Share of the way back to the start posture that each step of the search asks of what the hand does not feel. Chosen.
PULL_SHARE = 0.2


class Chain:
    """Joints `(n,)` in a row from the base outwards, as products of exponentials of their screws.

    Source: K. M. Lynch and F. C. Park, "Modern Robotics", 2017, sections 4.1.1 (space form) and 5.1.1 (Jacobian).

    Attributes
    ----------
    slides : (n,) bool
        Which joints slide.
    axes, anchors : (n, 3) float64
        World axes of the joints, and points on them [m], under the base commands.
    centre : (3,) float64
        Mean of the fingertips there [m].
    low, high : (n,) float64
        Most that each joint can move down (0 or less) and up (0 or more) [rad, m].
    command_per_move : (n,) float64
        Change of the command for a change of the joint, each in its unit.
    stand_off : (3,) float64
        From the object to the outermost joint [m]; -x without an object.
    """

    def __init__(self, scene: Scene, columns: Ids, base: Array) -> None:
        model, ids = scene.model, scene.actuator_ids[columns]
        joints = [scene.driven_joints[int(a)] for a in ids]
        data = mujoco.MjData(model)
        data.qpos[:] = d.start_qpos(scene, base)
        mujoco.mj_kinematics(model, data)
        self.slides = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
        self.axes, self.anchors = data.xaxis[joints].copy(), data.xanchor[joints].copy()
        # Rodrigues' rotation: a part that stays, one that turns with the cosine, one with the sine.
        self.cross = np.cross(self.axes[:, None], np.eye(3)).swapaxes(1, 2)
        self.outer = self.axes[:, :, None] * self.axes[:, None]
        tips, has_object = scene.fingertip_bodies, scene.object_id is not None and len(joints) > 0
        self.centre = data.xpos[tips].mean(0) if len(tips) else self.anchors.sum(0) / max(1, len(joints))
        self.stand_off = self.anchors[-1] - data.xpos[scene.object_id] if has_object else np.array([-1.0, 0.0, 0.0])
        gear = model.actuator_gear[ids, 0]
        zero, unit = np.zeros(len(scene.actuator_ids)), np.zeros(len(scene.actuator_ids))
        unit[columns] = gear
        self.command_per_move = (d.holding_commands(scene, unit) - d.holding_commands(scene, zero))[columns]
        ends = (d.useful_range(scene)[columns] - base[columns, None]) / self.command_per_move[:, None]
        self.low, self.high = np.minimum(ends.min(1), 0.0), np.maximum(ends.max(1), 0.0)

    def place(self, moves: Array) -> tuple[Array, Array, Array, Array]:
        """Return where moves `(T, n)` of the joints lead.

        The turn of the hand (T, 3, 3), its centre (T, 3), and the axes and anchors of the joints (T, n, 3).
        """
        turn, shift = np.tile(np.eye(3), (len(moves), 1, 1)), np.zeros((len(moves), 3))
        turns = _turns(self.cross, self.outer, moves)
        axes, anchors = np.zeros((2, len(moves), len(self.axes), 3))
        for joint, (slides, axis, anchor) in enumerate(zip(self.slides, self.axes, self.anchors, strict=True)):
            axes[:, joint] = turn @ axis
            anchors[:, joint] = turn @ anchor + shift
            if slides:
                shift = shift + moves[:, joint, None] * axes[:, joint]
            else:
                turn = turn @ turns[:, joint]
                shift = anchors[:, joint] - turn @ anchor
        return turn, turn @ self.centre + shift, axes, anchors

    def jacobian(self, centre: Array, axes: Array, anchors: Array) -> Array:
        """Return `(T, 6, n)` how the hand moves [m], and turns [as m, see `HAND_M`], with each joint."""
        moving = np.where(self.slides[:, None], axes, np.cross(axes, centre[:, None] - anchors))
        turning = np.where(self.slides[:, None], 0.0, HAND_M * axes)
        return np.concatenate([moving, turning], axis=2).swapaxes(1, 2)


def _turns(cross: Array, outer: Array, angle: Array) -> Array:
    """Return the rotation matrices `(..., 3, 3)` of angles about axes, whose cross and outer products are given."""
    sine, cosine = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return outer + cosine * (np.eye(3) - outer) + sine * cross


def along_rails(chain: Chain, path: Array) -> Array:
    """Return the moves `(T, n)` of rails along a path `(T, 6)`: by what it asks along each."""
    return path[:, :3] @ np.linalg.pinv(chain.axes)


def follow(chain: Chain, path: Array) -> tuple[Array, Array]:
    """Return the moves `(T, n)` [rad, m] with which the hand follows a path `(T, 6)`, and how far off it is `(T, 6)`.

    All rows are searched at once, each from the start posture by way of shares of its displacement: rows that lie near
    each other end near each other. What is off is in metres, turning as `HAND_M` says.
    """
    length = np.sqrt((path[:, :3] ** 2).sum(1) + ((HAND_M * path[:, 3:]) ** 2).sum(1)).max()
    stages = max(1, int(np.ceil(length / STAGE_M)))
    moves, error = np.zeros((len(path), len(chain.axes))), np.zeros((len(path), 6))
    for share in np.arange(1, stages + 1) / stages:
        moves, error = _search(chain, share * path, moves)
    return moves, error


def _search(chain: Chain, path: Array, moves: Array) -> tuple[Array, Array]:
    """Return the moves that bring the hand nearest to a path, searched from given ones, and how far off it is."""
    target = _matrices(path[:, 3:])
    for step_number in range(MOST_STEPS):
        turn, centre, axes, anchors = chain.place(moves)
        error = np.concatenate(
            [chain.centre + path[:, :3] - centre, HAND_M * _vectors(target @ turn.swapaxes(1, 2))], axis=1
        )
        if np.abs(error).max() < NEAR_M or step_number == MOST_STEPS - 1:
            break
        jacobian = chain.jacobian(centre, axes, anchors)
        step = _step(jacobian, error, moves)
        stuck = ((moves <= chain.low) & (step < 0)) | ((moves >= chain.high) & (step > 0))
        if stuck.any():
            step = np.where(stuck, 0.0, _step(jacobian * ~stuck[:, None], error, moves))
        moves = np.clip(moves + step, chain.low, chain.high)
    return moves, error


def _matrices(vectors: Array) -> Array:
    """Return the rotation matrices `(T, 3, 3)` of rotation vectors `(T, 3)` [rad]."""
    angle = np.linalg.norm(vectors, axis=1)
    axes = vectors / np.maximum(angle, 1e-12)[:, None]
    return _turns(np.cross(axes[:, None], np.eye(3)).swapaxes(1, 2), axes[:, :, None] * axes[:, None], angle)


def _vectors(matrices: Array) -> Array:
    """Return the rotation vectors `(T, 3)` [rad] of rotation matrices `(T, 3, 3)`."""
    sine_axis = 0.5 * (matrices[:, [2, 0, 1], [1, 2, 0]] - matrices[:, [1, 2, 0], [2, 0, 1]])
    sine = np.linalg.norm(sine_axis, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(matrices, axis1=1, axis2=2) - 1.0))
    return sine_axis * np.where(sine < 1e-12, 1.0, angle / np.maximum(sine, 1e-12))[:, None]


def _step(jacobian: Array, error: Array, moves: Array) -> Array:
    """Return the next change `(T, n)` of the moves: damped least squares, and back to the start where nothing shows."""
    transposed = jacobian.swapaxes(1, 2)
    damping = LEAST_DAMPING_M2 + DAMPING_SHARE * (error**2).sum(1)
    normal = jacobian @ transposed + damping[:, None, None] * np.eye(6)
    pull = -PULL_SHARE * moves
    wanted = error - (jacobian @ pull[..., None])[..., 0]
    return pull + (transposed @ np.linalg.solve(normal, wanted[..., None]))[..., 0]
