"""Defects that only the scene's own motion tells: units of both sides, orders, frames, signs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.checks._time_defects import Arrays, Damage, delay_rows, with_columns


def all_in_degrees(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with joints and commands in degrees."""
    return with_columns(arrays, **{name: np.rad2deg(arrays[name]) for name in ("joint_position", "action")})


def commands_in_degrees(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with commands in degrees."""
    return with_columns(arrays, action=np.rad2deg(arrays["action"]))


def force_divided(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with forces over `severity`: kilogram-force by default."""
    return with_columns(arrays, fingertip_force=arrays["fingertip_force"] / severity)


def tip_divided(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with the forces of the fingertip that feels most over `severity`: kilogram-force by default."""
    force = arrays["fingertip_force"].copy()
    force[:, _busiest(force)] /= severity
    return with_columns(arrays, fingertip_force=force)


def _busiest(force: NDArray) -> int:
    """Return the fingertip that feels most."""
    return int(np.argmax(np.nansum(np.abs(force), axis=(0, 2))))


def exchange_columns(*channels: str) -> Damage:
    """Return what puts two columns of channels in the place of each other: the last, and that so many before it."""

    def damage(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
        """Return arrays with two columns exchanged; the first and the last where there are fewer."""
        out = {}
        for channel in channels:
            columns = np.arange(arrays[channel].shape[1])
            other_column = max(-1 - int(severity), -len(columns))
            columns[[-1, other_column]] = columns[[other_column, -1]]
            out[channel] = arrays[channel][:, columns]
        return with_columns(arrays, **out)

    return damage


def force_turned(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose forces have their axes in another order: y z x."""
    return with_columns(arrays, fingertip_force=arrays["fingertip_force"][..., [1, 2, 0]])


def force_negated(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with the forces that fingertips exert."""
    return with_columns(arrays, fingertip_force=-arrays["fingertip_force"])


def force_mirrored(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose forces have their last axis reversed, as in a left-handed frame."""
    return with_columns(arrays, fingertip_force=arrays["fingertip_force"] * np.array([1, 1, -1]))


def quaternion_conjugated(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose quaternions turn from the world to the body."""
    return with_columns(arrays, object_pose=arrays["object_pose"] * np.array([1, 1, 1, 1, -1, -1, -1]))


def world_mirrored(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with poses in a left-handed world: its y axis points the other way."""
    return with_columns(arrays, object_pose=arrays["object_pose"] * np.array([1, -1, 1, 1, -1, 1, -1]))


def world_exchanged(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with poses in a left-handed world: x and y in the place of each other."""
    pose = arrays["object_pose"][:, [1, 0, 2, 3, 5, 4, 6]]
    return with_columns(arrays, object_pose=pose * np.array([1, 1, 1, 1, -1, -1, -1]))


def pose_lost(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with a share `severity` of the poses at the origin, as where a tracker saw nothing."""
    pose = arrays["object_pose"].copy()
    pose[rng.choice(len(pose), max(1, round(severity * len(pose))), replace=False)] = [0, 0, 0, 1, 0, 0, 0]
    return with_columns(arrays, object_pose=pose)


def force_instant(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose forces are those between two means: nearly what is read at the row, not over its step."""
    force = arrays["fingertip_force"]
    return with_columns(arrays, fingertip_force=0.5 * (force + delay_rows(force, -1)))


def joint_in_degrees(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with joints in degrees."""
    return with_columns(arrays, joint_position=np.rad2deg(arrays["joint_position"]))
