"""Object poses and fingertip forces that are not what the schema says: another unit, order, frame or sign."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.finding import RecordingMismatch
from candata.gap.mismatch_swaps import AT_LEAST, in_episodes
from candata.gap.recordings import Recordings
from candata.gap.starts import STILL_ROWS, reach, support_height
from candata.rotation import conjugate, normalise, rotate
from candata.scenes import Scene
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
#: Force [N] that counts as a touch once the reading out of contact is taken off, and rows of it that are needed.
TOUCH_N, TOUCH_ROWS = 0.5, 20
#: Size of forces across their main direction, as a share of that along it, from which they tell a frame. Chosen.
DIRECTIONS = 0.25
#: Share of touched readings at which the scene's fingertip must be free for the object's place to be doubted. Chosen.
MOSTLY = 0.5
#: Rows that are looked at for geometry.
LOOKED_AT = 400
#: Cosine of recorded and expected forces below which they disagree, and above which another reading of them agrees.
AGAINST, AGREES = 0.3, 0.6
#: Another reading is noted where it agrees this well, and its distance from 1 is so many times smaller.
NEARLY, NEARER = 0.95, 4.0


def pose_findings(scene: Scene, recs: Recordings) -> list[RecordingMismatch]:
    """Return what is wrong with the object's poses themselves: unit, place, order of the quaternion."""
    if "object_pose" not in recs.readings or not np.isfinite(recs.readings["object_pose"]).any():
        return []
    each = [row[np.isfinite(row).all(1)] for row in recs.readings["object_pose"]]
    if other := _other_unit(scene, recs, each):
        return [other]
    pose = _some(np.concatenate(each))
    size, extent = _size(pose), _extent(scene)
    if size > FAR_EXTENTS * extent:
        return [RecordingMismatch(
            "pose_unit", True, "object_pose lies far outside the scene", f"metres, within about {extent:.2g} m",
            f"{size:.3g} (as millimetres: {size / 1000:.3g} m)",
            "give its unit in map.yaml: `units: {object_pose: mm}`", "object_pose",
        )]  # fmt: skip
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
    units = [_length_unit(scene, _some(pose)) if len(pose) else "" for pose in each]
    unit = max(LENGTHS, key=units.count)
    some = np.array([u == unit for u in units])
    if not some.any() or not (some.all() or some.sum() >= AT_LEAST):
        return None
    size = _size(np.concatenate([pose for pose, s in zip(each, some, strict=True) if s]))
    where = "" if some.all() else f", {in_episodes(recs, some)}"
    of_these = "" if some.all() else " of these episodes"
    return RecordingMismatch(
        "pose_unit", True, f"object_pose looks like {LENGTHS[unit]}", f"metres, within about {_extent(scene):.2g} m",
        f"{size:.3g}: {1 / TO_SI[unit]:.4g} times what fits{where}",
        f"give its unit in map.yaml{of_these}: `units: {{object_pose: {unit}}}`", "object_pose",
    )  # fmt: skip


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
    return [RecordingMismatch(
        "pose_frame", True, "object_pose is in another frame than the scene",
        f"the object on or above {scene.file.support}", f"{where}, the whole time",
        "move the poses into the scene's world frame", "object_pose",
    )]  # fmt: skip


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
    return [RecordingMismatch(
        "quaternion_order", sunk, "object_pose may hold its quaternions as x y z w", "quaternions in the order w x y z",
        depth if sunk else "read as x y z w the object stands as in the scene, else turned by 180 deg",
        "list the columns in the map as px py pz qw qx qy qz", "object_pose",
    )]  # fmt: skip


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


@dataclass(frozen=True)
class Touches:
    """Rows in which recording and scene both touch.

    Attributes
    ----------
    real, nominal : (N, F, 3) float64
        Forces in the fingertips' frames [N], zero out of contact taken off the recorded ones.
    both : (N, F) bool
        Where both are touches.
    place : (N, F, 3) float64
        Fingertips in the world [m], joints as recorded.
    frame : (N, F, 3, 3) float64
        Axes of the fingertips' frames in the world, as columns.
    object : (N, 3) float64
        Recorded place of the object, NaN where there is none.
    """

    real: Array
    nominal: Array
    both: NDArray[np.bool_]
    place: Array
    frame: Array
    object: Array


def touches(scene: Scene, recs: Recordings, force: Array) -> Touches | None:
    """Return where the recording touches, with what the scene reads there.

    Parameters
    ----------
    force : (E, T, F, 3) float64
        Forces of a nominal replay [N].
    """
    if "fingertip_force" not in recs.readings or "joint_position" not in recs.readings:
        return None
    real = recs.readings["fingertip_force"] - tare(recs.readings["fingertip_force"], force)
    size = np.linalg.norm(real, axis=-1)
    rows = np.argwhere((np.nan_to_num(size) > TOUCH_N).any(2))
    rows = rows[np.isfinite(recs.readings["joint_position"][tuple(rows.T)]).all(1)]
    rows = _some(rows)
    if len(rows) < TOUCH_ROWS:
        return None
    at = tuple(rows.T)
    place, frame = tips(scene, recs.readings["joint_position"][at])
    body = (
        recs.readings["object_pose"][at][:, :3] if "object_pose" in recs.readings else np.full((len(rows), 3), np.nan)
    )
    both = (np.nan_to_num(size[at]) > TOUCH_N) & (np.linalg.norm(force[at], axis=-1) > TOUCH_N)
    return Touches(np.nan_to_num(real[at]), force[at], both, place, frame, body)


def tare(recorded: Array, nominal: Array) -> Array:
    """Return `(F, 3)` what the fingertips read while the scene touches nothing [N].

    Rows next to a touch do not count: a contact may begin or end a moment earlier in the recording.
    """
    touch = np.linalg.norm(nominal, axis=-1) >= 1e-6
    free = ~touch
    free[:, 1:] &= ~touch[:, :-1]
    free[:, :-1] &= ~touch[:, 1:]
    out = np.zeros(recorded.shape[2:])
    for tip in range(len(out)):
        rows = recorded[:, :, tip][free[:, :, tip]]
        rows = rows[np.isfinite(rows).all(1)]
        out[tip] = np.median(rows, axis=0) if len(rows) else 0.0
    return out


def free_spread(real: Array, force: Array) -> float:
    """Return the usual spread of a component of a fingertip that the scene does not touch while motions begin."""
    free = (np.linalg.norm(force[:, :STILL_ROWS], axis=-1) < 1e-6).all(1)
    begin = np.moveaxis(real[:, :STILL_ROWS], 1, -1)[free]
    begin = begin[np.isfinite(begin).all((1, 2))]
    return float(np.sqrt(np.median(begin.var(-1, ddof=1).mean(-1)))) if len(begin) else 0.0


def tips(scene: Scene, joints: Array) -> tuple[Array, Array]:
    """Return places `(N, F, 3)` [m] and axes `(N, F, 3, 3)` of the fingertips at joint positions `(N, J)`."""
    model, data = scene.model, mujoco.MjData(scene.model)
    sites = [model.site(s).id for s in scene.file.fingertip_frames or ()]
    place, frame = [], []
    for row in joints:
        data.qpos[scene.joint_qpos] = row
        mujoco.mj_kinematics(model, data)
        where = data.site_xpos[sites] if sites else data.xpos[scene.fingertip_bodies]
        axes = data.site_xmat[sites] if sites else data.xmat[scene.fingertip_bodies]
        place.append(np.array(where))
        frame.append(np.array(axes).reshape(-1, 3, 3))
    return np.stack(place), np.stack(frame)


def distance_findings(scene: Scene, t: Touches) -> list[RecordingMismatch]:
    """Return that the object is far from every fingertip that is touched while the scene's touches nothing there.

    A fingertip feels the table and other fingers, too: where the scene's touches something, no object need be near.
    """
    touched, free = np.linalg.norm(t.real, axis=-1) > TOUCH_N, np.linalg.norm(t.nominal, axis=-1) <= TOUCH_N
    if (touched & free).sum() < MOSTLY * touched.sum():
        return []
    real = touched & free
    apart = np.where(real, np.linalg.norm(t.place - t.object[:, None], axis=-1), np.nan)
    seen = np.isfinite(apart).any(1)
    if seen.sum() < TOUCH_ROWS:
        return []
    nearest = float(np.quantile(np.nanmin(apart[seen], axis=1), 0.1)) - reach(scene)
    if nearest < FAR_M:
        return []
    return [RecordingMismatch(
        "pose_frame", True, "the object is far from the fingertips that touch it", "object and hand in one frame",
        f"{nearest:.2f} m apart in contact", "move the poses into the scene's world frame (or the wrist's zero)",
        "object_pose",
    )]  # fmt: skip


def force_findings(scene: Scene, t: Touches) -> list[RecordingMismatch]:
    """Return that forces have the other sign, are in the world's frame, or in a turned one.

    Recorded forces are compared with the nominal ones where both touch, as the cosine of all rows together.
    """
    if t.both.sum() < TOUCH_ROWS:
        return []
    there = np.einsum("nfji,nfj->nfi", t.frame, t.real)
    own, world = (_cosine(v, t.nominal, t.both) for v in (t.real, there))
    readings = (
        (-own, "force_sign", "of the other sign", "turn the sign"),
        (world, "force_frame", "in the world's frame", "turn them into the fingertips' frames"),
        (-world, "force_frame", "in the world's frame and of the other sign", "turn sign and frame"),
    )
    best, kind, words, fix = max(readings)
    against = own < AGAINST and best > AGREES
    if not against and not (best > NEARLY and 1 - own > NEARER * (1 - best)):
        return _turned(scene, t)
    return [RecordingMismatch(
        kind, against, "fingertip_force is not the force on the fingertip in its own frame",
        "N, the force the object exerts on the fingertip, in the fingertip's frame",
        f"they agree with the scene when taken as {words} (cosine {best:.2f}, as given {own:.2f})", fix,
        "fingertip_force",
    )]  # fmt: skip


def _turned(scene: Scene, t: Touches) -> list[RecordingMismatch]:
    """Return fingertips whose forces agree with the scene's only when turned by a constant rotation.

    First one rotation for all of them, as one convention would make it; else their own, where that holds for most.
    """
    every = _as_turned(t.real[t.both], t.nominal[t.both])
    each = [_as_turned(t.real[t.both[:, f], f], t.nominal[t.both[:, f], f]) for f in range(t.both.shape[1])]
    names = tuple(n for n, turned in zip(scene.file.fingertips, each, strict=True) if turned)
    if not every and not names:
        return _partly_turned(t)
    which = "all fingertips" if every else ", ".join(names)
    return [RecordingMismatch(
        "force_frame", every or 2 * len(names) > t.both.any(0).sum(), "forces are in a turned frame",
        "forces in the fingertip's frame", f"they agree with the scene's only when turned ({which})",
        "give the sensors' frames as `fingertip_frames` in scene.yaml", "fingertip_force", () if every else names,
    )]  # fmt: skip


def _partly_turned(t: Touches) -> list[RecordingMismatch]:
    """Return the note that all forces agree far better when turned by one rotation, though they do not disagree."""
    real, nominal = t.real[t.both], t.nominal[t.both]
    rows = np.ones(len(real), bool)
    own, other = _cosine(real, nominal, rows), _cosine(_turn(real, nominal), nominal, rows)
    if other < NEARLY or 1 - own < NEARER * (1 - other) or own > NEARLY:
        return []
    return [RecordingMismatch(
        "force_frame", False, "forces agree with the scene's better when turned", "forces in the fingertip's frame",
        f"cosine {other:.2f} when turned, as given {own:.2f} (all fingertips)",
        "give the sensors' frames as `fingertip_frames` in scene.yaml", "fingertip_force",
    )]  # fmt: skip


def _turn(real: Array, nominal: Array) -> Array:
    """Return forces `(N, 3)` turned by the rotation that brings them nearest to others (Kabsch 1976)."""
    left, _, right = np.linalg.svd(nominal.T @ real)
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return np.asarray(real @ turn.T)


def _as_turned(real: Array, nominal: Array) -> bool:
    """Tell whether forces `(N, 3)` disagree as they are and agree after the best rotation.

    Forces of one direction say nothing of a frame: some rotation brings them to any other direction.
    """
    rows = np.ones(len(real), bool)
    if len(real) < TOUCH_ROWS or _cosine(real, nominal, rows) > AGAINST:
        return False
    if any(
        spread[1] < DIRECTIONS * spread[0] for spread in (np.linalg.svd(v, compute_uv=False) for v in (real, nominal))
    ):
        return False
    return _cosine(_turn(real, nominal), nominal, rows) > 0.85


def _cosine(a: Array, b: Array, rows: NDArray[np.bool_]) -> float:
    """Return the cosine between two sets of vectors, all rows together."""
    a, b = a[rows], b[rows]
    return float((a * b).sum() / max(np.sqrt((a**2).sum() * (b**2).sum()), 1e-12))


def _some(rows: NDArray) -> NDArray:
    """Return at most `LOOKED_AT` rows, evenly spread."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(LOOKED_AT, len(rows))).astype(int))] if len(rows) else rows
