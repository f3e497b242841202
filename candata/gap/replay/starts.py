"""Where a replay starts: the state at rest or in motion of a hand, or the state before a toss hits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.gap.data.recordings import Recordings
from candata.gap.replay.hand_starts import hand_starts
from candata.rotation import conjugate, difference, exp, log, multiply, normalise
from candata.scenes import Scene
from candata.scenes.traits import is_toss, support_height

Array = NDArray[np.float64]
#: A toss is replayed from this many rows before it comes within reach of the support (Acosta, Yang, Posa 2022).
ROWS_BEFORE = 3
#: Fewest rows from which velocities are fitted.
FIT_ROWS = 4
#: Rows around the start from which rates of an object with joints are fitted: they change in flight, and rows on
#: both sides cancel the first order of that.
LOCAL_ROWS = 7
#: Share of its reach by which an object with joints clears the support before an impact is possible: what trackers and
#: models are off by, and a row of a slow fall.
MARGIN = 0.05
#: Time over which the mass centre's motion by turning alone is differenced [s].
_DIFFERENCE_S = 1e-6


@dataclass(frozen=True)
class Starts:
    """State at the row from which each episode is replayed, and the state at row 0 that leads there.

    Attributes
    ----------
    rows : (E,) int64
        First replayed row.
    qpos, qvel : (E, nq), (E, nv) float64
        State at that row.
    qpos0, qvel0 : (E, nq), (E, nv) float64
        State at row 0.
    memory, memory0 : (E, M) float64
        What actuators and plugins remember at both rows, see `candata.simulate.loop.MEMORY`.
    """

    rows: NDArray[np.int64]
    qpos: Array
    qvel: Array
    qpos0: Array
    qvel0: Array
    memory: Array
    memory0: Array

    def take(self, index: NDArray[np.int64]) -> Starts:
        """Return the starts of some episodes; an index may come more than once."""
        return Starts(*(values[index] for values in self.arrays.values()))

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which episodes `(E,)` begin in motion, so that their replay starts later."""
        return self.rows > 0

    @property
    def arrays(self) -> dict[str, NDArray]:
        """All of it by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def keys(self) -> list[bytes]:
        """What tells the start of one episode `(E)` from any other."""
        return [b"".join(values[e].tobytes() for values in self.arrays.values()) for e in range(len(self.rows))]


def joined(starts: Sequence[Starts]) -> Starts:
    """Return the starts of several sets of episodes, one after another."""
    return Starts(*(np.concatenate([s.arrays[f.name] for s in starts]) for f in fields(Starts)))


def starts(scene: Scene, recs: Recordings, moving: NDArray[np.bool_] | None = None, threads: int = 1) -> Starts:
    """Return the starts of all episodes: those of a hand by `hand_starts`, of tosses fitted to their flights.

    Where it is known which episodes of a hand begin in motion, `moving (E,)` says so.
    """
    if is_toss(scene):
        return _tosses(scene, recs)
    rows, start, first = hand_starts(scene, recs, moving, threads)
    return Starts(rows, start.qpos, start.qvel, first.qpos, first.qvel, start.memory, first.memory)


def start_notes(scene: Scene, begin: Starts) -> tuple[str, ...]:
    """Return the note that episodes begin in motion, and how many of their rows are not compared."""
    if is_toss(scene) or not begin.rows.any():
        return ()
    rows, many = int(begin.rows.max()), int((begin.rows > 0).sum())
    return (
        f"{many} of {len(begin.rows)} episodes begin in motion: their first {rows} rows "
        f"({1e3 * rows / scene.file.rate_hz:.0f} ms) tell how they move and are not compared",
    )


def _tosses(scene: Scene, recs: Recordings) -> Starts:
    """Return the fitted state before the first impact of every toss."""
    count, model = len(recs), scene.model
    qpos0 = np.repeat(np.asarray(model.qpos0, float)[None], count, axis=0)
    none = np.zeros((count, 0))
    out = Starts(
        np.zeros(count, int), qpos0.copy(), np.zeros((count, model.nv)), qpos0, np.zeros((count, model.nv)), none, none
    )
    at, dof = scene.object_qpos, scene.object_dof
    for e in range(count):
        pose = recs.readings["object_pose"][e, : recs.lengths[e]]
        hinges = recs.readings["joint_position"][e, : recs.lengths[e]] if _has_hinges(scene, recs) else None
        row, free = _before_impact(scene, pose, hinges)
        seen = pose[:free] if hinges is None else np.concatenate([pose[:free], hinges[:free]], axis=1)
        flight = np.flatnonzero(np.isfinite(seen).all(1))
        if len(flight) < FIT_ROWS:
            raise DataError(
                "too little of the flight was recorded to know how the toss begins",
                expected=f"{FIT_ROWS} poses before the impact",
                found=str(len(flight)),
                where=Where(episode=recs.ids[e], channel="object_pose"),
                fix="leave the episode out",
            )
        for target, target_v, where in ((out.qpos, out.qvel, row), (out.qpos0, out.qvel0, 0)):
            if hinges is not None:
                target[e], target_v[e] = _tumbling(scene, pose[flight], hinges[flight], flight - where)
                continue
            state = _ballistic(scene, pose[flight], flight - where)
            target[e, at : at + 7], target_v[e, dof : dof + 6] = state
        out.rows[e] = row
    return out


def _tumbling(scene: Scene, pose: Array, hinges: Array, rows: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return `qpos (nq,)` and `qvel (nv,)` at row 0 of the flight of an object with joints, seen at `rows`.

    Only its mass centre falls on a parabola. Turns and joints are fitted where they are asked for, and say where the
    object's frame is beside the centre, and how fast it moves there.
    """
    model, at, dof = scene.model, scene.object_qpos, scene.object_dof
    near = np.argsort(np.abs(rows), kind="stable")[:LOCAL_ROWS]
    near.sort()
    seen = np.repeat(np.asarray(model.qpos0, float)[None], len(rows), axis=0)
    seen[:, at : at + 7], seen[:, scene.joint_qpos] = pose, hinges
    t = rows / scene.file.rate_hz
    falling = _centres(scene, seen) - 0.5 * np.array(model.opt.gravity) * t[:, None] ** 2
    centre, speed = np.linalg.lstsq(np.stack([np.ones_like(t), t], axis=1), falling, rcond=None)[0]
    qpos, qvel = np.array(model.qpos0, float), np.zeros(model.nv)
    turn, spin = (part[3:] for part in _ballistic(scene, pose[near], rows[near]))
    joint, rate = np.linalg.lstsq(np.stack([np.ones(len(near)), t[near]], axis=1), hinges[near], rcond=None)[0]
    qpos[at : at + 3], qpos[at + 3 : at + 7], qpos[scene.joint_qpos] = 0.0, turn, joint
    qvel[dof + 3 : dof + 6], qvel[scene.joint_dof] = spin, rate
    later = qpos.copy()
    mujoco.mj_integratePos(model, later, qvel, _DIFFERENCE_S)
    offset, moved = _centres(scene, np.stack([qpos, later]))
    qpos[at : at + 3] = centre - offset
    qvel[dof : dof + 3] = speed - (moved - offset) / _DIFFERENCE_S
    return qpos, qvel


def _centres(scene: Scene, qpos: Array) -> Array:
    """Return the object's centre of mass `(n, 3)` [m] at each `qpos (n, nq)`."""
    data, out = mujoco.MjData(scene.model), np.zeros((len(qpos), 3))
    for i, q in enumerate(qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(scene.model, data)
        mujoco.mj_comPos(scene.model, data)
        out[i] = data.subtree_com[scene.object_id]
    return out


def reach(scene: Scene) -> float:
    """Return the largest distance of the object's surface from its frame's origin [m], whatever its joints do."""
    model = scene.model
    offset = np.linalg.norm(model.geom_pos[scene.object_geoms], axis=1)
    arm = np.array([_arm(scene, int(body)) for body in model.geom_bodyid[scene.object_geoms]])
    return float((arm + offset + model.geom_rbound[scene.object_geoms]).max())


def _arm(scene: Scene, body: int) -> float:
    """Return the largest distance of a link's frame from the object's frame [m]."""
    model = scene.model
    if body == scene.object_id:
        return 0.0
    first = model.body_jntadr[body]
    anchors = model.jnt_pos[first : first + model.body_jntnum[body]]
    swing = 2 * float(np.linalg.norm(anchors, axis=1).sum())
    return _arm(scene, int(model.body_parentid[body])) + float(np.linalg.norm(model.body_pos[body])) + swing


def _has_hinges(scene: Scene, recs: Recordings) -> bool:
    """Tell whether the object has joints of its own that were recorded."""
    return len(scene.joint_ids) > 0 and "joint_position" in recs.readings


def _before_impact(scene: Scene, pose: Array, hinges: Array | None) -> tuple[int, int]:
    """Return the row from which a toss is replayed, and the number of rows from which its start is fitted.

    A single body may touch once its height is less than its reach; of one with joints it is computed where it is.
    """
    if hinges is None:
        low = np.flatnonzero(np.nan_to_num(pose[:, 2], nan=np.inf) - support_height(scene) < reach(scene))
        row = max(0, (int(low[0]) if len(low) else len(pose) - 1) - ROWS_BEFORE)
        return row, max(row + 1, FIT_ROWS)
    low = np.flatnonzero(_clearance(scene, pose, hinges) < MARGIN * reach(scene))
    free = max(int(low[0]) if len(low) else len(pose), FIT_ROWS)
    return max(0, free - 1 - ROWS_BEFORE), free


def _clearance(scene: Scene, pose: Array, hinges: Array) -> Array:
    """Return the height `(T,)` of the object's lowest point above the support [m]; infinite where it was not seen.

    Boxes exactly, other shapes by their bounding spheres.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    boxes = model.geom_type[scene.object_geoms] == mujoco.mjtGeom.mjGEOM_BOX
    out = np.full(len(pose), np.inf)
    for row in np.flatnonzero(np.isfinite(pose).all(1) & np.isfinite(hinges).all(1)):
        data.qpos[scene.object_qpos : scene.object_qpos + 7] = pose[row]
        data.qpos[scene.joint_qpos] = hinges[row]
        mujoco.mj_kinematics(model, data)
        upwards = np.abs(data.geom_xmat[scene.object_geoms].reshape(-1, 3, 3)[:, 2])
        exact = (upwards * model.geom_size[scene.object_geoms]).sum(1)
        half = np.where(boxes, exact, model.geom_rbound[scene.object_geoms])
        out[row] = float((data.geom_xpos[scene.object_geoms, 2] - half).min()) - support_height(scene)
    return out


def _ballistic(scene: Scene, pose: Array, rows: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return pose `(7,)` and velocity `(6,)` at row 0 of a flight seen at `rows`: parabola and body-frame spin.

    Linear least squares on positions with gravity known; rotation as the mean body-frame spin about the pose that fits
    all rows best in the tangent space.
    """
    t = rows / scene.file.rate_hz
    gravity = np.array(scene.model.opt.gravity)
    falling = pose[:, :3] - 0.5 * gravity * t[:, None] ** 2
    design = np.stack([np.ones_like(t), t], axis=1)
    position, velocity = np.linalg.lstsq(design, falling, rcond=None)[0]
    steps = log(multiply(conjugate(pose[:-1, 3:]), pose[1:, 3:]))
    spin = steps.sum(0) / (t[-1] - t[0])
    back = multiply(pose[:, 3:], exp(-spin * t[:, None]))
    offset = difference(back, np.broadcast_to(back[0], back.shape)).mean(0)
    turn = normalise(multiply(exp(offset), back[0]))
    return np.concatenate([position, turn]), np.concatenate([velocity, spin])
