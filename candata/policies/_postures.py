"""Postures, blends and noise that the scripted policies share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.policies import _drive as d
from candata.policies._carrier import Carrier, carrier
from candata.policies._contract import Array, Plan
from candata.policies._grasp import grasp
from candata.scenes import Scene

SETTLE_S = 0.6
#: Command noise: share of each joint's range (1 sd), and its correlation time. What carries the whole hand has less
#: where `Carrier.noise` says so.
NOISE_SHARE, NOISE_TIME_S = 0.004, 0.08
#: Where the object starts around its place in the model (1 sd).
PLACE_SD_M = 0.003


class Postures(NamedTuple):
    """Commands `(A,)`: open, closed, and how far a free sweep leaves the open hand; and what carries the hand."""

    open: Array
    closed: Array
    sweep: Array
    carrier: Carrier


def postures(scene: Scene) -> Postures:
    """Return the postures of the keyframes `open` and `grasp`, or what is found from the model.

    Without keyframes the hand opens at the model's own start, and closes until its fingertips press on the object;
    where they do not reach one, it closes 60 % of the way to the far end of each range. What carries the whole hand
    stays where it is.
    """
    start = d.open_commands(scene)
    keys = {scene.model.key(k).name: k for k in range(scene.model.nkey)}
    if {"open", "grasp"} <= set(keys):
        closed_commands = np.array(scene.model.key_ctrl[keys["grasp"]][scene.actuator_ids])
        return Postures(start, closed_commands, closed_commands - start, carrier(scene))
    travel = _travel(scene, start)
    grasp_commands = grasp(scene)
    closed_commands = start + travel if grasp_commands is None else np.array(grasp_commands)
    moves_little = np.abs(closed_commands - start) < np.abs(travel) / 2
    sweep = travel if grasp_commands is None else np.where(moves_little, travel / 2, closed_commands - start)
    return Postures(start, closed_commands, sweep, carrier(scene))


def _travel(scene: Scene, start: Array) -> Array:
    """Return `(A,)` 60 % of the way to the far end of each range; none for what carries the whole hand."""
    return np.where(d.servos(scene), 0.6, d.MOTOR_SHARE) * way_to_far_end(scene, start)


def way_to_far_end(scene: Scene, start: Array) -> Array:
    """Return `(A,)` the way from `start` to the far end of each range; none for what carries the whole hand."""
    low, high = d.useful_range(scene).T
    way = np.where(np.abs(high - start) >= np.abs(low - start), high, low) - start
    way[sorted(d.carriers(scene))] = 0.0
    return way


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


def along(direction: Array | None, distance: Array) -> Array:
    """Return the path `(T, 6)` of a hand that goes `distance (T,)` [m] in a direction `(3,)`; still without one."""
    path = np.zeros((len(distance), 6))
    if direction is not None:
        path[:, :3] = distance[:, None] * direction
    return path


def finish(
    scene: Scene,
    commands: Array,
    rng: np.random.Generator,
    *,
    path: Array | None = None,
    shift: Array | None = None,
    dither: bool = True,
) -> Plan:
    """Return the plan: the hand moved along its path, command noise, the object at random, joints at the first command.

    Parameters
    ----------
    commands : (T, A) float64
        Noise-free commands.
    path : (T, 6) float64, optional
        Where the hand goes in space, see `Carrier.commands`; added to what `commands` ask of what carries it.
    shift : (3,) float64, optional
        Where the object stands besides its random place [m].
    dither : bool
        Add the command noise; without it the commands are only kept within the actuators' ranges.

    Raises
    ------
    ReachError
        When what carries the hand cannot follow the path.
    """
    ranges, hand_carrier = d.command_range(scene), carrier(scene)
    if path is not None and len(hand_carrier.columns):
        columns, start = hand_carrier.columns, hand_carrier.start
        commands = commands.copy()
        commands[:, columns] += hand_carrier.commands(start, path)[:, columns] - start[columns]
    if dither:
        size = NOISE_SHARE * (ranges[:, 1] - ranges[:, 0])
        size[hand_carrier.columns] = np.minimum(size[hand_carrier.columns], hand_carrier.noise)
        rise = blend(np.arange(len(commands), dtype=np.float64), 0, 20)[:, None]
        commands = commands + _smooth_noise(rng, commands.shape, NOISE_TIME_S * scene.file.rate_hz) * (size * rise)
    commands = np.clip(commands, ranges[:, 0], ranges[:, 1])
    qpos = d.start_qpos(scene, commands[0])
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
