"""Recorded rows put into the scene's model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.checks._view import EpisodeView
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Rows of an episode that are looked at, evenly spread.
LOOKED_AT = 60


def recorded_states(view: EpisodeView, scene: Scene, rows: NDArray[np.int64]) -> Iterator[tuple[int, mujoco.MjData]]:
    """Yield rows, thinned out, with the model as recorded in them; rows without pose or joints are left out.

    Nothing where the scene has no object, or its joints are not the episode's.
    """
    pose, joint = view.complete_values("object_pose"), view.complete_values("joint_position")
    columns = _columns(view, scene)
    if pose is None or scene.object_id is None or columns is None or (len(scene.joint_ids) and joint is None):
        return
    has_value = np.isfinite(pose[:, 0]) & (np.ones(len(pose), bool) if joint is None else np.isfinite(joint[:, 0]))
    rows = rows[has_value[rows]]
    data, couplings = mujoco.MjData(scene.model), _couplings(scene)
    for row in (
        rows[np.unique(np.linspace(0, len(rows) - 1, min(LOOKED_AT, len(rows))).astype(int))] if len(rows) else ()
    ):
        data.qpos[scene.object_qpos : scene.object_qpos + 7] = pose[row]
        if joint is not None and len(scene.joint_qpos):
            data.qpos[scene.joint_qpos] = joint[row, columns]
            for coupling in couplings:
                data.qpos[coupling.qpos] = coupling.place(data.qpos[coupling.leader])
        mujoco.mj_kinematics(scene.model, data)
        mujoco.mj_comPos(scene.model, data)
        yield int(row), data


@dataclass(frozen=True)
class _CoupledJoint:
    """A joint that an equality holds at a polynomial of a recorded one: its number, and addresses of both in qpos."""

    joint: int
    qpos: int
    leader: int
    zero: float
    leader_zero: float
    polynomial: Array

    def place(self, leader: float) -> float:
        """Return where it is (MuJoCo XML reference, "equality/joint": y - y0 = a0 + a1 (x - x0) + ...)."""
        return self.zero + float(np.polynomial.polynomial.polyval(leader - self.leader_zero, self.polynomial))


def _couplings(scene: Scene) -> list[_CoupledJoint]:
    """Return the joints that follow recorded ones; of two that only differ by a factor, either may be recorded."""
    model, recorded_joints = scene.model, set(scene.joint_ids.tolist())
    out = []
    for k in np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 > 0)):
        follower, leader, a = int(model.eq_obj1id[k]), int(model.eq_obj2id[k]), np.array(model.eq_data[k, :5], float)
        if follower in recorded_joints and leader >= 0 and leader not in recorded_joints and a[1] and not a[2:].any():
            follower, leader, a = leader, follower, np.array([-a[0] / a[1], 1 / a[1]])
        if follower in recorded_joints or leader not in recorded_joints:
            continue
        at, from_ = int(model.jnt_qposadr[follower]), int(model.jnt_qposadr[leader])
        out.append(_CoupledJoint(follower, at, from_, float(model.qpos0[at]), float(model.qpos0[from_]), a))
    return out


def unplaced_bodies(scene: Scene) -> frozenset[int]:
    """Return the bodies whose place is not known: they move by joints that were not recorded, as on springs."""
    model = scene.model
    known_joints = set(scene.joint_ids.tolist()) | {coupling.joint for coupling in _couplings(scene)}
    free: set[int] = set()
    for body in range(1, model.nbody):
        first_joint, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = set(range(first_joint, first_joint + count)) if count and body != scene.object_id else set()
        if joints - known_joints or int(model.body_parentid[body]) in free:
            free.add(body)
    return frozenset(free)


def _columns(view: EpisodeView, scene: Scene) -> list[int] | None:
    """Return the column of joint_position of each of the scene's joints; None where one is missing."""
    if not scene.file.joints:
        return []
    if "joint_position" not in view.raw.arrays:
        return None
    names = view.elements("joint_position")
    if all(j in names for j in scene.file.joints):
        return [names.index(j) for j in scene.file.joints]
    return None


def fits(view: EpisodeView, scene: Scene) -> str:
    """Return why an episode cannot be put into a scene; nothing where it can."""
    if scene.object_id is None:
        return "the scene has no object"
    return "the joints are not the scene's" if _columns(view, scene) is None else ""
