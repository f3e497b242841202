"""Defects that only the scene's own motion tells: units of both sides, orders, and stamps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray]
#: `(arrays, rate_hz, severity, rng) -> arrays`: what is stored, damaged.
Damage = Callable[[Arrays, float, float, np.random.Generator], Arrays]


def changed(arrays: Arrays, **columns: NDArray) -> Arrays:
    """Return arrays with other columns, in the type that they had."""
    return arrays | {name: np.asarray(value).astype(arrays[name].dtype) for name, value in columns.items()}


def all_in_degrees(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with joints and commands in degrees."""
    return changed(arrays, **{name: np.rad2deg(arrays[name]) for name in ("joint_position", "action")})


def commands_in_degrees(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with commands in degrees."""
    return changed(arrays, action=np.rad2deg(arrays["action"]))


def force_divided(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with forces over `severity`: kilogram-force by default."""
    return changed(arrays, fingertip_force=arrays["fingertip_force"] / severity)


def exchanged(channel: str) -> Damage:
    """Return what puts the last two columns of a channel in the place of each other."""

    def damage(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
        """Return arrays with two columns exchanged."""
        columns = np.arange(arrays[channel].shape[1])
        columns[-2:] = columns[:-3:-1]
        return changed(arrays, **{channel: arrays[channel][:, columns]})

    return damage


def stamps_scaled(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose stamps are `severity` times as far apart."""
    return arrays | {"time_ns": (arrays["time_ns"] * severity).astype(arrays["time_ns"].dtype)}


def joint_in_degrees(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with joints in degrees."""
    return changed(arrays, joint_position=np.rad2deg(arrays["joint_position"]))
