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
_WHAT = "LeRobot's percent of range (RANGE_M100_100; the gripper RANGE_0_100)"
#: Degrees a percent, from a motor's entry in the calibration file; 4096 counts a turn are those of its Feetech and
#: Dynamixel motors. Source: `MotorsBus._normalize`, the ratio of DEGREES to RANGE_M100_100 and RANGE_0_100.
_DEGREES_A_PERCENT = "(range_max - range_min) / 200 * 360 / 4095 (gripper: / 100 in place of / 200)"


def check_positions(mapping: FeatureMap, made: Sequence[Pick], arrays: Mapping[str, NDArray], entry: Entry) -> float:
    """Return the largest joint position of an episode as the file has it, 0 where it has none.

    Raises
    ------
    DataError
        When no unit was said and it is no rad or m; says what it may be, and what to do.
    """
    pick = next((pick for pick in made if pick.channel == "joint_position"), None)
    if pick is None:
        return 0.0
    raw = np.concatenate([arrays[name][:, list(columns)] for name, columns in pick.parts], axis=1)
    raw = np.abs(np.where(np.isfinite(raw), raw, 0.0))
    largest = (raw * np.abs(pick.factors)).max(axis=0)
    column = int(np.argmax(largest))
    if largest[column] > _LARGEST_POSITION and "joint_position" not in mapping.units:
        percent = raw.max() <= _LARGEST_PERCENT
        like = f"; none beyond 100, as in {_WHAT}, which is no angle without the robot's calibration"
        raise DataError(
            "the joints' positions are no rad or m",
            expected=f"up to {_LARGEST_POSITION:.1f}",
            found=f"{largest[column]:g} in {pick.columns[column]}" + like * bool(percent),
            where=Where(path=str(entry.file), episode=str(entry.index), channel=pick.channel),
            fix=_percent_fix(len(pick.columns)) if percent else _degrees_fix(),
        )
    return float(raw.max())


def note_percent(mapping: FeatureMap, largest: float, reading: Reading) -> None:
    """Note that positions which a map calls an angle look like percent of range; `largest` is that of the set."""
    unit = mapping.units.get("joint_position", "")
    angles = {"deg", "rad", "1"}.intersection([unit] if isinstance(unit, str) else unit)
    if angles and "joint_position" not in mapping.scales and _LARGEST_POSITION < largest <= _LARGEST_PERCENT:
        reading.note(
            f"joint_position is taken in {', '.join(sorted(angles))}, as the map says; but none lies beyond 100, as in "
            f"{_WHAT}, which is no angle: if the robot recorded that, the joints are wrong without `scales`"
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
        "`units: {joint_position: deg, action: deg}`; `rad` takes them as they are"
    )
