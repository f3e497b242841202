"""Frames of the XHand1 on RS485: their layout, how they are checked, and how they are written.

Source: the MIT-licensed driver in wanweiwei07/wrs (`wrs/robot_con/xhand/`), the public wiki of PNDbotics
(`dexterous_hands/XHand1`) and real-stanford/DexUMI (MIT). No public source settles the ids and the command byte of a
reply, so readers accept any.
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from candata.errors import UsageError
from candata.record.devices._wire import FrameLayout

BAUD = 3_000_000
HEAD = b"\x55\xaa"
#: Head, source, target, command, u16 payload length; and what follows the payload.
PREFIX, CHECK = 7, 2
#: A frame that claims a longer payload is none.
PAYLOAD_MAX = 8192
HOST, DEVICE_BIT = 0xFE, 0x80
SET_JOINTS, GET_VERSION = 0x02, 0x13
JOINTS, FINGERTIPS, TAXELS = 12, 5, 120

_PREFIX = [("head", "u1", 2), ("source", "u1"), ("target", "u1"), ("command", "u1"), ("length", "<u2")]
_COUNTS = [("x", "i1"), ("y", "i1"), ("z", "u1")]
_JOINT_COMMAND = [
    ("id", "<u2"),
    ("kp", "<i2"),
    ("ki", "<i2"),
    ("kd", "<i2"),
    ("position", "<f4"),
    ("tor_max", "<u2"),
    ("mode", "<u2"),
    ("reserved", "<u2", 4),
]
_JOINT_STATE = [
    ("id", "u1"),
    ("sensor", "u1"),
    ("position", "<f4"),
    ("current", "<i2"),
    ("raw_position", "<u2"),
    ("temperature", "<u2"),
    ("errors", "<u2", 3),
    ("reserved", "<u2", 3),
]
_FINGERTIP = [("force", _COUNTS), ("taxels", _COUNTS, TAXELS), ("temperature", "u1", 20), ("mean_temperature", "u1")]
#: A whole command frame: position [rad], tor_max [mA], mode 0 passive, 3 position, 5 force.
COMMAND = np.dtype([*_PREFIX, ("joints", _JOINT_COMMAND, JOINTS), ("crc", "<u2")])
#: A whole state frame: position [rad], current [mA], forces in counts (z, which presses, without sign).
STATE = np.dtype([*_PREFIX, ("joints", _JOINT_STATE, JOINTS), ("tips", _FINGERTIP, FINGERTIPS), ("crc", "<u2")])

#: What the public driver sends beside the position of each joint.
GAINS = {"kp": 100, "ki": 0, "kd": 10, "tor_max": 300, "mode": 3}
#: Ends of a force count along x, y, z.
COUNT_LOW, COUNT_HIGH = (-128, -128, 0), (127, 127, 255)


def check_sum(data: bytes) -> int:
    """Return the CRC-16/XMODEM of `data` (polynomial 0x1021, start 0; "123456789" gives 0x31C3)."""
    return crc_hqx(data, 0)


def kind_of(frame: bytes) -> Literal["command", "state", "other"]:
    """Return what a whole frame is: the length of its payload alone tells."""
    if len(frame) == COMMAND.itemsize:
        return "command"
    return "state" if len(frame) == STATE.itemsize else "other"


def _size(prefix: bytes) -> int:
    """Return the length of the frame that begins with `prefix`."""
    return PREFIX + int.from_bytes(prefix[5:7], "little") + CHECK


def _checksum_ok(frame: bytes) -> bool:
    """Tell whether the check sum of a whole frame is right."""
    return crc_hqx(memoryview(frame)[:-CHECK], 0) == frame[-2] | frame[-1] << 8


LAYOUT = FrameLayout(
    head=HEAD,
    prefix=PREFIX,
    size=_size,
    longest_bytes=PREFIX + PAYLOAD_MAX + CHECK,
    checksum_ok=_checksum_ok,
    kind=kind_of,
    baud=BAUD,
)


def seal(body: bytes) -> bytes:
    """Return the frame of `body` (head to payload): its check sum is appended, low byte first."""
    return body + check_sum(body).to_bytes(CHECK, "little")


def version_request(hand: int = 0) -> bytes:
    """Return the frame that asks a hand for its firmware version."""
    return seal(HEAD + bytes((HOST, DEVICE_BIT | hand, GET_VERSION, 0, 0)))


def command_frames(joint_target: ArrayLike, hand: int = 0) -> list[bytes]:
    """Return n frames that set the joint targets of a hand, with the gains in `GAINS`.

    Parameters
    ----------
    joint_target : array_like
        `(n, 12) float [rad]`; sent as float32.
    hand : int
        Id of the hand.

    Raises
    ------
    UsageError
        When the shape is another.
    """
    target = _check_shape("joint_target", joint_target, (JOINTS,))
    frames = _blank(COMMAND, len(target), HOST, DEVICE_BIT | hand)
    joints = frames["joints"]
    joints["id"] = np.arange(JOINTS)
    for name, value in GAINS.items():
        joints[name] = value
    joints["position"] = target
    return _sealed(frames)


def state_frames(
    joint_position: ArrayLike, force_counts: ArrayLike, taxel_counts: ArrayLike, hand: int = 0
) -> list[bytes]:
    """Return n replies of a hand that stands at 25 degC and draws no current.

    Parameters
    ----------
    joint_position : array_like
        `(n, 12) float [rad]`; sent as float32.
    force_counts, taxel_counts : array_like
        `(n, 5, 3) int`, `(n, 5, 120, 3) int`: forces within `COUNT_LOW` and `COUNT_HIGH`.
    hand : int
        Id of the hand.

    Raises
    ------
    UsageError
        When a shape is another, the lengths differ, or a count is out of range.
    """
    position = _check_shape("joint_position", joint_position, (JOINTS,))
    force = _check_shape("force_counts", force_counts, (FINGERTIPS, 3))
    taxels = _check_shape("taxel_counts", taxel_counts, (FINGERTIPS, TAXELS, 3))
    if not len(position) == len(force) == len(taxels):
        row_counts = f"{len(position)}, {len(force)}, {len(taxels)} rows"
        raise UsageError("a state needs joints, forces and taxels of as many rows", found=row_counts)
    # The reply's ids are not settled: the request's, turned round.
    frames = _blank(STATE, len(position), DEVICE_BIT | hand, HOST)
    joints, tips = frames["joints"], frames["tips"]
    joints["id"] = joints["sensor"] = np.arange(JOINTS)
    joints["position"], joints["temperature"] = position, 25
    tips["temperature"], tips["mean_temperature"] = 25, 25
    _put_counts(tips["force"], "force_counts", force)
    _put_counts(tips["taxels"], "taxel_counts", taxels)
    return _sealed(frames)


def _check_shape(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray:
    """Return `values` as an array of rows of `shape`."""
    array = np.asarray(values)
    if array.shape[1:] != shape or array.ndim != len(shape) + 1:
        raise UsageError(
            f"{name} has the wrong shape", expected=f"(n, {', '.join(map(str, shape))})", found=str(array.shape)
        )
    return array


def _put_counts(place: NDArray, name: str, counts: NDArray) -> None:
    """Write counts along x, y, z, which must lie in their range."""
    if counts.size and ((counts < COUNT_LOW).any() or (counts > COUNT_HIGH).any()):
        raise UsageError(
            f"{name} is out of range",
            expected=f"{COUNT_LOW} .. {COUNT_HIGH}",
            found=f"{counts.min()} .. {counts.max()}",
        )
    for axis, field in enumerate("xyz"):
        place[field] = counts[..., axis]


def _blank(layout: np.dtype, count: int, source: int, target: int) -> NDArray:
    """Return `count` frames of zeros with their first seven bytes written."""
    frames = np.zeros(count, layout)
    frames["head"] = tuple(HEAD)
    frames["source"], frames["target"], frames["command"] = source, target, SET_JOINTS
    frames["length"] = layout.itemsize - PREFIX - CHECK
    return frames


def _sealed(frames: NDArray) -> list[bytes]:
    """Return the frames as bytes with their check sums."""
    return [seal(frame.tobytes()[:-CHECK]) for frame in frames]


def with_heads(frame: bytes) -> bytes:
    """Return the frame with beginnings of frames in its reserved bytes and temperatures; what it says stays.

    Raises
    ------
    UsageError
        When it is neither a command nor a state frame.
    """
    kind = kind_of(frame)
    if kind == "other":
        raise UsageError("only a command or a state frame can hide heads", found=f"{len(frame)} bytes")
    record = np.frombuffer(frame, COMMAND if kind == "command" else STATE).copy()
    if kind == "command":
        head = np.frombuffer(HEAD + bytes((DEVICE_BIT, HOST, SET_JOINTS)) + (2208).to_bytes(2, "little") + b"\0", "<u2")
        record["joints"]["reserved"] = head
    else:
        head = np.frombuffer(HEAD + bytes((HOST, DEVICE_BIT, SET_JOINTS)) + (288).to_bytes(2, "little"), "u1")
        record["tips"]["temperature"][..., : len(head)] = head
    return _sealed(record)[0]
