"""Postures, blends and noise that the scripted policies share."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.policies._contract import Array, Plan
from candata.scenes import Scene

SETTLE_S = 0.6
#: Command noise: share of each joint's range (1 sd), and its correlation time.
NOISE_SHARE, NOISE_TIME_S = 0.004, 0.08
#: Where the object starts around its place in the model (1 sd).
PLACE_SD_M = 0.003


class Postures(NamedTuple):
    """Open and closed commands `(A,)` and which columns of `action` are wrist slides."""

    open: Array
    closed: Array
    slides: NDArray[np.int64]


def postures(scene: Scene) -> Postures:
    """Return the postures of the keyframes `open` and `grasp`, or a guess from the joint ranges.

    Without keyframes the hand opens at the model's own start and closes 60 % of the way to the far end of each
    hinge's range.
    """
    model, ids = scene.model, scene.actuator_ids
    slides = np.array([i for i, a in enumerate(ids) if _is_slide(model, a)], int)
    keys = {model.key(k).name: k for k in range(model.nkey)}
    if {"open", "grasp"} <= set(keys):
        return Postures(model.key_ctrl[keys["open"]][ids], model.key_ctrl[keys["grasp"]][ids], slides)
    joints = model.actuator_trnid[ids, 0]
    start = model.qpos0[model.jnt_qposadr[joints]]
    low, high = command_range(scene).T
    far = np.where(np.abs(high - start) >= np.abs(low - start), high, low)
    closed = start + 0.6 * (far - start)
    closed[slides] = start[slides]
    return Postures(start.copy(), closed, slides)


def _is_slide(model: mujoco.MjModel, actuator: int) -> bool:
    """Tell whether an actuator drives a slide."""
    return bool(model.jnt_type[model.actuator_trnid[actuator, 0]] == mujoco.mjtJoint.mjJNT_SLIDE)


def command_range(scene: Scene) -> Array:
    """Return `(A, 2)` smallest and largest command: control range, else joint range, else +-1."""
    model, ids = scene.model, scene.actuator_ids
    joints = model.actuator_trnid[ids, 0]
    ranges = np.tile([-1.0, 1.0], (len(ids), 1))
    limited = model.jnt_limited[joints].astype(bool)
    ranges[limited] = model.jnt_range[joints][limited]
    limited = model.actuator_ctrllimited[ids].astype(bool)
    ranges[limited] = model.actuator_ctrlrange[ids][limited]
    return ranges


def blend(time_s: Array, start_s: float, length_s: float) -> Array:
    """Return `(T,)` from 0 to 1 along a minimum-jerk profile (Flash & Hogan 1985)."""
    s = np.clip((time_s - start_s) / max(length_s, 1e-6), 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)


def times(scene: Scene, duration_s: float) -> Array:
    """Return `(T,)` the times of the rows [s]."""
    return np.arange(round(duration_s * scene.file.rate_hz)) / scene.file.rate_hz


def has_hand(scene: Scene) -> bool:
    """Tell whether the scene has actuators."""
    return len(scene.actuator_ids) > 0


def has_hand_and_object(scene: Scene) -> bool:
    """Tell whether the scene has actuators and an object."""
    return has_hand(scene) and scene.object_id is not None


def finish(
    scene: Scene, commands: Array, rng: np.random.Generator, *, shift: Array | None = None, dither: bool = True
) -> Plan:
    """Return the plan with command noise, the object placed at random, and the joints at the first command.

    Parameters
    ----------
    commands : (T, A) float64
        Noise-free commands.
    shift : (3,) float64, optional
        Where the object stands besides its random place [m].
    dither : bool
        Add the command noise; without it the commands are only kept within the actuators' ranges.
    """
    ranges = command_range(scene)
    if dither:
        size = NOISE_SHARE * (ranges[:, 1] - ranges[:, 0])
        rise = blend(np.arange(len(commands), dtype=np.float64), 0, 20)[:, None]
        commands = commands + _smooth_noise(rng, commands.shape, NOISE_TIME_S * scene.file.rate_hz) * (size * rise)
    commands = np.clip(commands, ranges[:, 0], ranges[:, 1])
    qpos = np.array(scene.model.qpos0, float)
    joints = scene.model.actuator_trnid[scene.actuator_ids, 0]
    qpos[scene.model.jnt_qposadr[joints]] = commands[0]
    if scene.object_id is not None:
        at = scene.object_qpos
        qpos[at : at + 2] += PLACE_SD_M * rng.standard_normal(2)
        qpos[at : at + 3] += 0 if shift is None else shift
    return Plan(commands, qpos, np.zeros(scene.model.nv), SETTLE_S, shift)


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], correlation: float) -> Array:
    """Return unit noise that is white noise passed through a first-order low-pass."""
    keep = np.exp(-1 / max(correlation, 1e-6))
    out = np.zeros(shape)
    white = rng.standard_normal(shape) * np.sqrt(1 - keep**2)
    for k in range(1, shape[0]):
        out[k] = keep * out[k - 1] + white[k]
    return out
