"""What carries the whole hand, rails, hinges or both, and the commands that move the hand along a path in space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np

from candata.errors import ReachError, Where
from candata.policies import _drive as d
from candata.policies._contract import Array
from candata.policies._drive import Ids
from candata.rotation import conjugate, exp, log, multiply, rotate
from candata.scenes import Scene

#: How upright a direction must be to count as the one that lifts (cosine to the vertical).
UPRIGHT = 0.7
#: Metres that count as much as a radian when errors of place and of turning are weighed. Chosen: the length of a hand.
HAND_M = 0.15
#: Least singular value [m] of a motion that counts as possible, and the least share (squared cosine) of a direction
#: that must lie among the possible motions. Chosen: below the first, a hand moves 5 cm for a radian of the joints.
LEAST_GAIN_M, LEAST_SHARE = 0.05, 0.99
#: How far the hand may be off its path [m, rad]. Chosen: half the width of a finger, and what a grasp forgives.
MOST_OFF_M, MOST_OFF_RAD = 0.010, np.deg2rad(5.0)
#: The search ends when the hand is this near to its path everywhere [m], or after so many steps.
NEAR_M, MOST_STEPS = 1e-6, 30
#: Longest part of a path that is searched for at once [m, with radians as `HAND_M`].
STAGE_M = 0.1
#: Damping over the squared error, and its least value [m^2]. Source: T. Sugihara, "Solvability-unconcerned inverse
#: kinematics by the Levenberg-Marquardt method", IEEE T-RO 27(5), 2011, eq. 22 and section IV.
DAMPING_SHARE, LEAST_DAMPING_M2 = 0.5, 1e-8
#: Share of the way back to the start posture that each step of the search asks of what the hand does not feel. Chosen.
PULL_SHARE = 0.2
#: Command noise (1 sd) by which one rail moves the hand [m], and all hinges together move and turn it [m, rad]. Chosen:
#: the repeatability of a path of a light arm; the first is 0.4 % of a rail of 0.5 m.
NOISE_M, NOISE_RAD = 0.002, 0.004


@dataclass(frozen=True, eq=False)
class Carrier:
    """Servos that carry the whole hand, asked for motions of the hand in space.

    Attributes
    ----------
    scene : Scene
        The scene.
    columns : (n,) int64
        Columns of `action` that carry the hand: position servos of slides and hinges, from the base outwards.
    start : (A,) float64
        Commands of the open hand, at which the directions below hold.
    reach : (6,) bool
        Which way the hand can go from its start, all else held: along world x, y, z, and about them.
    axes : (R, 3) float64
        Independent directions of pure translation: those of the rails, or world axes.
    lift, away, stroke : (3,) float64, optional
        Unit vectors that lead up, away from the object, and along the support; None where the hand cannot go so.
    sideways : bool
        Whether `away` leads over the support, not up.
    noise : (n,) float64
        Most command noise of each column, 1 sd, in the command's unit.
    """

    scene: Scene
    columns: Ids
    start: Array
    reach: np.ndarray
    axes: Array
    lift: Array | None
    away: Array | None
    stroke: Array | None
    sideways: bool
    noise: Array

    @property
    def level(self) -> Array:
        """`(L, 3)` the directions of `axes` that do not lift."""
        return self.axes if self.lift is None else self.axes[np.abs(self.axes @ self.lift) <= UPRIGHT]

    def noise_of(self, hand_m: float) -> Array:
        """Return command noise `(n,)`, 1 sd, by which the hand moves by `hand_m` [m]."""
        return self.noise * (hand_m / NOISE_M)

    def commands(self, base: Array, path: Array) -> Array:
        """Return the commands `(T, A)` that move the hand along a path.

        Rails alone move by what the path asks along them, and stop at their ends as servos do. Hinges, or both, follow
        by inverse kinematics, within the limits of joints and commands; the posture depends on the place in the path
        alone, so a hand that comes back has its posture back.

        Parameters
        ----------
        base : (A,) float64
            Commands that are held; the columns of the carrier move from there.
        path : (T, 6) float64
            Displacement from the pose under `base`: translation [m, world axes], rotation vector about the mean of the
            fingertips [rad, world axes].

        Raises
        ------
        ReachError
            When hinges cannot follow: the hand would be off by more than 10 mm or 5 degrees.
        """
        out = np.repeat(np.asarray(base, float)[None], len(path), axis=0)
        if not path.any():
            return out
        chain = _Chain(self.scene, self.columns, base)
        moves = _along_rails(chain, path) if chain.slides.all() else _follow(self.scene, self.columns, chain, path)
        out[:, self.columns] += moves * chain.command_per_move
        return out


@lru_cache(maxsize=16)
def carrier(scene: Scene) -> Carrier:
    """Return what carries the hand of a scene, from the kinematics of its open hand and where the object stands."""
    start, servos = d.open_commands(scene), d.servos(scene)
    columns = np.array([c for c in d.carriers(scene) if servos[c]], int)
    columns = columns[np.argsort([scene.driven_joints[int(a)] for a in scene.actuator_ids[columns]])]
    if not len(columns):
        nothing = np.zeros((0, 3))
        return Carrier(scene, columns, start, np.zeros(6, bool), nothing, None, None, None, False, np.zeros(0))
    chain = _Chain(scene, columns, start)
    jacobian = chain.jacobian(*chain.place(np.zeros((1, len(columns)))))[0]
    possible = _possible(jacobian)
    axes = _axes(chain, possible)
    return Carrier(
        scene,
        columns,
        start,
        np.diag(possible) > LEAST_SHARE,
        axes,
        *_roles(axes, chain.stand_off),
        _noise(chain, jacobian),
    )


class _Chain:
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
        tips = scene.fingertip_bodies
        self.centre = data.xpos[tips].mean(0) if len(tips) else self.anchors[-1]
        is_there = scene.object_id is not None
        self.stand_off = self.anchors[-1] - data.xpos[scene.object_id] if is_there else np.array([-1.0, 0.0, 0.0])
        gear = model.actuator_gear[ids, 0]
        zero, unit = np.zeros(len(scene.actuator_ids)), np.zeros(len(scene.actuator_ids))
        unit[columns] = gear
        self.command_per_move = (d.holding_commands(scene, unit) - d.holding_commands(scene, zero))[columns]
        ends = (d.useful_range(scene)[columns] - base[columns, None]) / self.command_per_move[:, None]
        self.low, self.high = np.minimum(ends.min(1), 0.0), np.maximum(ends.max(1), 0.0)

    def place(self, moves: Array) -> tuple[Array, Array, Array, Array]:
        """Return where moves `(T, n)` of the joints lead.

        The turn of the hand (T, 4), its centre (T, 3), and the axes and anchors of the joints (T, n, 3).
        """
        count = len(moves)
        turn, shift = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.zeros((count, 3))
        axes, anchors = [], []
        for slides, axis, anchor, move in zip(self.slides, self.axes, self.anchors, moves.T, strict=True):
            axes.append(rotate(turn, axis))
            anchors.append(rotate(turn, anchor) + shift)
            if slides:
                shift = shift + move[:, None] * axes[-1]
            else:
                turn = multiply(turn, exp(move[:, None] * axis))
                shift = anchors[-1] - rotate(turn, anchor)
        return turn, rotate(turn, self.centre) + shift, np.stack(axes, 1), np.stack(anchors, 1)

    def jacobian(self, _: Array, centre: Array, axes: Array, anchors: Array) -> Array:
        """Return `(T, 6, n)` how the hand moves [m], and turns [as m, see `HAND_M`], with each joint."""
        moving = np.where(self.slides[:, None], axes, np.cross(axes, centre[:, None] - anchors))
        turning = np.where(self.slides[:, None], 0.0, HAND_M * axes)
        return np.concatenate([moving, turning], axis=2).swapaxes(1, 2)


def _along_rails(chain: _Chain, path: Array) -> Array:
    """Return the moves `(T, n)` of rails along a path `(T, 6)`: by what it asks along each."""
    return path[:, :3] @ np.linalg.pinv(chain.axes)


def _follow(scene: Scene, columns: Ids, chain: _Chain, path: Array) -> Array:
    """Return the moves `(T, n)` [rad, m] with which the hand follows a path `(T, 6)`.

    All rows are searched at once, each from the start posture, by way of shorter and shorter displacements: rows that
    lie near each other end near each other.
    """
    length = np.sqrt((path[:, :3] ** 2).sum(1) + ((HAND_M * path[:, 3:]) ** 2).sum(1)).max()
    stages = max(1, int(np.ceil(length / STAGE_M)))
    moves = np.zeros((len(path), len(columns)))
    for share in np.arange(1, stages + 1) / stages:
        moves = _search(chain, share * path, moves)
    _check(scene, columns, chain, path, moves)
    return moves


def _search(chain: _Chain, path: Array, moves: Array) -> Array:
    """Return the moves `(T, n)`, searched from given ones, that bring the hand nearest to a path `(T, 6)`."""
    for _ in range(MOST_STEPS):
        place = chain.place(moves)
        error = _errors(chain, path, *place[:2])
        if np.abs(error).max() < NEAR_M:
            break
        jacobian = chain.jacobian(*place)
        step = _step(jacobian, error, moves)
        stuck = ((moves <= chain.low) & (step < 0)) | ((moves >= chain.high) & (step > 0))
        if stuck.any():
            step = np.where(stuck, 0.0, _step(jacobian * ~stuck[:, None], error, moves))
        moves = np.clip(moves + step, chain.low, chain.high)
    return moves


def _errors(chain: _Chain, path: Array, turn: Array, centre: Array) -> Array:
    """Return `(T, 6)` what the hand lacks to its path [m; turning as m, see `HAND_M`]."""
    left_to_turn = log(multiply(exp(path[:, 3:]), conjugate(turn)))
    return np.concatenate([chain.centre + path[:, :3] - centre, HAND_M * left_to_turn], axis=1)


def _step(jacobian: Array, error: Array, moves: Array) -> Array:
    """Return the next change `(T, n)` of the moves: damped least squares, and back to the start where nothing shows."""
    transposed = jacobian.swapaxes(1, 2)
    damping = LEAST_DAMPING_M2 + DAMPING_SHARE * (error**2).sum(1)
    normal = jacobian @ transposed + damping[:, None, None] * np.eye(6)
    pull = -PULL_SHARE * moves
    wanted = error - (jacobian @ pull[..., None])[..., 0]
    return pull + (transposed @ np.linalg.solve(normal, wanted[..., None]))[..., 0]


def _check(scene: Scene, columns: Ids, chain: _Chain, path: Array, moves: Array) -> None:
    """Refuse moves that leave the hand too far off its path."""
    error = _errors(chain, path, *chain.place(moves)[:2])
    off_m, off_rad = (np.linalg.norm(part, axis=1) for part in (error[:, :3], error[:, 3:] / HAND_M))
    worst = int(np.argmax(np.maximum(off_m / MOST_OFF_M, off_rad / MOST_OFF_RAD)))
    if off_m[worst] <= MOST_OFF_M and off_rad[worst] <= MOST_OFF_RAD:
        return
    is_at_end = (moves[worst] <= chain.low) | (moves[worst] >= chain.high)
    names = [scene.file.actuator_names[c] for c in columns[is_at_end]]
    raise ReachError(
        f"scene {scene.name}: what carries the hand cannot follow its path",
        expected=f"within {1000 * MOST_OFF_M:.0f} mm and {np.rad2deg(MOST_OFF_RAD):.0f} degrees",
        found=f"{1000 * off_m[worst]:.0f} mm and {np.rad2deg(off_rad[worst]):.0f} degrees off after "
        f"{worst / scene.file.rate_hz:.2f} s, "
        + (f"{', '.join(names)} at the end of the range" if names else "at the end of its reach, no joint at a limit"),
        where=Where(path=scene.name),
        fix="begin with the hand farther within its reach (keyframe `open`), or play a shorter motion",
    )


def _possible(jacobian: Array) -> Array:
    """Return the projection `(6, 6)` on the motions that joints can make, from their Jacobian `(6, n)`."""
    directions, gains, _ = np.linalg.svd(jacobian, full_matrices=False)
    able = directions[:, gains > LEAST_GAIN_M]
    return able @ able.T


def _axes(chain: _Chain, possible: Array) -> Array:
    """Return `(R, 3)` directions of pure translation: the rails' where hinges add none, else world axes."""
    count = int((np.linalg.eigvalsh(possible[:3, :3]) > LEAST_SHARE).sum())
    rails = chain.axes * np.where(chain.command_per_move < 0, -1.0, 1.0)[:, None]
    if count <= chain.slides.sum():
        return rails[chain.slides]
    return np.eye(3)[np.diag(possible)[:3] > LEAST_SHARE]


def _roles(axes: Array, stand_off: Array) -> tuple[Array | None, Array | None, Array | None, bool]:
    """Return `lift`, `away`, `stroke` and `sideways` of directions `(R, 3)` for a hand that stands off so `(3,)`."""
    if not len(axes):
        return None, None, None, False
    upright, along = int(np.argmax(np.abs(axes[:, 2]))), axes @ stand_off
    away = int(np.argmax(np.abs(along)))
    level = [i for i in range(len(axes)) if abs(axes[i, 2]) <= UPRIGHT]
    stroke = next((i for i in [*(i for i in level if i != away), *level]), None)
    return (
        _sign(axes[upright, 2]) * axes[upright] if abs(axes[upright, 2]) > UPRIGHT else None,
        _sign(along[away]) * axes[away],
        None if stroke is None else -_sign(along[stroke], zero=-1.0) * axes[stroke],
        away in level,
    )


def _sign(number: float, zero: float = 1.0) -> float:
    """Return +1 or -1; `zero` for none."""
    return float(np.sign(number)) or zero


def _noise(chain: _Chain, jacobian: Array) -> Array:
    """Return `(n,)` the command noise with which each rail, and all hinges together, move the hand as `NOISE_M` says.

    Parameters
    ----------
    chain : _Chain
        The joints.
    jacobian : (6, n) float64
        Of the open hand.
    """
    moving, turning = np.linalg.norm(jacobian[:3], axis=0), np.linalg.norm(jacobian[3:], axis=0) / HAND_M
    by_joint = np.minimum(NOISE_M / np.maximum(moving, 1e-9), NOISE_RAD / np.maximum(turning, 1e-9))
    together = np.where(chain.slides, 1.0, np.sqrt(max(1, (~chain.slides).sum())))
    return by_joint / together * np.abs(chain.command_per_move)
