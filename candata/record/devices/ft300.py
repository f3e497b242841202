"""Robotiq FT300 (and FT300-S): the stream of force and torque that it sends by itself over its USB-RS485 adapter.

Source: the FT 300 instruction manual, section on the data stream, and public readers of it that agree: 19200 baud 8N1;
16 bytes, 20 4E, six little-endian i16 (force in 0.01 N, torque in 0.001 N m), CRC-16/Modbus, low byte first; 100 Hz.
The stream is started by writing 0x0200 to register 410 over Modbus RTU. candata never writes: start it with the
maker's tool, or leave it on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.record.devices._contract import Framer, Signal, StreamDevice
from candata.record.devices._wire import FrameLayout, HeadFramer, no_frame_finding

BAUD = 19200
HEAD = b"\x20\x4e"
MESSAGE = np.dtype([("head", "u1", 2), ("counts", "<i2", 6), ("crc", "<u2")])
#: Newton and newton metre a count. Source: the manual.
SCALE = np.array([0.01, 0.01, 0.01, 0.001, 0.001, 0.001])
#: CRC-16/Modbus: polynomial 0x8005 reflected, start 0xFFFF ("123456789" gives 0x4B37). Source: Modbus over serial line.
_POLYNOMIAL, _START = 0xA001, 0xFFFF


def _table_entry(byte: int) -> int:
    """Return what one byte does to the check sum."""
    for _bit in range(8):
        byte = byte >> 1 ^ (_POLYNOMIAL if byte & 1 else 0)
    return byte


_TABLE = tuple(_table_entry(byte) for byte in range(256))


def modbus_crc(data: bytes) -> int:
    """Return the CRC-16/Modbus of `data`."""
    crc = _START
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


LAYOUT = FrameLayout(
    head=HEAD,
    prefix=len(HEAD),
    size=lambda _prefix: MESSAGE.itemsize,
    longest_bytes=MESSAGE.itemsize,
    checksum_ok=lambda message: modbus_crc(message[:-2]) == int.from_bytes(message[-2:], "little"),
    kind=lambda _message: "state",
    baud=BAUD,
)


def decode(messages: Sequence[bytes]) -> dict[str, NDArray]:
    """Return `wrench (n, 6) float64`: force [N], torque [N m], in the sensor's frame.

    Raises
    ------
    DataError
        When a frame has another length.
    """
    odd = next((message for message in messages if len(message) != MESSAGE.itemsize), None)
    if odd is not None:
        raise DataError("a frame is no message", expected=f"{MESSAGE.itemsize} bytes", found=f"{len(odd)} bytes")
    return {"wrench": np.frombuffer(b"".join(messages), MESSAGE)["counts"] * SCALE}


def encode(values: Mapping[str, NDArray]) -> list[bytes]:
    """Return n messages that say `wrench (n, 6)`; what is beyond the range of a count is clipped."""
    counts = np.clip(np.rint(np.asarray(values["wrench"]) / SCALE), -32768, 32767).astype("<i2")
    bodies = [HEAD + row.tobytes() for row in counts]
    return [body + modbus_crc(body).to_bytes(2, "little") for body in bodies]


def findings(framer: Framer) -> tuple[str, ...]:
    """Return what people should know of a stream: that nothing in it is a message."""
    return no_frame_finding(framer, f"another baud rate than {BAUD}, another device, or its stream is not started")


DEVICE = StreamDevice(
    summary="Robotiq FT300 wrench sensor, serial stream at 19200 baud: force and torque at 100 Hz",
    rate_hz=100.0,
    baud=BAUD,
    framer=partial(HeadFramer, LAYOUT),
    signals=(Signal("wrench", (6,), "N", ("fx", "fy", "fz", "tx", "ty", "tz")),),
    decode=decode,
    encode=encode,
    findings=findings,
)
