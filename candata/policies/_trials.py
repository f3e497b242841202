"""Trials of what a policy might do, in simulation: how the object moves, and whether a grasp lifts it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from mujoco import batch as mujoco_batch

from candata.policies import _drive as d
from candata.policies import _postures as p
from candata.policies._carrier import carrier
from candata.policies._contract import Array
from candata.rotation import difference
from candata.scenes import Scene
from candata.scenes.model_file import without_log

#: Times of a trial [s]: closing, lifting, holding; and how high it lifts [m]. Chosen: as long as the fingers need.
CLOSE_S, LIFT_S, HOLD_S, LIFT_M = 0.5, 0.4, 0.3, 0.06
#: Share of the lift that the object must rise by, and stay at, to count as lifted.
LIFTED_SHARE = 0.8
#: A way by which closing fingers push the object counts this share of one by which it slips. A turn by this angle costs
#: as much as a slip by the whole lift: put down so, things fall over [rad]. What is lifted at all has the least worth.
PUSHED_SHARE, FALLEN_RAD, LEAST_WORTH = 0.3, 0.8, 0.1


class Trial(NamedTuple):
    """Commands `(A,)` of the open and closed hand, where the hand goes `(6,)`, and the object's pose `(7,)`."""

    open: Array
    closed: Array
    path: Array
    object_pose: Array


def lift_worths(scene: Scene, trials: list[Trial]) -> Array:
    """Return `(n,)` how well each trial lifted the object, from 0 (not at all) to 1 (as high as the hand, unmoved)."""
    hand, rate_hz = carrier(scene), scene.file.rate_hz
    time_s = p.times(scene, CLOSE_S + LIFT_S + HOLD_S)
    closing = p.blend(time_s, 0.0, 0.7 * CLOSE_S)[:, None]
    rising = p.along(hand.lift, LIFT_M * p.blend(time_s, CLOSE_S, LIFT_S))
    path = np.concatenate([trial.path + rising for trial in trials])
    carried = (hand.commands(hand.start, path) - hand.start).reshape(len(trials), len(time_s), -1)
    fingers = np.array([trial.open + closing * (trial.closed - trial.open) for trial in trials])
    commands = np.clip(fingers + carried, *d.command_range(scene).T)
    places, attitudes = object_motion(scene, commands, np.array([trial.object_pose for trial in trials]))
    closed_row, lifted_row = round(CLOSE_S * rate_hz), round((CLOSE_S + LIFT_S) * rate_hz)
    rise_m = places[:, -1, 2] - places[:, 0, 2]
    pushed_m = np.linalg.norm(places[:, closed_row, :2] - places[:, 0, :2], axis=1)
    slipped_m = np.linalg.norm(places[:, -1] - places[:, lifted_row], axis=1)
    turned_rad = np.linalg.norm(difference(attitudes[:, -1], attitudes[:, 0]), axis=1)
    loss = (PUSHED_SHARE * pushed_m + slipped_m) / LIFT_M + turned_rad / FALLEN_RAD
    return np.where(rise_m > LIFTED_SHARE * LIFT_M, np.maximum(1 - loss, LEAST_WORTH), 0.0)


def object_motion(scene: Scene, commands: Array, poses: Array) -> tuple[Array, Array]:
    """Return how the object moves: its mass centre `(n, T, 3)` [m] and its attitude `(n, T, 4)`, w x y z.

    Policies cannot use the stepping loop of `simulate`, which is below them: here the scene's own model is stepped as
    it is.

    Parameters
    ----------
    scene : Scene
        The scene.
    commands : (n, T, A) float64
        What the actuators take, a row a control step; the joints start at the first row.
    poses : (n, 7) float64
        Of the object at the start.
    """
    batch = mujoco_batch.Batch(scene.model, len(poses), 1)
    start = np.array([d.start_qpos(scene, rows[0]) for rows in commands])
    start[:, scene.object_qpos : scene.object_qpos + 7] = poses
    batch.bind("qpos")[:] = start
    control = np.zeros((len(start), commands.shape[1] * scene.substeps, scene.model.nu))
    control[:, :, scene.actuator_ids] = np.repeat(commands, scene.substeps, axis=1)
    with without_log():
        played = batch.rollout(control.shape[1], control, record=("xipos", "xquat"))
    rows, body = slice(None, None, scene.substeps), scene.object_id
    count = len(start), control.shape[1], -1
    return played["xipos"].reshape(*count, 3)[:, rows, body], played["xquat"].reshape(*count, 4)[:, rows, body]
