"""Frames of candata's own format for home-made firmware: COBS, CRC-32, a hello that describes the data.

A frame is COBS(body, CRC-32 of the body) and one zero byte. All numbers are little-endian. The body is

| byte | what |
|---|---|
| 0 | version, 1 |
| 1 | 0: hello, 1: data |
| hello, 2.. | UTF-8 JSON `{"rate_hz": 100, "signals": [{"name", "unit", "shape", "names"}]}` |
| data, 2..5 | CRC-32 of the hello's JSON |
| data, 6..9 | number of the frame, from 0, modulo 2^32 |
| data, 10..17 | the device's time in microseconds |
| data, 18.. | float32 values of all signals, in the hello's order |

Source of COBS: Cheshire and Baker, Consistent overhead byte stuffing (IEEE/ACM Trans. Networking 7, 1999). CRC-32: that
of Ethernet and zlib ("123456789" gives 0xCBF43926).
"""

from __future__ import annotations

import binascii
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata import units
from candata.errors import CandataError, DataError
from candata.record.devices._contract import Signal
from candata.schema.json_text import parse_json
from candata.schema.text_bounds import TextError

VERSION, HELLO, DATA = 1, 0, 1
DELIMITER = b"\0"
#: Bytes before the values of a data frame, and of the check sum.
DATA_PREFIX, CHECK = 18, 4
#: The longest frame on the wire, delimiter included: 500 values, or a hello that names them.
LONGEST_BYTES = 8192
#: COBS has a code byte for every run of at most so many bytes.
_RUN = 254


def stuff(data: bytes) -> bytes:
    """Return `data` without zero bytes, by COBS; the delimiter is not added."""
    out = bytearray()
    for run in data.split(b"\0"):
        for start in range(0, len(run) - _RUN + 1, _RUN):
            out += b"\xff" + run[start : start + _RUN]
        rest = len(run) % _RUN
        out += bytes([rest + 1]) + run[len(run) - rest :]
    return bytes(out)


def unstuff(stuffed: bytes) -> bytes | None:
    """Return what `stuff` was given, or None when the code bytes do not add up."""
    out, place = bytearray(), 0
    while place < len(stuffed):
        code = stuffed[place]
        end = place + code
        if code == 0 or end > len(stuffed):
            return None
        out += stuffed[place + 1 : end]
        if code <= _RUN and end < len(stuffed):
            out.append(0)
        place = end
    return bytes(out)


def seal(body: bytes) -> bytes:
    """Return the frame of a body as it is on the wire, zero byte included."""
    return stuff(body + binascii.crc32(body).to_bytes(CHECK, "little")) + DELIMITER


def body_of(stuffed: bytes) -> bytes | None:
    """Return the body of a frame (without its zero byte), or None when it is damaged."""
    data = unstuff(stuffed)
    if data is None or len(data) < 2 + CHECK:
        return None
    body = data[:-CHECK]
    return body if binascii.crc32(body) == int.from_bytes(data[-CHECK:], "little") else None


@dataclass(frozen=True)
class Hello:
    """What a device says of its data.

    Attributes
    ----------
    signals : tuple of Signal
        In the order of the values.
    rate_hz : float
        Nominal rate.
    text : bytes
        The JSON as sent.
    """

    signals: tuple[Signal, ...]
    rate_hz: float
    text: bytes

    @property
    def identity(self) -> int:
        """CRC-32 of the JSON: what data frames carry."""
        return binascii.crc32(self.text)

    @property
    def value_count(self) -> int:
        """Values in a data frame."""
        return sum(int(np.prod(signal.shape)) for signal in self.signals)

    def frame(self) -> bytes:
        """Return the hello as it is on the wire."""
        return seal(bytes((VERSION, HELLO)) + self.text)

    def data_frame(self, number: int, time_us: int, values: NDArray) -> bytes:
        """Return a data frame as it is on the wire.

        Parameters
        ----------
        number : int
            Of the frame.
        time_us : int
            The device's time [us].
        values : ndarray
            `(value_count,) float`, all signals one after another.
        """
        prefix = self.identity.to_bytes(4, "little") + (number % 2**32).to_bytes(4, "little")
        values_sent = np.asarray(values, "<f4").tobytes()
        return seal(bytes((VERSION, DATA)) + prefix + time_us.to_bytes(8, "little") + values_sent)


def hello_of(signals: Sequence[Signal], rate_hz: float) -> Hello:
    """Return the hello of a device with these signals."""
    rows = [
        {"name": s.name, "unit": s.unit, "shape": list(s.shape)} | ({"names": list(s.names)} if s.names else {})
        for s in signals
    ]
    text = json.dumps({"rate_hz": rate_hz, "signals": rows}, separators=(",", ":"))
    return Hello(tuple(signals), rate_hz, text.encode())


def read_hello(body: bytes) -> Hello:
    """Return the hello in a body.

    Raises
    ------
    DataError
        Says what about the hello is wrong.
    """
    text = body[2:]
    try:
        content = parse_json(text)
        signals = tuple(_signal(row) for row in content["signals"])
        rate_hz = float(content["rate_hz"])
    except DataError:
        raise
    except (TextError, ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise DataError("the hello is not as documented", found=f"{type(error).__name__}: {error}") from None
    names = [signal.name for signal in signals]
    hello = Hello(signals, rate_hz, text)
    most_values = (LONGEST_BYTES - DATA_PREFIX - CHECK - 2) // 5
    if not names or len(set(names)) != len(names) or "device_time" in names:
        expected = "one signal or more, each name once, none called device_time"
        raise DataError("the hello names no signals or one twice", expected=expected, found=", ".join(names) or "none")
    if not 0 < rate_hz < np.inf or not 0 < hello.value_count <= most_values:
        found = f"{rate_hz:g} Hz, {hello.value_count} values"
        raise DataError(
            "the hello is out of range", expected=f"a rate above 0, 1 to {most_values} values a frame", found=found
        )
    return hello


def _signal(row: Mapping[str, Any]) -> Signal:
    """Return a signal of a hello."""
    shape, names = row.get("shape", []), row.get("names", [])
    if not all(type(size) is int and 0 < size < LONGEST_BYTES for size in shape) or len(shape) > 4:
        raise DataError("the shape of a signal is wrong", expected="up to 4 whole numbers from 1 on", found=str(shape))
    if names and (not shape or len(names) != shape[0]):
        raise DataError("the names are not as many as the rows of a signal", found=f"{len(names)} for {shape}")
    unit = str(row["unit"])
    try:
        units.to_si(unit)
    except CandataError as error:
        raise DataError("a unit of the hello is unknown", found=unit, fix=str(error).splitlines()[-1]) from None
    return Signal(str(row["name"]), tuple(shape), unit, tuple(str(name) for name in names))
