"""Recorded rows put into the scene's model."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.checks._view import View
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Rows of an episode that are looked at, evenly spread.
LOOKED_AT = 60


def placed(view: View, scene: Scene, rows: NDArray[np.int64]) -> Iterator[tuple[int, mujoco.MjData]]:
    """Yield rows, thinned out, with the model as recorded in them; rows without pose or joints are left out.

    Nothing where the scene has no object, or its joints are not the episode's.
    """
    pose, joint = view.whole("object_pose"), view.whole("joint_position")
    columns = _columns(view, scene)
    if pose is None or scene.object_id is None or columns is None or (len(scene.joint_ids) and joint is None):
        return
    seen = np.isfinite(pose[:, 0]) & (np.ones(len(pose), bool) if joint is None else np.isfinite(joint[:, 0]))
    rows = rows[seen[rows]]
    data = mujoco.MjData(scene.model)
    for row in (
        rows[np.unique(np.linspace(0, len(rows) - 1, min(LOOKED_AT, len(rows))).astype(int))] if len(rows) else ()
    ):
        data.qpos[scene.object_qpos : scene.object_qpos + 7] = pose[row]
        if joint is not None and len(scene.joint_qpos):
            data.qpos[scene.joint_qpos] = joint[row, columns]
        mujoco.mj_kinematics(scene.model, data)
        mujoco.mj_comPos(scene.model, data)
        yield int(row), data


def _columns(view: View, scene: Scene) -> list[int] | None:
    """Return the column of joint_position of each of the scene's joints; None where one is missing."""
    if not scene.file.joints:
        return []
    if "joint_position" not in view.raw.arrays:
        return None
    names = view.elements("joint_position")
    if all(j in names for j in scene.file.joints):
        return [names.index(j) for j in scene.file.joints]
    return None


def fits(view: View, scene: Scene) -> str:
    """Return why an episode cannot be put into a scene; nothing where it can."""
    if scene.object_id is None:
        return "the scene has no object"
    return "the joints are not the scene's" if _columns(view, scene) is None else ""
