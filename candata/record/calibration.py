"""Calibration: the mean reading of an untouched, resting hand, and the refusal of any other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.errors import SetupError
from candata.record.devices._contract import States

_FIX = "leave the hand at rest and untouched, then start again with another --out; or record without, by --no-calibrate"


@dataclass(frozen=True)
class CalibrationLimits:
    """What still counts as a resting, untouched hand.

    Attributes
    ----------
    joint_range_rad : float
        Largest travel of a joint within the window [rad].
    force_spread_N : float
        Largest travel of an axis of a fingertip's force [N]: a few counts of sensor noise.
    force_level_N : float
        Largest |Fx| + |Fy| + |Fz| of a fingertip's mean [N]: more is a touch, not a bias.
    rows : float
        Least share of the expected rows.
    """

    joint_range_rad: float = 0.02
    force_spread_N: float = 0.5
    force_level_N: float = 1.0
    rows: float = 0.5


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a resting hand reads; subtract it from the counts of the same log.

    Attributes
    ----------
    force_bias_counts : (F, 3) float64
        Mean force of each fingertip in counts.
    taxel_bias_counts : (F, N, 3) float64 or None
        Mean force of each taxel in counts; None where the device has no taxels.
    rows : int
        State frames in the window.
    duration_s : float
        Length of the window [s].
    force_spread_counts : (F, 3) float64
        Travel of each axis within the window, in counts.
    joint_range_rad : (J,) float64 [rad]
        Travel of each joint within the window.
    end_ns : int or None
        Stamp of the window's last state in unix time [ns]; None in logs of versions that did not keep it.
    """

    force_bias_counts: NDArray[np.float64]
    taxel_bias_counts: NDArray[np.float64] | None
    rows: int
    duration_s: float
    force_spread_counts: NDArray[np.float64]
    joint_range_rad: NDArray[np.float64]
    end_ns: int | None = None


def calibrate(
    states: States,
    duration_s: float,
    *,
    joint_names: tuple[str, ...],
    fingertip_names: tuple[str, ...],
    newton_per_count: float,
    rate_hz: float,
    limits: CalibrationLimits | None = None,
) -> Calibration:
    """Return the mean reading of a window in which the hand rested untouched.

    Parameters
    ----------
    states : States
        All states of the window.
    duration_s : float
        Length of the window [s].
    joint_names, fingertip_names : tuple of str
        In the order of the columns.
    newton_per_count : float
        Scale of the forces [N].
    rate_hz : float
        Nominal rate of the states [Hz].
    limits : Limits, optional
        What still counts as rest.

    Raises
    ------
    SetupError
        When there are too few states, a joint moved or a fingertip was touched; names each of them.
    """
    limits = limits or CalibrationLimits()
    rows, expected = len(states.joint_position), rate_hz * duration_s
    if rows < max(2.0, limits.rows * expected):
        raise SetupError(
            "too few states to calibrate",
            expected=f"about {expected:.0f} in {duration_s:g} s",
            found=str(rows),
            fix="check the link; or record without calibration, by --no-calibrate",
        )
    travel = np.ptp(states.joint_position, axis=0)
    spread = np.ptp(states.force_counts.astype(np.float64), axis=0)
    bias = states.force_counts.mean(axis=0, dtype=np.float64)
    _refuse_motion(travel, joint_names, limits)
    _refuse_touch(spread * newton_per_count, bias * newton_per_count, fingertip_names, limits)
    taxels = states.taxel_counts
    mean = taxels.mean(axis=0, dtype=np.float64) if taxels.size else None
    return Calibration(bias, mean, rows, duration_s, spread, travel)


def to_metadata(calibration: Calibration) -> dict[str, Any]:
    """Return the calibration as plain data (lists and numbers), to be written as JSON."""
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(calibration).items()
    }


def from_metadata(values: Mapping[str, Any]) -> Calibration:
    """Return the calibration that `to_metadata` wrote.

    Raises
    ------
    KeyError, TypeError, ValueError
        When a value is missing or of the wrong kind.
    """
    taxels, end_ns = values["taxel_bias_counts"], values.get("end_ns")
    return Calibration(
        force_bias_counts=np.asarray(values["force_bias_counts"], dtype=np.float64),
        taxel_bias_counts=None if taxels is None else np.asarray(taxels, dtype=np.float64),
        rows=int(values["rows"]),
        duration_s=float(values["duration_s"]),
        force_spread_counts=np.asarray(values["force_spread_counts"], dtype=np.float64),
        joint_range_rad=np.asarray(values["joint_range_rad"], dtype=np.float64),
        end_ns=None if end_ns is None else int(end_ns),
    )


def _refuse_motion(travel: NDArray[np.float64], names: tuple[str, ...], limits: CalibrationLimits) -> None:
    """Refuse a hand of which a joint moved, naming the joints that did."""
    moved_joints = [
        f"{name} {x:.3f} rad" for name, x in zip(names, travel, strict=True) if not x <= limits.joint_range_rad
    ]
    if moved_joints:
        raise SetupError(
            "the hand moved during calibration",
            expected=f"each joint within {limits.joint_range_rad:g} rad",
            found=", ".join(moved_joints),
            fix=_FIX,
        )


def _refuse_touch(
    spread_N: NDArray[np.float64], bias_N: NDArray[np.float64], names: tuple[str, ...], limits: CalibrationLimits
) -> None:
    """Refuse a hand of which a fingertip was touched, naming the fingertips that were."""
    level_N = np.abs(bias_N).sum(axis=1)
    touched_tips = []
    for name, change, level in zip(names, spread_N.max(axis=1), level_N, strict=True):
        if change > limits.force_spread_N:
            touched_tips.append(f"{name} changed by {change:.2f} N")
        elif level > limits.force_level_N:
            touched_tips.append(f"{name} under {level:.2f} N")
    if touched_tips:
        raise SetupError(
            "the hand was touched during calibration",
            expected=f"each fingertip under {limits.force_level_N:g} N and steady to {limits.force_spread_N:g} N",
            found=", ".join(touched_tips),
            fix=_FIX,
        )
