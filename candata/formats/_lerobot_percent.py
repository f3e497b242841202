"""LeRobot's percent of range: joints as -100..100 of what the calibration saw, which looks like degrees and is none.

Source: lerobot, `motors/motors_bus.py`, `MotorsBus._normalize` and `MotorNormMode`. Most robots of LeRobot record it
unless they are told `use_degrees`, and grippers always.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.formats import Reading
from candata.formats._features import Pick
from candata.formats._lerobot_layout import Entry
from candata.formats._lerobot_names import ACTION, STATE
from candata.schema.exchange import FeatureMap

#: Joint positions beyond it are no rad (two turns each way) or m, unless a map says so.
_LARGEST_POSITION = 4 * np.pi
#: Positions in percent of range end here; LeRobot clips them, and float32 rounds.
_LARGEST_PERCENT = 100.001
_PERCENT_TEXT = "LeRobot's percent of range (RANGE_M100_100; the gripper RANGE_0_100)"
#: Degrees a percent, from a motor's entry in the calibration file; 4096 counts a turn are those of its Feetech and
#: Dynamixel motors. Source: `MotorsBus._normalize`, the ratio of DEGREES to RANGE_M100_100 and RANGE_0_100.
_DEGREES_A_PERCENT = "(range_max - range_min) / 200 * 360 / 4095 (gripper: / 100 in place of / 200)"


def largest_positions(
    mapping: FeatureMap, channel_picks: Sequence[Pick], arrays: Mapping[str, NDArray], entry: Entry
) -> NDArray[np.float64]:
    """Return the largest joint position of an episode `(J,)` by column, as the file has it.

    Raises
    ------
    DataError
        When no unit was said and it is no rad or m; says what it may be, and what to do.
    """
    pick = next((pick for pick in channel_picks if pick.channel == "joint_position"), None)
    if pick is None:
        return np.zeros(0)
    raw = np.concatenate([arrays[name][:, list(columns)] for name, columns in pick.parts], axis=1).astype(np.float64)
    largest_raw = np.abs(np.where(np.isfinite(raw), raw, 0.0)).max(axis=0)
    scaled_positions = largest_raw * np.abs(pick.factors)
    column = int(np.argmax(scaled_positions))
    if scaled_positions[column] > _LARGEST_POSITION and "joint_position" not in mapping.units:
        percent = largest_raw.max() <= _LARGEST_PERCENT
        percent_hint = f"; none beyond 100, as in {_PERCENT_TEXT}, which is no angle without the robot's calibration"
        raise DataError(
            "the joints' positions are no rad or m",
            expected=f"up to {_LARGEST_POSITION:.1f}",
            found=f"{scaled_positions[column]:g} in {pick.columns[column]}" + percent_hint * bool(percent),
            where=Where(path=str(entry.file), episode=str(entry.index), channel=pick.channel),
            fix=_percent_fix(len(pick.columns)) if percent else _degrees_fix(),
        )
    return largest_raw


def note_percent(
    mapping: FeatureMap, channel_picks: Sequence[Pick], largest_raw: NDArray[np.float64], reading: Reading
) -> None:
    """Note positions which a map calls angles and that look like percent, by the set's `largest_raw` `(J,)`."""
    unit = mapping.units.get("joint_position", "")
    angles = {"deg", "rad", "1"}.intersection([unit] if isinstance(unit, str) else unit)
    if not angles or "joint_position" in mapping.scales:
        return
    columns = next(pick.columns for pick in channel_picks if pick.channel == "joint_position")
    is_percent_like = (largest_raw > _LARGEST_POSITION) & (largest_raw <= _LARGEST_PERCENT)
    if largest_raw.max() > _LARGEST_PERCENT:  # degrees; a gripper is percent all the same
        is_percent_like &= np.array(["gripper" in column for column in columns])
    names = [column for column, is_like in zip(columns, is_percent_like, strict=True) if is_like]
    if names:
        reading.note(
            f"taken in {', '.join(sorted(angles))}, as the map says: "
            f"{', '.join(names)}; but never beyond 100, as in {_PERCENT_TEXT}, which is no angle: "
            "if the robot recorded that, they are wrong without `scales`"
        )


def _percent_fix(columns: int) -> str:
    """Return what to do about positions that are percent or degrees; of the columns the gripper's comes last."""
    return (
        "find out whether the robot recorded percent (LeRobot's default for most; `use_degrees: false`) or degrees. "
        "Percent: give a --map FILE with `units: {joint_position: deg, action: deg}` and "
        f"`scales: {{joint_position: [...], action: [...]}}`, for each column {_DEGREES_A_PERCENT} by the robot's "
        "calibration file. Degrees: the units alone, and the gripper, which is always percent, left out: "
        f"`channels: {{joint_position: '{STATE}[0:{columns - 1}]', action: '{ACTION}[0:{columns - 1}]'}}`"
    )


def _degrees_fix() -> str:
    """Return what to do about positions in degrees."""
    return (
        f"say the unit with --map FILE: `channels: {{joint_position: {STATE}, action: {ACTION}}}` and "
        "`units: {joint_position: deg, action: deg}`; `rad` takes them as they are; leave out a gripper, which LeRobot "
        "records in percent of its range"
    )
