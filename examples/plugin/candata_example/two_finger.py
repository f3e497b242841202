"""A gripper of two joints and two fingertips without taxels, on a made-up wire.

A frame is a head of two bytes, its kind, its payload and a checksum, the sum of all before it modulo 65536.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.record.devices import Commands, Device, Encoder, FrameLayout, HeadFramer, States

HEAD, COMMAND, STATE = b"\xa5\x5a", 1, 2
BAUD, RATE_HZ, NEWTON_PER_COUNT = 1_000_000, 100.0, 0.01
#: Angles in 1e-4 rad, forces in counts.
STEP_RAD = 1e-4
_PREFIX = [("head", "u1", 2), ("kind", "u1")]
COMMAND_FRAME = np.dtype([*_PREFIX, ("joints", "<i2", 2), ("checksum", "<u2")])
STATE_FRAME = np.dtype([*_PREFIX, ("joints", "<i2", 2), ("force", "<i2", (2, 3)), ("checksum", "<u2")])
SIZES = {COMMAND: COMMAND_FRAME.itemsize, STATE: STATE_FRAME.itemsize}


def _checksum(body: bytes) -> bytes:
    """Return the checksum of a frame's bytes before it."""
    return (sum(body) % 65536).to_bytes(2, "little")


LAYOUT = FrameLayout(
    head=HEAD,
    prefix=3,
    size=lambda prefix: SIZES.get(prefix[2], 2**16),  # longer than any frame: no frame
    longest_bytes=STATE_FRAME.itemsize,
    checksum_ok=lambda frame: _checksum(frame[:-2]) == frame[-2:],
    kind=lambda frame: "command" if frame[2] == COMMAND else "state",
    baud=BAUD,
)


def decode_states(frames: Sequence[bytes]) -> States:
    """Return what state frames say; this wire carries no currents, temperatures and taxels."""
    records = np.frombuffer(b"".join(frames), STATE_FRAME)
    joints = records["joints"] * STEP_RAD
    taxels = np.zeros((len(frames), 2, 0, 3), np.int16)
    return States(joints, np.zeros(joints.shape), np.zeros(joints.shape), records["force"].astype(np.int16), taxels)


def decode_commands(frames: Sequence[bytes]) -> Commands:
    """Return what command frames say."""
    return Commands(np.frombuffer(b"".join(frames), COMMAND_FRAME)["joints"] * STEP_RAD)


def _sealed(records: NDArray, kind: int, joints: NDArray) -> list[bytes]:
    """Return records as frames."""
    records["head"], records["kind"] = tuple(HEAD), kind
    records["joints"] = np.rint(joints / STEP_RAD)
    bodies = [record.tobytes()[:-2] for record in records]
    return [body + _checksum(body) for body in bodies]


def command_frames(joint_target: NDArray) -> list[bytes]:
    """Return n frames that set joint targets `(n, 2) [rad]`."""
    return _sealed(np.zeros(len(joint_target), COMMAND_FRAME), COMMAND, joint_target)


def state_frames(joint_position: NDArray, force_counts: NDArray, taxel_counts: NDArray) -> list[bytes]:
    """Return n replies: joints `(n, 2) [rad]` and forces `(n, 2, 3)` in counts."""
    records = np.zeros(len(joint_position), STATE_FRAME)
    records["force"] = force_counts
    return _sealed(records, STATE, joint_position)


DEVICE = Device(
    summary="two joints, two fingertips without taxels, 1 Mbaud",
    baud=BAUD,
    rate_hz=RATE_HZ,
    joint_names=("left", "right"),
    fingertip_names=("left", "right"),
    taxels=0,
    newton_per_count=NEWTON_PER_COUNT,
    count_low=(-32768,) * 3,
    count_high=(32767,) * 3,
    framer=lambda: HeadFramer(LAYOUT),
    decode_states=decode_states,
    decode_commands=decode_commands,
    encoder=Encoder(command_frames, state_frames),
)
