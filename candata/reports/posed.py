"""Poses of a scene's bodies and fingertips in each row of an episode, by forward kinematics alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.datasets.elements import joint_labels
from candata.errors import UsageError, Where
from candata.reports.camera import SHOWN_GROUPS
from candata.scenes import Scene
from candata.scenes.assemble import subtree
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Rows posed at a time: what bounds the memory of a long episode.
ROWS = 2048


@dataclass(frozen=True)
class PosedRows:
    """Some rows of an episode.

    Attributes
    ----------
    rows : (K,) int64
        Rows of the episode; those without valid joints or object are left out.
    position, quaternion : (K, B, 3), (K, B, 4) float64 [m], w x y z
        Of the shown bodies, in the world.
    tip, frame : (K, F, 3), (K, F, 3, 3) float64 [m]
        Where the fingertips are, and the axes that their forces are given in (columns).
    """

    rows: NDArray[np.int64]
    position: Array
    quaternion: Array
    tip: Array
    frame: Array


@dataclass(frozen=True)
class ScenePoser:
    """Which entry of the model's positions comes from which column of the episode.

    Attributes
    ----------
    scene : Scene
    bodies : tuple of int
        Ids of bodies with something to show, without the object's where the episode has no pose of it.
    joints : tuple of (int, int)
        Column of `joint_position` and address in qpos.
    with_object : bool
        Whether the object's pose is in the episode.
    missing_joints : tuple of str
        Joints of the scene that the episode lacks; they stay where the model has them.
    unknown_joints : tuple of str
        Joints of the episode that the scene lacks.
    """

    scene: Scene
    bodies: tuple[int, ...]
    joints: tuple[tuple[int, int], ...]
    with_object: bool
    missing_joints: tuple[str, ...]
    unknown_joints: tuple[str, ...]

    @property
    def tip_count(self) -> int:
        """Number of the scene's fingertips."""
        return len(self.scene.file.fingertips)

    def chunks(self, episode: Episode) -> Iterator[PosedRows]:
        """Yield the posed rows of an episode, a few thousand at a time."""
        rows = self.valid_rows(episode)
        for start in range(0, len(rows), ROWS):
            yield self.pose(episode, rows[start : start + ROWS])

    def valid_rows(self, episode: Episode) -> NDArray[np.int64]:
        """Return the rows in which joints and object are valid, as far as the episode has them."""
        valid = np.ones(len(episode), bool)
        for channel in ("joint_position",) * bool(self.joints) + ("object_pose",) * self.with_object:
            valid &= episode.valid(channel)
        return np.flatnonzero(valid)

    def pose(self, episode: Episode, rows: NDArray[np.int64]) -> PosedRows:
        """Return some of the valid rows, posed."""
        model, bodies = self.scene.model, list(self.bodies)
        data, qpos = mujoco.MjData(model), self.qpos(episode, rows)
        position, quaternion = np.empty((len(rows), len(bodies), 3)), np.empty((len(rows), len(bodies), 4))
        count = self.tip_count
        tip, frame = np.empty((len(rows), count, 3)), np.empty((len(rows), count, 3, 3))
        for k, values in enumerate(qpos):
            data.qpos[:] = values
            mujoco.mj_kinematics(model, data)
            position[k], quaternion[k] = data.xpos[bodies], data.xquat[bodies]
            for i in range(count):
                tip[k, i], frame[k, i] = self._tip(data, i)
        return PosedRows(rows, position, quaternion, tip, frame)

    def qpos(self, episode: Episode, rows: NDArray[np.int64]) -> Array:
        """Return the model's positions `(K, nq)` in some rows."""
        qpos = np.tile(self.scene.model.qpos0, (len(rows), 1))
        for column, address in self.joints:
            qpos[:, address] = episode["joint_position"][rows, column]
        if self.with_object:
            qpos[:, self.scene.object_qpos : self.scene.object_qpos + 7] = episode["object_pose"][rows]
        return qpos

    def _tip(self, data: mujoco.MjData, index: int) -> tuple[Array, Array]:
        """Return where a fingertip is, and the axes of its force."""
        model, file = self.scene.model, self.scene.file
        body = int(self.scene.fingertip_bodies[index])
        geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, file.fingertips[index])
        is_body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, file.fingertips[index]) >= 0
        position = data.xpos[body] if is_body or geom < 0 else data.geom_xpos[geom]
        axes = data.site(file.fingertip_frames[index]).xmat if file.fingertip_frames else data.xmat[body]
        return position.copy(), np.array(axes).reshape(3, 3)


def poser(scene: Scene, episode: Episode) -> ScenePoser:
    """Return how the episode poses the scene: joints by name, by place where it states no names.

    Raises
    ------
    UsageError
        When the episode's joints are not the scene's.
    """
    address = dict(zip(scene.file.joints, scene.joint_qpos.tolist(), strict=True))
    columns: tuple[str, ...] = ()
    if "joint_position" in episode:
        count = episode["joint_position"].shape[1]
        by_place = not episode.meta.joint_names and count == len(address)
        columns = tuple(address) if by_place else joint_labels(episode.meta, count)
    joints = tuple((i, address[name]) for i, name in enumerate(columns) if name in address)
    if columns and address and not joints:
        raise UsageError(
            "the episode's joints are not those of the scene",
            expected=", ".join(address),
            found=", ".join(columns),
            where=Where(episode=episode.meta.id),
            fix="give the scene of this hand: --scene NAME or scene.yaml",
        )
    with_object = scene.object_id is not None and "object_pose" in episode
    hidden_bodies = set() if with_object or scene.object_id is None else subtree(scene.model, scene.object_id)
    bodies = sorted({int(scene.model.geom_bodyid[g]) for g in shown_geoms(scene.model)} - hidden_bodies)
    missing_joints = tuple(name for name in address if name not in columns)
    unknown_joints = tuple(name for name in columns if name not in address)
    return ScenePoser(scene, tuple(bodies), joints, with_object, missing_joints, unknown_joints)


def shown_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the ids of the geoms that a viewer of MuJoCo would show."""
    return [g for g in range(model.ngeom) if model.geom_group[g] < SHOWN_GROUPS]
