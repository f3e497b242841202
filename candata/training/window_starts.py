"""Where the simulation of a window starts: a state in the window's past, and the path by which it reaches the present.

No recorded position tells how hard a finger presses, or how fast anything moves. So a simulation does not start at the
present: it follows the window's own past under the observer (`candata.simulate.observer`) and is then released. A toss
has nothing to settle, and an observer would spoil its flight: its state at present is fitted to its last poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.loaders import Windows
from candata.rotation import conjugate, difference, exp, multiply, normalise, rotate
from candata.scenes import Scene
from candata.scenes.traits import is_toss
from candata.simulate import followed_readings, true_state
from candata.training.forecasters import JOINTS_FED, Batch

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Rows of joint positions from whose slope their velocity at the start is taken [s]. Chosen: half of what a diagnosis
#: smooths over; what it is off by is forgotten while the past is followed.
SLOPE_S = 0.05
#: Commands before the start that effects which delay commands may remember [s]. Source: the longest `actuation_delay`.
EARLIER_S = 0.2
#: Fewest poses that a flight is fitted to, how many times the tracker's noise such a fit may leave, and the noise of a
#: tracker that the scene says nothing of [m]. Chosen: two poses explain anything; AprilTag trackers leave about 1 mm.
FEWEST_POSES, EXPLAINED, USUAL_NOISE_M = 3, 2.0, 0.001


@dataclass(frozen=True)
class WindowStarts:
    """The starts of n windows in one scene, and what each follows until its present.

    Attributes
    ----------
    lead : (n,) int64
        Native rows from the start to the present.
    qpos, qvel : (n, nq), (n, nv) float64
        State at the start.
    followed : dict of str to ndarray
        `object_pose (n, L + 1, 7)` and `joint_position (n, L + 1, J)` as they truly were, for an observer; NaN where
        nothing is known, and behind the present.
    first_row : (n,) int64
        Row of the cache at the start.
    """

    lead: Index
    qpos: Array
    qvel: Array
    followed: dict[str, Array]
    first_row: Index


def window_starts(windows: Windows, scene: Scene, batch: Batch) -> WindowStarts:
    """Return the starts of windows that play in one scene; nothing recorded after their present is read.

    Parameters
    ----------
    windows : Windows
        Where the batch came from.
    scene : Scene
        With the effects that belong to it: what its sensors add is taken off.
    batch : mapping
        `history/object_pose (n, K + 1, 7)`, which a closed loop may have made, `history_pad`, `episode` and `row`; with
        `JOINTS_FED`, joints are those of `history/joint_position (n, K + 1, J)` and not the recorded ones.
    """
    pad = np.array(batch["history_pad"], bool)
    pad[:, -1] = False
    poses = np.where(pad[..., None], np.nan, np.asarray(batch["history/object_pose"], np.float64))
    present_row = windows.cache.begin[batch["episode"]] + batch["row"]
    stride = windows.stride[batch["episode"]]
    first_step = pad.argmin(1)
    lead: Index = np.zeros_like(stride) if is_toss(scene) else (pad.shape[1] - 1 - first_step) * stride
    offsets = np.arange(int(lead.max(initial=0)) + 1)
    behind = offsets > lead[:, None]
    recorded = {}
    if scene.object_id is not None:
        steps = (pad.shape[1] - 1) + (offsets - lead[:, None]) / stride[:, None]
        recorded["object_pose"] = np.where(behind[..., None], np.nan, _between(poses, steps))
    if len(scene.joint_ids):
        rows = (present_row - lead)[:, None] + np.minimum(offsets, lead[:, None])
        recorded["joint_position"] = np.where(behind[..., None], np.nan, _joints(windows, batch, rows))
    start = true_state(scene, {name: values[:, 0] for name, values in recorded.items()}, ())
    qpos, qvel = _at_start(scene, start), np.zeros((len(lead), scene.model.nv))
    if len(scene.joint_ids):
        slope_rows = max(1, round(SLOPE_S * scene.file.rate_hz))
        around = np.arange(-slope_rows, 1) if is_toss(scene) else np.arange(slope_rows + 1)
        rows = (present_row - lead)[:, None] + around
        rows = rows.clip(windows.cache.begin[batch["episode"]][:, None], present_row[:, None])
        qvel[:, scene.joint_dof] = _slope(rows, _joints(windows, batch, rows)) * scene.file.rate_hz
    if scene.object_id is not None:
        step_s = stride / scene.file.rate_hz
        place, twist = _flight(scene, poses, step_s) if is_toss(scene) else _first_motion(poses, first_step, step_s)
        at, dof = scene.object_qpos, scene.object_dof
        qpos[:, at : at + 3] += place
        qvel[:, dof : dof + 3] = twist[:, :3]
        qvel[:, dof + 3 : dof + 6] = rotate(conjugate(qpos[:, at + 3 : at + 7]), twist[:, 3:])
    return WindowStarts(lead, qpos, qvel, followed_readings(scene, recorded, ()), present_row - lead)


def commands_from(windows: Windows, episode: Index, first_row: Index, count: int) -> Array:
    """Return the commands `(n, count, A)` of rows from `first_row (n,)` on; the first and last of an episode hold."""
    rows = first_row[:, None] + np.arange(count)
    rows = rows.clip(windows.cache.begin[episode][:, None], windows.cache.end[episode][:, None] - 1)
    if "action" not in windows.channels:
        return np.zeros((*rows.shape, 0))
    return np.asarray(windows.cache.rows["action"][rows], np.float64)


def _joints(windows: Windows, batch: Batch, rows: NDArray[np.int64]) -> Array:
    """Return joint positions `(n, R, J)` at rows of the cache, NaN where a row is not valid.

    Those that a closed loop feeds are at its steps, and straight between them.
    """
    if JOINTS_FED in batch:
        history = np.asarray(batch["history/joint_position"], np.float64)
        last = history.shape[1] - 1
        present_row = windows.cache.begin[batch["episode"]] + batch["row"]
        steps = last + (rows - present_row[:, None]) / windows.stride[batch["episode"]][:, None]
        lower = np.clip(np.floor(steps).astype(int), 0, max(last - 1, 0))
        window, share = np.arange(len(history))[:, None], np.clip(steps - lower, 0, 1)[..., None]
        return (1 - share) * history[window, lower] + share * history[window, np.minimum(lower + 1, last)]
    joints = windows.cache.rows["joint_position"][rows].astype(np.float64)
    return joints if windows.cache.all_valid else np.where(windows.cache.valid[rows][..., None], joints, np.nan)


def _at_start(scene: Scene, readings: dict[str, Array]) -> Array:
    """Return `qpos (n, nq)` of readings `(n, ...)`, the model's own where there is none."""
    count = len(next(iter(readings.values())))
    qpos = np.repeat(np.asarray(scene.model.qpos0, float)[None], count, axis=0)
    if "joint_position" in readings:
        joints = readings["joint_position"]
        qpos[:, scene.joint_qpos] = np.where(np.isfinite(joints), joints, qpos[:, scene.joint_qpos])
    if "object_pose" in readings:
        qpos[:, scene.object_qpos : scene.object_qpos + 7] = readings["object_pose"]
    return qpos


def _between(poses: Array, steps: Array) -> Array:
    """Return the poses `(n, R, 7)` at fractional steps `(n, R)` of `poses (n, K + 1, 7)`: straight, evenly turned."""
    lower = np.clip(np.floor(steps).astype(int), 0, max(poses.shape[1] - 2, 0))
    share = (steps - lower)[..., None]
    window = np.arange(len(poses))[:, None]
    before, after = poses[window, lower], poses[window, np.minimum(lower + 1, poses.shape[1] - 1)]
    # A whole step is a pose itself, whatever is missing beside it.
    before, after = np.where(share == 1, after, before), np.where(share == 0, before, after)
    turn = exp(share * difference(after[..., 3:], before[..., 3:]))
    position = (1 - share) * before[..., :3] + share * after[..., :3]
    return np.concatenate([position, normalise(multiply(turn, before[..., 3:]))], axis=-1)


def _slope(rows: NDArray[np.int64], values: Array) -> Array:
    """Return the least-squares slope `(n, J)` of values `(n, R, J)` a row; zero where it is not known."""
    centred = (rows - rows.mean(1, keepdims=True)).astype(float)
    square = (centred**2).sum(1)[:, None]
    slope = np.einsum("nr,nrj->nj", centred, values) / np.where(square > 0, square, 1.0)
    return np.nan_to_num(slope)


def _first_motion(poses: Array, first_step: Index, step_s: Array) -> tuple[Array, Array]:
    """Return a shift of zero `(n, 3)` and the velocity `(n, 6)` [m/s, rad/s] of the first step, both in the world."""
    window = np.arange(len(poses))
    before, after = poses[window, first_step], poses[window, np.minimum(first_step + 1, poses.shape[1] - 1)]
    motion = np.concatenate([after[:, :3] - before[:, :3], difference(after[:, 3:], before[:, 3:])], axis=1)
    return np.zeros((len(poses), 3)), np.nan_to_num(motion / step_s[:, None])


def _flight(scene: Scene, poses: Array, step_s: Array) -> tuple[Array, Array]:
    """Return where the position at present is less the last one `(n, 3)` [m], and the velocity `(n, 6)` there.

    The longest stretch of last poses that a parabola or a steady motion explains within the tracker's noise is fitted
    with the better of the two; else the last step tells. The turn is the mean turn over the stretch.
    """
    count, noise_m = poses.shape[1], scene.file.noise.object_pose[0] if scene.file.noise else USUAL_NOISE_M
    shift, twist = _first_motion(poses, np.full(len(poses), max(count - 2, 0)), step_s)
    open_windows = np.ones(len(poses), bool)
    turns = difference(poses[:, 1:, 3:], poses[:, :-1, 3:])
    for stretch in range(count, FEWEST_POSES - 1, -1):
        time_s = np.arange(1 - stretch, 1) * step_s[:, None]
        fits = [_line(poses[:, -stretch:, :3], time_s, acc) for acc in (np.array(scene.model.opt.gravity), np.zeros(3))]
        error = np.stack([fit[2] for fit in fits])
        error = np.where(np.isfinite(error), error, np.inf)
        better = error.argmin(0)
        explained = open_windows & (error.min(0) < EXPLAINED * noise_m)
        for kind, (position, speed, _) in enumerate(fits):
            chosen = explained & (better == kind)
            shift[chosen] = (position - poses[:, -1, :3])[chosen]
            mean_turn = turns[:, 1 - stretch :].mean(1) / step_s[:, None]
            twist[chosen] = np.concatenate([speed, mean_turn], axis=1)[chosen]
        open_windows &= ~explained
    return shift, twist


def _line(position: Array, time_s: Array, acceleration: Array) -> tuple[Array, Array, Array]:
    """Return position and velocity `(n, 3)` at time 0 of a motion under one acceleration, and what it leaves `(n,)`.

    What it leaves is the root mean square of the distances [m] per degree of freedom.
    """
    straight = position - 0.5 * acceleration * time_s[..., None] ** 2
    centred = time_s - time_s.mean(1, keepdims=True)
    speed = np.einsum("nr,nrd->nd", centred, straight) / (centred**2).sum(1)[:, None]
    middle = straight.mean(1)
    remainder = straight - middle[:, None] - centred[..., None] * speed[:, None]
    error = np.sqrt((remainder**2).sum((1, 2)) / (3 * (time_s.shape[1] - 2)))
    return middle - time_s.mean(1)[:, None] * speed, speed, error
