"""What the observer follows: recorded motion, filled and smoothed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from candata.effects import _residual_terms as dictionary
from candata.gap.data.recordings import Recordings
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Rows of the filter that smooths and differentiates the recording (cubic): 0.1 s at 80 Hz.
WINDOW_S = 0.11


@dataclass(frozen=True)
class Target:
    """The smoothed recording: joints `(E, T, J)` and pose `(E, T, 7)` with their rates, and what was seen."""

    joints: Array
    rates: Array
    pose: Array
    velocity: Array
    seen: NDArray[np.bool_]


def followed(scene: Scene, readings: dict[str, Array], recs: Recordings) -> Target:
    """Return the smoothed recording; channels that are missing are never seen."""
    count, rows = recs.commands.shape[:2]
    joints, pose = np.zeros((count, rows, len(scene.joint_ids))), np.zeros((count, rows, 7))
    seen = np.zeros((count, rows, joints.shape[2] + dictionary.AXES), bool)
    rates, velocity = np.zeros_like(joints), np.zeros((count, rows, 6))
    if "joint_position" in readings:
        seen[:, :, : -dictionary.AXES] = np.isfinite(readings["joint_position"])
        joints, rates = smoothed(scene, _filled(readings["joint_position"]))
    if "object_pose" in readings:
        whole: NDArray[np.bool_] = np.asarray(np.isfinite(readings["object_pose"]).all(2))
        seen[:, :, -dictionary.AXES :] = whole[:, :, None]
        pose, velocity = _smooth_pose(scene, _filled(readings["object_pose"]))
    return Target(joints, rates, pose, velocity, _before_padding(scene, seen))


def _before_padding(scene: Scene, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return `(E, T, D)` what was seen, less the rows before its end that the smoothing filter mixes with padding."""
    after = np.logical_or.accumulate(seen[:, ::-1], axis=1)[:, ::-1]
    half = _window(scene, seen.shape[1]) // 2
    later = np.zeros_like(after)
    later[:, :-half] = after[:, half:]
    return seen & (later | after[:, -1:])


def _filled(values: Array) -> Array:
    """Return `(E, T, D)` with gaps held from before, the first ones from after."""
    out = values.copy()
    for row in range(1, out.shape[1]):
        out[:, row] = np.where(np.isfinite(out[:, row]), out[:, row], out[:, row - 1])
    for row in range(out.shape[1] - 2, -1, -1):
        out[:, row] = np.where(np.isfinite(out[:, row]), out[:, row], out[:, row + 1])
    return np.nan_to_num(out)


def _window(scene: Scene, rows: int) -> int:
    """Return the odd number of rows of the smoothing filter."""
    return max(5, min(2 * round(WINDOW_S * scene.file.rate_hz / 2) + 1, rows - 1 + rows % 2))


def smoothed(scene: Scene, values: Array) -> tuple[Array, Array]:
    """Return values and their rate, `(E, T, D)` each, by a local cubic (Savitzky & Golay 1964)."""
    width, step = _window(scene, values.shape[1]), 1 / scene.file.rate_hz
    if values.shape[1] < width:
        return values, np.gradient(values, step, axis=1)
    return tuple(savgol_filter(values, width, 3, deriv=d, delta=step, axis=1) for d in (0, 1))  # type: ignore[return-value]


def _smooth_pose(scene: Scene, pose: Array) -> tuple[Array, Array]:
    """Return poses and velocities (world m/s, body rad/s)."""
    quat = pose[..., 3:].copy()
    turned = np.cumprod(np.where((quat[:, 1:] * quat[:, :-1]).sum(-1) < 0, -1.0, 1.0), axis=1)
    quat[:, 1:] *= turned[..., None]
    place, speed = smoothed(scene, pose[..., :3])
    quat, change = smoothed(scene, quat)
    norm = np.maximum(np.sqrt((quat**2).sum(-1, keepdims=True)), 1e-9)
    # Body rate is twice the vector part of q* dq/dt (Sola 2017, eq. 96).
    w, u, dw, du = quat[..., :1], quat[..., 1:], change[..., :1], change[..., 1:]
    spin = 2 * (w * du - dw * u - np.cross(u, du)) / norm**2
    return np.concatenate([place, quat / norm], axis=-1), np.concatenate([speed, spin], axis=-1)
