"""XHand1, right hand, on RS485: 12 joints, 5 fingertips of 120 taxels.

Facts and their sources stand in `_xhand_frames.py`. The normal force has no sign on this wire: a pull reads 0, and a
count at an end of its range may be anything beyond.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.record.devices import _xhand_frames as wire
from candata.record.devices._contract import Commands, Device, Encoder, States
from candata.record.devices._wire import HeadFramer

#: In the order of the ids on the wire, which is that of the scene's hand.
JOINT_NAMES = (
    "thumb_bend",
    "thumb_rota1",
    "thumb_rota2",
    "index_bend",
    "index1",
    "index2",
    "mid1",
    "mid2",
    "ring1",
    "ring2",
    "pinky1",
    "pinky2",
)
FINGERTIP_NAMES = ("thumb_rota2", "index2", "mid2", "ring2", "pinky2")
#: Range of each joint [rad]: XHand1 wiki of PNDbotics, the table of the scene's hand.
JOINT_LIMITS = (
    (0.0, 1.832),
    (-0.698, 1.57),
    (0.0, 1.57),
    (-0.174, 0.174),
    *[(0.0, 1.919)] * 8,
)
#: Two public users of the raw counts scale by it; the paper of the hand states a resolution of 0.05 N. A setting.
NEWTON_PER_COUNT = 0.1


def framer() -> HeadFramer:
    """Return a fresh framer of this wire."""
    return HeadFramer(wire.LAYOUT)


def decode_states(frames: Sequence[bytes]) -> States:
    """Return what state frames say.

    Raises
    ------
    DataError
        When a frame is no state frame.
    """
    rows = _rows(frames, wire.STATE, "state")
    joints, tips = rows["joints"], rows["tips"]
    return States(
        joint_position=_positions(joints),
        motor_current=joints["current"] * 1e-3,
        motor_temperature=joints["temperature"].astype(np.float64),
        force_counts=_counts(tips["force"]),
        taxel_counts=_counts(tips["taxels"]),
    )


def decode_commands(frames: Sequence[bytes]) -> Commands:
    """Return what command frames say.

    Raises
    ------
    DataError
        When a frame is no command frame.
    """
    rows = _rows(frames, wire.COMMAND, "command")
    return Commands(joint_target=_positions(rows["joints"]))


def _rows(frames: Sequence[bytes], layout: np.dtype, kind: str) -> NDArray:
    """Return the frames as an array of records."""
    odd_frame = next((frame for frame in frames if len(frame) != layout.itemsize), None)
    if odd_frame is not None:
        expected = f"{layout.itemsize} bytes"
        raise DataError(f"a frame is no {kind} frame", expected=expected, found=f"{len(odd_frame)} bytes")
    return np.frombuffer(b"".join(frames), layout)


def _positions(joints: NDArray) -> NDArray[np.float64]:
    """Return the positions of joint records; bits that are no number become NaN without a warning."""
    with np.errstate(invalid="ignore"):
        return joints["position"].astype(np.float64)


def _counts(records: NDArray) -> NDArray[np.int16]:
    """Return `(..., 3) int16` of records x, y (signed) and z (unsigned)."""
    counts = np.empty((*records.shape, 3), np.int16)
    for axis, field in enumerate("xyz"):
        counts[..., axis] = records[field]
    return counts


DEVICE = Device(
    summary="XHand1, right hand, RS485 at 3 Mbaud: 12 joints, 5 fingertips of 120 taxels",
    baud=wire.BAUD,
    rate_hz=83.0,
    joint_names=JOINT_NAMES,
    fingertip_names=FINGERTIP_NAMES,
    taxels=wire.TAXELS,
    newton_per_count=NEWTON_PER_COUNT,
    count_low=wire.COUNT_LOW,
    count_high=wire.COUNT_HIGH,
    framer=framer,
    decode_states=decode_states,
    decode_commands=decode_commands,
    encoder=Encoder(wire.command_frames, wire.state_frames, wire.with_heads),
    joint_limits=JOINT_LIMITS,
)
