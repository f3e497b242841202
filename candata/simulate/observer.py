"""A slow observer: pulls a replayed state towards its recording, so that errors do not pile up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.rotation import difference, exp, multiply, normalise
from candata.scenes import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observer:
    """What to follow and how fast.

    Attributes
    ----------
    recorded : mapping of str to ndarray
        `joint_position (n, T, J)`, `object_pose (n, T, 7)` as the recording says that they truly were, see `followed`;
        channels that are missing are not followed. Rows that are not finite are skipped.
    joint_gain, pose_gain : float
        Share of the error removed each control step.
    free_gain : float
        Share of the pose error removed while nothing touches the object, or the error passes the guard.
    guard_m, guard_rad : float
        Pose error from which `free_gain` applies.
    """

    recorded: Mapping[str, Array]
    joint_gain: float = 0.02
    pose_gain: float = 0.006
    free_gain: float = 0.15
    guard_m: float = 0.012
    guard_rad: float = 0.2


def correct(
    scene: Scene,
    observer: Observer,
    row: int,
    state: Mapping[str, Array],
    touch: NDArray[np.bool_],
    qpos: Array,
) -> None:
    """Pull `qpos (n, nq)` in place towards the recording at `row`; `state` is what perfect sensors read of it."""
    if "joint_position" in observer.recorded and "joint_position" in state:
        error = observer.recorded["joint_position"][:, row] - state["joint_position"]
        qpos[:, scene.joint_qpos] += observer.joint_gain * np.nan_to_num(error)
    if "object_pose" not in observer.recorded or "object_pose" not in state:
        return
    target, now = observer.recorded["object_pose"][:, row], state["object_pose"]
    seen = np.asarray(np.isfinite(target).all(1))
    target = np.where(seen[:, None], target, now)
    shift, turn = target[:, :3] - now[:, :3], difference(target[:, 3:], now[:, 3:])
    far = ((shift**2).sum(1) > observer.guard_m**2) | ((turn**2).sum(1) > observer.guard_rad**2)
    gain = np.where(far | ~touch, observer.free_gain, observer.pose_gain)[:, None]
    at = scene.object_qpos
    qpos[:, at : at + 3] += gain * shift
    qpos[:, at + 3 : at + 7] = normalise(multiply(exp(gain * turn), qpos[:, at + 3 : at + 7]))
