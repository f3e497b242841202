"""Defects of time: rows that are lost or late, clocks that jump or drift, joints that stop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray]
#: `(arrays, rate_hz, severity, rng) -> arrays`: what is stored, damaged.
Damage = Callable[[Arrays, float, float, np.random.Generator], Arrays]


def with_columns(arrays: Arrays, **columns: NDArray) -> Arrays:
    """Return arrays with other columns, in the type that they had."""
    return arrays | {name: np.asarray(value).astype(arrays[name].dtype) for name, value in columns.items()}


def rows_of(rate_hz: float, seconds: float) -> int:
    """Return how many rows a time is."""
    return round(rate_hz * seconds)


def delay_rows(array: NDArray, rows: int) -> NDArray:
    """Return an array that comes `rows` rows later; the first row is held before. Earlier where negative."""
    if rows == 0:
        return array
    if rows < 0:
        return np.concatenate([array[-rows:], np.repeat(array[-1:], -rows, axis=0)])[: len(array)]
    return np.concatenate([np.repeat(array[:1], rows, axis=0), array])[: len(array)]


def rows_late(channel: str) -> Damage:
    """Return what makes a channel come `severity` rows late."""

    def damage(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
        """Return arrays with a late channel."""
        return with_columns(arrays, **{channel: delay_rows(arrays[channel], int(severity))})

    return damage


def stamps_scaled(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose stamps are `severity` times as far apart."""
    return arrays | {"time_ns": (arrays["time_ns"] * severity).astype(arrays["time_ns"].dtype)}


def joint_dead(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which the joint that moves most stands still."""
    joint = arrays["joint_position"].copy()
    moves = int(np.argmax(np.ptp(joint, axis=0)))
    joint[:, moves] = joint[0, moves]
    return with_columns(arrays, joint_position=joint)


def rows_dropped(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays that lack a share `severity` of their rows, stamps kept."""
    keep = np.ones(len(arrays["time_ns"]), bool)
    keep[rng.choice(len(keep), max(1, int(severity * len(keep))), replace=False)] = False
    return {name: array[keep] for name, array in arrays.items()}


def rows_dropped_unseen(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays that lack `severity` seconds in their middle, stamps made as if they did not."""
    total = len(arrays["time_ns"])
    lost_rows = min(rows_of(rate_hz, severity), total // 2)
    at = int(rng.integers(total // 4, total // 2))
    keep = np.r_[0:at, at + lost_rows : total]
    return {n: a[: len(keep)] if n == "time_ns" else a[keep] for n, a in arrays.items()}


def time_jump(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose clock jumps ahead by `severity` seconds in the middle."""
    time_ns = arrays["time_ns"].copy()
    time_ns[len(time_ns) // 2 :] += int(severity * 1e9)
    return arrays | {"time_ns": time_ns}


def clock_drift(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose joints and poses fall behind the commands, by `severity` seconds at the end."""
    total = len(arrays["time_ns"])
    rows = np.arange(total) - np.linspace(0, severity * rate_hz, total)
    at = np.clip(np.round(rows).astype(int), 0, total - 1)
    names = [n for n in ("joint_position", "joint_velocity", "object_pose", "fingertip_force") if n in arrays]
    return arrays | {name: arrays[name][at] for name in names}


def action_shifted(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose commands are logged `severity` rows late."""
    return with_columns(arrays, action=delay_rows(arrays["action"], int(severity)))
