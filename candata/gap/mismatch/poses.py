"""Object poses that are not what the schema says, in unit, place or order, and recordings without any."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.swaps import AT_LEAST, in_episodes
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.starts import starts
from candata.rotation import conjugate, normalise, rotate
from candata.scenes import Scene
from candata.scenes.traits import is_toss, support_height
from candata.schema.contact import fingertip_contact
from candata.units import TO_SI

Array = NDArray[np.float64]
#: How far the object may lie from where contact says it is [m]: the bound of `pose_bias`, and as much again.
FAR_M = 0.2
#: Extents of the scene beyond which a pose lies far outside it, and beyond which it does where another unit of length
#: brings it back. Chosen.
FAR_EXTENTS, UNIT_EXTENTS = 10.0, 2.0
#: Units of length that poses are recorded in by mistake, in words; the smallest factor first.
LENGTHS = {"cm": "centimetres", "mm": "millimetres"}
#: Depth below the support [m] at which an orientation is not believed: three times what the largest drawn
#: `pose_rotation_bias` (0.12 rad) does to a can of 30 mm radius.
SUNK_M = 0.012
#: By how much deeper it must sink than when the quaternion is read the other way.
SUNK_RATIO = 1.8
#: Rows that are looked at for geometry.
LOOKED_AT = 400


def pose_findings(scene: Scene, recs: Recordings) -> list[RecordingMismatch]:
    """Return what is wrong with the object's poses themselves: unit, place, order of the quaternion."""
    if "object_pose" not in recs.readings or not np.isfinite(recs.readings["object_pose"]).any():
        return []
    each = [row[np.isfinite(row).all(1)] for row in recs.readings["object_pose"]]
    if other := _other_unit(scene, recs, each):
        return [other]
    pose = evenly_spread(np.concatenate(each))
    size, extent = _size(pose), _extent(scene)
    if size > FAR_EXTENTS * extent:
        return [
            RecordingMismatch(
                "pose_unit",
                True,
                "object_pose lies far outside the scene",
                f"metres, within about {extent:.2g} m",
                f"{size:.3g} (as millimetres: {size / 1000:.3g} m)",
                "give its unit in map.yaml: `units: {object_pose: mm}`",
                "object_pose",
            )
        ]
    if scene.file.support is None:
        return []
    return _place(scene, pose) or _order(scene, pose)


def _size(pose: Array) -> float:
    """Return the usual largest coordinate of poses `(N, 7)`."""
    return float(np.median(np.abs(pose[:, :3]).max(1)))


def _extent(scene: Scene) -> float:
    """Return about how far the scene reaches [m]."""
    return float(max(scene.model.stat.extent, np.abs(scene.model.qpos0).max(), 1.0))


def _other_unit(scene: Scene, recs: Recordings, each: list[Array]) -> RecordingMismatch | None:
    """Return that poses are lengths of another unit, in all episodes or in some; None where no unit brings them back.

    Parameters
    ----------
    each : list of (N, 7) float64
        Poses of each episode that were seen.
    """
    units = [_length_unit(scene, evenly_spread(pose)) if len(pose) else "" for pose in each]
    unit = max(LENGTHS, key=units.count)
    some = np.array([u == unit for u in units])
    if not some.any() or not (some.all() or some.sum() >= AT_LEAST):
        return None
    size = _size(np.concatenate([pose for pose, s in zip(each, some, strict=True) if s]))
    where = "" if some.all() else f", {in_episodes(recs, some)}"
    of_these = "" if some.all() else " of these episodes"
    return RecordingMismatch(
        "pose_unit",
        True,
        f"object_pose looks like {LENGTHS[unit]}",
        f"metres, within about {_extent(scene):.2g} m",
        f"{size:.3g}: {1 / TO_SI[unit]:.4g} times what fits{where}",
        f"give its unit in map.yaml{of_these}: `units: {{object_pose: {unit}}}`",
        "object_pose",
    )


def _length_unit(scene: Scene, pose: Array) -> str:
    """Return the unit that brings poses `(N, 7)` from far outside back to where the object is; nothing if none does."""
    size, extent = _size(pose), _extent(scene)
    over = float((lowest(scene, pose) - support_height(scene)).min()) if scene.file.support else 0.0
    if size < FAR_EXTENTS * extent and over < UNIT_EXTENTS * extent:
        return ""
    home, place = scene.model.qpos0[scene.object_qpos : scene.object_qpos + 3], np.median(pose[:, :3], axis=0)
    away = {u: float(np.linalg.norm(TO_SI[u] * place - home)) for u in LENGTHS if size * TO_SI[u] < extent}
    return min(away, key=away.__getitem__, default="")


def _place(scene: Scene, pose: Array) -> list[RecordingMismatch]:
    """Return that the object lies under its support, or above it, the whole time."""
    height = lowest(scene, pose) - support_height(scene)
    under, over = float(np.quantile(height, 0.95)), float(height.min())
    if under > -FAR_M and over < 1.0:
        return []
    where = f"{-under:.2f} m under the support" if under <= -FAR_M else f"{over:.2f} m above it"
    return [
        RecordingMismatch(
            "pose_frame",
            True,
            "object_pose is in another frame than the scene",
            f"the object on or above {scene.file.support}",
            f"{where}, the whole time",
            "move the poses into the scene's world frame",
            "object_pose",
        )
    ]


def _order(scene: Scene, pose: Array) -> list[RecordingMismatch]:
    """Return that a quaternion may be x y z w: read that way the object stands as in the scene, else turned over.

    Sure where it also sinks into its support unless read that way.
    """
    turned = np.concatenate([pose[:, :3], pose[:, [6, 3, 4, 5]]], axis=1)
    top = support_height(scene)
    given, other = (float(np.quantile(top - lowest(scene, p), 0.99)) for p in (pose, turned))
    home = np.asarray(scene.model.qpos0[scene.object_qpos + 3 : scene.object_qpos + 7])
    angles = [_apart(p[:, 3:], home) for p in (pose, turned)]
    over = bool(np.quantile(angles[0], 0.1) > 2.4 and np.median(angles[1]) < 0.5)
    sunk = given > (SUNK_M / 4 if over else SUNK_M) and given > SUNK_RATIO * max(other, 0.0)
    if not over and not sunk:
        return []
    depth = f"{1e3 * given:.1f} mm deep in its support, {max(0.0, 1e3 * other):.1f} mm when read as x y z w"
    return [
        RecordingMismatch(
            "quaternion_order",
            sunk,
            "object_pose may hold its quaternions as x y z w",
            "quaternions in the order w x y z",
            depth if sunk else "read as x y z w the object stands as in the scene, else turned by 180 deg",
            "list the columns in the map as px py pz qw qx qy qz",
            "object_pose",
        )
    ]


def _apart(a: Array, b: Array) -> Array:
    """Return the angles `(N,)` between rotations [rad]."""
    return 2 * np.arccos(np.clip(np.abs(normalise(a) @ b), 0, 1))


def lowest(scene: Scene, pose: Array) -> Array:
    """Return `(N,)` the height of the object's lowest point in poses `(N, 7)` [m].

    By the support functions of its geoms: exact for boxes, spheres, capsules, cylinders, ellipsoids; by the vertices
    of meshes; other kinds count as their bounding box.
    """
    model, down = scene.model, np.array([0.0, 0.0, -1.0])
    heights = []
    for g in scene.object_geoms:
        quat = np.asarray(model.geom_quat[g], float)
        centre = pose[:, 2] + rotate(pose[:, 3:], np.broadcast_to(model.geom_pos[g], pose[:, :3].shape))[:, 2]
        local = rotate(conjugate(pose[:, 3:]), np.broadcast_to(down, pose[:, :3].shape))
        local = rotate(np.broadcast_to(conjugate(quat), pose[:, 3:].shape), local)
        heights.append(centre - _support(model, int(g), local))
    return np.min(heights, axis=0) if heights else pose[:, 2]


def _support(model: mujoco.MjModel, g: int, d: Array) -> Array:
    """Return `(N,)` how far geom g reaches in the directions `d (N, 3)` of its own frame [m]."""
    kind, s = mujoco.mjtGeom(model.geom_type[g]), model.geom_size[g]
    across = np.sqrt(np.maximum(1 - d[:, 2] ** 2, 0))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.full(len(d), s[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return s[0] + s[1] * np.abs(d[:, 2])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return s[0] * across + s[1] * np.abs(d[:, 2])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return np.sqrt(((d * s) ** 2).sum(1))
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[g]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        return (d @ np.asarray(model.mesh_vert[start : start + count], float).T).max(1)
    box = model.geom_aabb[g]
    return d @ box[:3] + np.abs(d) @ box[3:]


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """Return the numbers of at most `most` of `count` things, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))


def evenly_spread(rows: NDArray) -> NDArray:
    """Return at most `LOOKED_AT` rows, evenly spread."""
    return rows[evenly(len(rows), LOOKED_AT)] if len(rows) else rows


#: Time before and after a touch that is left out [s]: contact may be felt by links without sensors before a fingertip
#: feels it, and servos need a few of their time constants to forget it.
BEFORE_S, AFTER_S = 0.1, 0.3
NOTE = (
    "no object_pose: where the object was is not known; joints are compared away from contact only, forces not at all"
)


def without_object(replayer: Replayer, recs: Recordings) -> Recordings:
    """Return recordings whose joints are not compared near a touch, real or simulated, and whose forces are left out.

    Where the object's place was recorded, or the scene has none, they are returned as they are.
    """
    scene = replayer.scene
    if scene.object_id is None or "object_pose" in recs.readings or is_toss(scene):
        return recs
    touch = replay_all(replayer, recs, starts(scene, recs), [()])[0]["touch"] > 0
    if "fingertip_force" in recs.readings:
        touch |= np.stack([fingertip_contact(np.nan_to_num(f)) for f in recs.readings["fingertip_force"]]).any(2)
    rate = scene.file.rate_hz
    near = widened(touch, round(BEFORE_S * rate), round(AFTER_S * rate))
    readings = {n: v for n, v in recs.readings.items() if n != "fingertip_force"}
    if "joint_position" in readings:
        readings["joint_position"] = np.where(near[:, :, None], np.nan, readings["joint_position"])
    return replace(recs, readings=readings, notes=(*recs.notes, NOTE))


def widened(flags: NDArray[np.bool_], before: int, after: int) -> NDArray[np.bool_]:
    """Return `(E, T)` flags that begin `before` rows earlier and end `after` rows later."""
    out = flags.copy()
    for shift in range(1, before + 1):
        out[:, :-shift] |= flags[:, shift:]
    for shift in range(1, after + 1):
        out[:, shift:] |= flags[:, :-shift]
    return out
