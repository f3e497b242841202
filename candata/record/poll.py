"""A set-point for a hand that no other program drives: checked, and turned into the bytes that are repeated."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from candata.errors import UsageError, Where
from candata.record.devices import Device
from candata.record.reader_link import Poll


def read_posture(text: str, device: Device) -> tuple[float, ...]:
    """Return the set-point [rad] in `text`: numbers between commas, or a CSV file with a header of joint names.

    Parameters
    ----------
    text : str
        `0,0.2,...` in the order of the device's joints; or the path of a file whose last row is the set-point.
    device : Device
        Whose joints.

    Raises
    ------
    UsageError
        When a joint is missing, unknown or no number.
    """
    # Numbers of many digits are longer than a file's name may be.
    words = _row_of(Path(text), device.joint_names) if os.path.isfile(text) else text.split(",")
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        values = ()
    if len(values) != len(device.joint_names):
        raise UsageError(
            "the set-point does not say every joint",
            expected=f"{len(device.joint_names)} numbers [rad], or a file: {', '.join(device.joint_names)}",
            found=text,
        )
    return values


def poll_of(device: Device, name: str, posture_rad: Sequence[float]) -> Poll:
    """Return the bytes that ask a hand to hold a posture (J,) [rad], at the device's rate.

    Raises
    ------
    UsageError
        When the device has no encoder or no limits, or a joint would leave its limits.
    """
    if device.encoder is None or device.joint_limits is None:
        raise UsageError(f"{name} cannot be polled", fix="let the program that drives it ask it for its state")
    for joint, value, (low, high) in zip(device.joint_names, posture_rad, device.joint_limits, strict=True):
        if not low <= value <= high:
            raise UsageError(
                f"the set-point leaves the limits of {joint}",
                expected=f"{low:g} .. {high:g} rad",
                found=f"{value:g} rad",
            )
    frame = device.encoder.command_frames(np.array([posture_rad], np.float64))[0]
    return Poll(frame, device.rate_hz)


def _row_of(path: Path, joints: Sequence[str]) -> list[str]:
    """Return the last row of a table, in the order of the joints."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError("the set-point's file is no CSV file", found=str(error), where=Where(path=str(path))) from None
    absent = [joint for joint in joints if not rows or not rows[-1].get(joint)]
    if absent:
        raise UsageError("the set-point's file lacks joints", expected=", ".join(absent), where=Where(path=str(path)))
    return [rows[-1][joint] for joint in joints]
