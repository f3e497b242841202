"""A grasp of a hand that nobody has described: where its fingertips meet the object, and what presses them on."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from candata.effects import _contact
from candata.policies import _drive as d
from candata.policies._carrier import carrier
from candata.policies._contract import Array
from candata.scenes import Scene
from candata.scenes.motors import affine_law

Ids = NDArray[np.int64]
#: Sum of the fingertips' forces in weights of the object, and at least so much [N]: two sides of friction 0.7 hold an
#: object from 1.4 weights in all; about three times that survives the shaking, and shows on a force sensor.
WEIGHTS, LEAST_N = 4.0, 3.0
#: Farthest fall of the object onto its support, and the gap at which it counts as touching [m].
FALL_M, TOUCH_M = 0.3, 1e-3
#: Distance that counts in the search as much as one actuator's whole range [m], and how much the forces that do not
#: cancel count beside it.
SCALE_M, BALANCE = 0.002, 5.0
#: How far from its ends each servo's range is kept at the starts of the search, as shares of it: the best of the three
#: postures found counts. Record 43.
MARGINS = (0.1, 0.2, 0.3)
#: A fingertip farther than this from the object after the search has not reached it [m].
REACHED_M = 0.01
#: A tendon couples its joints when its range is less than this share of what one of them alone can pull.
TIGHT_SHARE = 0.3


@lru_cache(maxsize=16)
def grasp(scene: Scene) -> tuple[float, ...] | None:
    """Return the commands `(A,)` that press the fingertips on the object, or None where no two of them reach it.

    The fingers' servos are searched for the posture in which the fingertips touch the object where it stands, from
    sides that balance (least squares from several starts, nearest to the model's own); the servos are then asked for
    more than that, by the joint torques J^T f of balanced forces towards the object's centre. The rest stays where it
    is.
    """
    if scene.object_id is None:
        return None
    hand = hand_of(scene, d.open_commands(scene))
    if hand is None:
        return None
    finger_columns, tips = hand.free, hand.tips
    touch_commands, distances = hand.touch()
    if (distances < REACHED_M).sum() < min(2, len(tips)):
        return None
    low, high = d.useful_range(scene)[finger_columns].T
    commands = d.open_commands(scene)
    commands[finger_columns] = np.clip(touch_commands + hand.press(touch_commands, distances), low, high)
    return tuple(commands.tolist())


def hand_of(scene: Scene, start: Array) -> Hand | None:
    """Return the kinematics of the scene's fingers about commands `(A,)`; None without servos or fingertips."""
    finger_columns = np.array([i for i in np.flatnonzero(d.servos(scene)) if i not in d.carriers(scene)], int)
    tips = [_contact.geoms(scene, tip) for tip in scene.file.fingertips]
    tips = [t for t in tips if len(t)]
    return Hand(scene, finger_columns, tips, start) if len(finger_columns) and tips else None


class Hand:
    """Kinematics of a hand beside its object, as a function of the commands of some servos."""

    def __init__(self, scene: Scene, free: Ids, tips: list[Ids], start: Array) -> None:
        self.scene, self.model, self.free, self.tips = scene, scene.model, free, tips
        self.data = mujoco.MjData(self.model)
        self.start = start
        self.qpos0 = d.start_qpos(scene, self.start)
        self.data.qpos[:] = self.qpos0
        self._drop()
        self.answer = np.linalg.pinv(self._moment())[:, : len(free)]

    def _drop(self) -> None:
        """Let the object down until it touches: it can always fall by its smallest distance to anything."""
        height_address, fallen_m = self.scene.object_qpos + 2, 0.0
        obstacle_geoms = [g for g in _contact.geoms(self.scene, None) if g not in self.scene.object_geoms]
        height = float(self.qpos0[height_address])
        while fallen_m < FALL_M:
            mujoco.mj_kinematics(self.model, self.data)
            gap = min((self._distance(int(g))[0] for g in obstacle_geoms), default=FALL_M)
            if gap < TOUCH_M:
                self.qpos0[height_address] = self.data.qpos[height_address]
                return
            fallen_m += gap
            self.data.qpos[height_address] = height - fallen_m
        self.data.qpos[height_address] = height

    def _distance(self, geom: int) -> tuple[float, Array]:
        """Return the signed distance of a geom to the object [m] and the segment `(6,)` between them."""
        distance, best_segment, segment = 1.0, np.zeros(6), np.zeros(6)
        for object_geom in self.scene.object_geoms:
            geom_distance = mujoco.mj_geomDistance(self.model, self.data, geom, int(object_geom), distance, segment)
            if geom_distance < distance:
                distance, best_segment = geom_distance, segment.copy()
        return distance, best_segment

    def tip_gap(self, first: int, second: int) -> tuple[float, Array]:
        """Return the distance of two fingertips [m] and their nearest points `(2, 3)` [m]."""
        distance, ends, segment = 1.0, np.zeros(6), np.zeros(6)
        for a in self.tips[first]:
            for b in self.tips[second]:
                pair_distance = mujoco.mj_geomDistance(self.model, self.data, int(a), int(b), distance, segment)
                if pair_distance < distance:
                    distance, ends = pair_distance, segment.copy()
        return distance, ends.reshape(2, 3)

    def _moment(self) -> Array:
        """Return `(A + C, nv)` how fast each free actuator's length, and each coupling, grows with each joint."""
        model, data = self.model, self.data
        mujoco.mj_fwdPosition(model, data)
        moment = np.zeros((model.nu, model.nv))
        mujoco.mju_sparse2dense(
            moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        equality_rows = data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        coupled_moment = data.efc_J[: data.nefc * model.nv].reshape(-1, model.nv)[equality_rows]
        return np.concatenate([moment[self.scene.actuator_ids][self.free], coupled_moment, *_tight_tendons(model)])

    def pose(self, commands: Array) -> None:
        """Put the joints where the servos rest; tendons pull their joints alike, couplings and limits hold."""
        model, commands_all = self.model, self.start.copy()
        commands_all[self.free] = commands
        length_change = d.lengths(self.scene, commands_all)[self.free] - d.lengths(self.scene, self.start)[self.free]
        self.data.qpos[:] = self.qpos0
        mujoco.mj_integratePos(model, self.data.qpos, self.answer @ length_change, 1.0)
        for joint in np.flatnonzero(model.jnt_limited):
            at = model.jnt_qposadr[joint]
            self.data.qpos[at] = np.clip(self.data.qpos[at], *model.jnt_range[joint])
        mujoco.mj_kinematics(model, self.data)

    def _contacts(self) -> tuple[Array, Array]:
        """Return where each fingertip is nearest to the object `(F, 3)` [m], and how far from it `(F,)` [m]."""
        nearest_pairs = [min((self._distance(int(g)) for g in tip), key=lambda pair: pair[0]) for tip in self.tips]
        return np.array([segment[:3] for _, segment in nearest_pairs]), np.array([gap for gap, _ in nearest_pairs])

    def _forces(self, points: Array) -> Array:
        """Return `(F, 3)` forces towards the object's centre whose sizes sum to 1 and that cancel as far as they can.

        What the object lies on pushes back too, where nothing will lift the object off it: a palm that holds it up.
        """
        inward = self.data.xpos[self.scene.object_id] - points
        inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), mujoco.mjMINVAL)
        count = len(points)
        # A heavy row keeps the sum of the sizes at 1; light ones spread the load over all fingertips.
        rows = np.concatenate([inward.T, 100 * np.ones((1, count)), 0.3 * np.eye(count)])
        if carrier(self.scene).lift is None:
            rows = np.column_stack([rows, np.arange(3 + 1 + count) == 2])
        sizes, _ = nnls(rows, 100.0 * (np.arange(len(rows)) == 3))
        return inward * sizes[:count, None]

    def touch(self) -> tuple[Array, Array]:
        """Return the commands at which the fingertips come nearest to touching, and the distances left [m]."""
        low, high = d.useful_range(self.scene)[self.free].T
        span = high - low
        start_share = np.clip((self.start[self.free] - low) / span, 0.0, 1.0)

        def errors(share: Array) -> Array:
            self.pose(low + share * span)
            points, gaps = self._contacts()
            return np.concatenate([gaps / SCALE_M, BALANCE * self._forces(points).sum(0), share - start_share])

        starts = [np.clip(start_share, margin, 1 - margin) for margin in MARGINS]
        ends = [least_squares(errors, s, bounds=(0.0, 1.0), diff_step=1e-4, max_nfev=40) for s in starts]
        best_commands = low + min(ends, key=lambda end: float(end.cost)).x * span
        self.pose(best_commands)
        return best_commands, self._contacts()[1]

    def press(self, commands: Array, distances: Array) -> Array:
        """Return how much more to ask of the servos, so that the fingertips that touch press on the object."""
        self.pose(commands)
        mujoco.mj_comPos(self.model, self.data)
        weight = float(self.model.body_subtreemass[self.scene.object_id] * np.linalg.norm(self.model.opt.gravity))
        reached_tips = np.flatnonzero(distances < REACHED_M)
        points = self._contacts()[0][reached_tips]
        torque, jacobian = np.zeros(self.model.nv), np.zeros((3, self.model.nv))
        for tip, point, force in zip(reached_tips, points, self._forces(points), strict=True):
            body = int(self.model.geom_bodyid[self.tips[tip][0]])
            mujoco.mj_jac(self.model, self.data, jacobian, None, point, body)
            torque += jacobian.T @ force * max(WEIGHTS * weight, LEAST_N)
        return self.answer.T @ torque / affine_law(self.model, self.scene.actuator_ids[self.free])[0]


def _tight_tendons(model: mujoco.MjModel) -> list[Array]:
    """Return `(1, nv)` of each tendon that couples joints: fixed, and limited to a small part of what they can pull."""
    out = []
    for tendon in np.flatnonzero(model.tendon_limited):
        span = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if (model.wrap_type[span] != mujoco.mjtWrap.mjWRAP_JOINT).any():
            continue
        row, pulls = np.zeros((1, model.nv)), []
        for joint, coefficient in zip(model.wrap_objid[span], model.wrap_prm[span], strict=True):
            row[0, model.jnt_dofadr[joint]] = coefficient
            pulls.append(abs(coefficient) * np.ptp(model.jnt_range[joint]))
        if len(pulls) > 1 and np.ptp(model.tendon_range[tendon]) < TIGHT_SHARE * max(pulls):
            out.append(row / np.linalg.norm(row))
    return out
