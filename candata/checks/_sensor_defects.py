"""Defects of sensors and trackers: forces, contact flags, poses and joints that read wrong values."""

from __future__ import annotations

import numpy as np

from candata.checks._time_defects import Arrays, delay_rows, rows_of, with_columns
from candata.schema.channels import QUATERNION


def contact_inverted(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which contact is flagged where there is none, and the other way round."""
    names = [n for n in ("fingertip_contact", "contact") if n in arrays]
    return arrays | {name: ~arrays[name].astype(bool) for name in names}


def force_in_grams(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with forces times `severity`: gram-force by default."""
    return with_columns(arrays, fingertip_force=arrays["fingertip_force"] * severity)


def force_late(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose forces come `severity` seconds late."""
    return with_columns(arrays, fingertip_force=delay_rows(arrays["fingertip_force"], rows_of(rate_hz, severity)))


def force_drift(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose forces drift from 0 to `severity` newton along the fingertips' normal (their last axis)."""
    force = arrays["fingertip_force"].copy()
    force[..., 2] += np.linspace(0, severity, len(force))[:, None]
    return with_columns(arrays, fingertip_force=force)


def finger_dead(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which one fingertip, the one that touches most, reads nothing."""
    force = arrays["fingertip_force"].copy()
    tip = int(np.argmax(np.nansum(np.abs(force), axis=(0, 2))))
    force[:, tip] = 0
    return with_columns(arrays, fingertip_force=force)


def force_saturated(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which no component of a force is larger than `severity` N: the sensors' full scale."""
    return with_columns(arrays, fingertip_force=np.clip(arrays["fingertip_force"], -severity, severity))


def force_nan(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with NaN in a share `severity` of the forces' rows, at least one."""
    force = arrays["fingertip_force"].copy()
    rows = rng.choice(len(force), max(1, int(severity * len(force))), replace=False)
    force[rows, int(rng.integers(force.shape[1]))] = np.nan
    return with_columns(arrays, fingertip_force=force)


def pose_in_millimetres(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with the object's place times `severity`: millimetres by default."""
    return with_columns(arrays, object_pose=arrays["object_pose"] * np.r_[[severity] * 3, [1] * 4])


def quaternion_not_unit(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose quaternions have the norm 1 + `severity`."""
    return with_columns(arrays, object_pose=arrays["object_pose"] * np.r_[[1] * 3, [1 + severity] * 4])


def quaternion_swapped(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose quaternions are x y z w."""
    return arrays | {n: arrays[n][:, [0, 1, 2, 4, 5, 6, 3]] for n in QUATERNION if n in arrays}


def encoder_spiked(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which one joint's reading is `severity` radian less in two rows, each by itself."""
    joint = arrays["joint_position"].copy()
    rows = 2 + rng.choice((len(joint) - 4) // 4, 2, replace=False) * 4
    joint[rows, int(rng.integers(joint.shape[1]))] -= severity
    return with_columns(arrays, joint_position=joint)


def joint_stuck(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which the fastest joint's reading is repeated for `severity` rows where it moves fastest."""
    joint, rows = arrays["joint_position"].copy(), int(severity)
    ways = np.abs(joint[rows + 4 : -4] - joint[4 : -rows - 4])
    start, fastest = np.unravel_index(np.nanargmax(ways), ways.shape)
    joint[start + 4 : start + 4 + rows, fastest] = joint[start + 4, fastest]
    return with_columns(arrays, joint_position=joint)


def supply_sagged(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with a supply of 12 V that falls by a share `severity` where commands move most."""
    command = np.nan_to_num(arrays["action"].astype(np.float64))
    load = np.abs(np.gradient(command, axis=0)).sum(axis=1)
    sag = severity * load / max(float(load.max(initial=0.0)), np.finfo(float).tiny)
    voltage = np.repeat(12.0 * (1 - sag)[:, None], command.shape[1], axis=1)
    return arrays | {"supply_voltage": voltage.astype(np.float32)}


def torque_off(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which the first actuator does not drive in the last share `severity` of the rows."""
    torque_on = np.ones(arrays["action"].shape, bool)
    torque_on[round((1 - severity) * len(torque_on)) :, 0] = False
    return arrays | {"torque_on": torque_on}


def joint_beyond_limits(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays in which all joints are off by `severity` radian."""
    return with_columns(arrays, joint_position=arrays["joint_position"] + severity)


def object_sunk(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with the object `severity` metres lower."""
    return with_columns(arrays, object_pose=arrays["object_pose"] - np.r_[0, 0, severity, 0, 0, 0, 0])


def object_far(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays with the object `severity` metres to the side."""
    return with_columns(arrays, object_pose=arrays["object_pose"] + np.r_[severity, 0, 0, 0, 0, 0, 0])


def fall_scaled(arrays: Arrays, rate_hz: float, severity: float, rng: np.random.Generator) -> Arrays:
    """Return arrays whose object falls with `1 - severity` of gravity: heights scaled."""
    return with_columns(arrays, object_pose=arrays["object_pose"] * np.r_[1, 1, 1 - severity, 1, 1, 1, 1])
