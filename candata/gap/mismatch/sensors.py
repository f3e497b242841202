"""Fingertip forces that are not what the scene and the object's place say: another frame, another sign."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.poses import FAR_M, evenly_spread
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.replay.hand_starts import STILL_ROWS
from candata.gap.replay.starts import reach
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Force [N] that counts as a touch once the reading out of contact is taken off, and rows of it that are needed.
TOUCH_N, TOUCH_ROWS = 0.5, 20
#: Size of forces across their main direction, as a share of that along it, from which they tell a frame. Chosen.
DIRECTIONS = 0.25
#: Share of touched readings at which the scene's fingertip must be free for the object's place to be doubted. Chosen.
MOSTLY = 0.5
#: Cosine of recorded and expected forces below which they disagree, and above which another reading of them agrees.
AGAINST, AGREES = 0.3, 0.6
#: Another reading is noted where it agrees this well, and its distance from 1 is so many times smaller.
NEARLY, NEARER = 0.95, 4.0


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
    rows = evenly_spread(rows)
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
    return [
        RecordingMismatch(
            "pose_frame",
            True,
            "the object is far from the fingertips that touch it",
            "object and hand in one frame",
            f"{nearest:.2f} m apart in contact",
            "move the poses into the scene's world frame (or the wrist's zero)",
            "object_pose",
        )
    ]


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
    return [
        RecordingMismatch(
            kind,
            against,
            "fingertip_force is not the force on the fingertip in its own frame",
            "N, the force the object exerts on the fingertip, in the fingertip's frame",
            f"they agree with the scene when taken as {words} (cosine {best:.2f}, as given {own:.2f})",
            fix,
            "fingertip_force",
        )
    ]


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
    return [
        RecordingMismatch(
            "force_frame",
            every or 2 * len(names) > t.both.any(0).sum(),
            "forces are in a turned frame",
            "forces in the fingertip's frame",
            f"they agree with the scene's only when turned ({which})",
            "give the sensors' frames as `fingertip_frames` in scene.yaml",
            "fingertip_force",
            () if every else names,
        )
    ]


def _partly_turned(t: Touches) -> list[RecordingMismatch]:
    """Return the note that all forces agree far better when turned by one rotation, though they do not disagree."""
    real, nominal = t.real[t.both], t.nominal[t.both]
    rows = np.ones(len(real), bool)
    own, other = _cosine(real, nominal, rows), _cosine(_turn(real, nominal), nominal, rows)
    if other < NEARLY or 1 - own < NEARER * (1 - other) or own > NEARLY:
        return []
    return [
        RecordingMismatch(
            "force_frame",
            False,
            "forces agree with the scene's better when turned",
            "forces in the fingertip's frame",
            f"cosine {other:.2f} when turned, as given {own:.2f} (all fingertips)",
            "give the sensors' frames as `fingertip_frames` in scene.yaml",
            "fingertip_force",
        )
    ]


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
