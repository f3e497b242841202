"""Home-made firmware that sends candata's framed format: its hello says which signals it has.

The format stands in `_cobs_frames.py` and in docs/recording.md; `examples/firmware_sender` is a sender of sixty lines.
The hello is sent at the start and once a second, so that a recorder that comes later understands the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from candata import units
from candata.errors import DataError
from candata.record.devices import _cobs_frames as wire
from candata.record.devices._contract import Framer, Signal, StreamDevice
from candata.record.devices._wire import DelimitedFramer, FrameKind, no_frame_finding

BAUD, RATE_HZ = 115_200, 100.0
#: The device's clock, a signal beside those of the hello.
CLOCK = Signal("device_time", (), "ns")
#: Units of signals that are encoded by name alone, for what stands in for a device.
_UNITS = {
    "joint_position": "rad",
    "joint_target": "rad",
    "joint_velocity": "rad/s",
    "joint_effort": "N m",
    "object_pose": "m",
    "wrench": "N",
    "taxels": "count",
}


class CobsFramer(DelimitedFramer):
    """Cuts frames and joins each data frame to the hello that describes it.

    A `state` frame is two frames of the wire, the hello and the data, each with its zero byte, so that it says by
    itself what it holds. The first hello holds for the stream: another one and its data count as `other_hello`, data
    before any as `before_hello`. `lost` counts frames by their numbers.
    """

    def __init__(self) -> None:
        """Begin with no hello."""
        super().__init__(wire.DELIMITER, wire.LONGEST_BYTES, self._judge_frame, BAUD)
        self._hello: wire.Hello | None = None
        self._hello_frame = b""
        self._last_number: int | None = None
        self.lost, self.version, self.hello_error = 0, wire.VERSION, ""

    @property
    def counts(self) -> Mapping[str, int]:
        """What was met so far, with `lost`."""
        return {**super().counts, "lost": self.lost}

    def _judge_frame(self, stuffed: bytes) -> tuple[FrameKind, bytes] | str:
        """Return a frame, or what to count."""
        body = wire.body_of(stuffed)
        if body is None:
            return "crc_failures"
        if body[0] != wire.VERSION:
            self.version = body[0]
            return "other_version"
        if body[1] == wire.HELLO:
            return self._hear_hello(body, stuffed)
        hello = self._hello
        if body[1] != wire.DATA or len(body) < wire.DATA_PREFIX:
            return "malformed"
        if hello is None:
            return "before_hello"
        if int.from_bytes(body[2:6], "little") != hello.identity:
            return "other_hello"
        if len(body) != wire.DATA_PREFIX + 4 * hello.value_count:
            return "malformed"
        frame_number = int.from_bytes(body[6:10], "little")
        if self._last_number is not None:
            missing = (frame_number - self._last_number - 1) % 2**32
            self.lost += missing if missing < 2**31 else 0  # a number that falls is a restart
        self._last_number = frame_number
        return "state", self._hello_frame + stuffed + wire.DELIMITER

    def _hear_hello(self, body: bytes, stuffed: bytes) -> tuple[FrameKind, bytes] | str:
        """Keep the first hello: a log holds one set of signals of a stream."""
        try:
            hello = wire.read_hello(body)
        except DataError as error:
            self.hello_error = str(error).replace("\n", "; ")
            return "malformed"
        if self._hello is not None and hello.text != self._hello.text:
            return "other_hello"
        self._hello, self._hello_frame = hello, stuffed + wire.DELIMITER
        return "other", self._hello_frame


def _parts(frame: bytes) -> tuple[wire.Hello | None, bytes]:
    """Return the hello of a state frame, where it has one, and the body of its data."""
    *before, stuffed = frame.rstrip(wire.DELIMITER).split(wire.DELIMITER)
    data = wire.body_of(stuffed)
    hello = wire.body_of(before[0]) if before else None
    if data is None or data[1] != wire.DATA or len(before) > 1 or (before and hello is None):
        raise DataError("a frame is no data frame with its hello", found=f"{len(frame)} bytes")
    return (wire.read_hello(hello) if hello else None), data


def _hello(frame: bytes) -> wire.Hello:
    """Return the hello of a state frame."""
    hello, _data = _parts(frame)
    if hello is None:
        raise DataError("a data frame stands without its hello", fix="give frames as a framer makes them")
    return hello


def signals_of(frame: bytes) -> tuple[Signal, ...]:
    """Return the signals of a state frame, the device's clock first; those of the hello in SI.

    Raises
    ------
    DataError
        When it is none.
    """
    return (CLOCK, *(Signal(s.name, s.shape, _SI.get(s.unit, s.unit), s.names) for s in _hello(frame).signals))


#: The SI unit of what a unit measures.
_SI = {
    **dict.fromkeys(("mm", "cm"), "m"),
    **dict.fromkeys(("mrad", "deg"), "rad"),
    **dict.fromkeys(("ms", "us", "ns"), "s"),
    **dict.fromkeys(("mN", "gf", "kgf"), "N"),
    "mm/s": "m/s",
    "deg/s": "rad/s",
    "mN m": "N m",
    "mA": "A",
    "mV": "V",
    "g": "kg",
    "ppm": "1",
}


def decode(frames: Sequence[bytes]) -> dict[str, NDArray]:
    """Return what state frames say: `device_time (n,) int64 [ns]` and the hello's signals in SI.

    Raises
    ------
    DataError
        When one is no data frame of the first one's hello.
    """
    hello = _hello(frames[0])
    bodies = [_parts(frame)[1] for frame in frames]
    size = wire.DATA_PREFIX + 4 * hello.value_count
    if any(len(body) != size or int.from_bytes(body[2:6], "little") != hello.identity for body in bodies):
        raise DataError("frames of several hellos are decoded together", fix="decode them apart")
    prefix = [("head", "u1", 10), ("time_us", "<u8"), ("values", "<f4", hello.value_count)]
    rows = np.frombuffer(b"".join(bodies), np.dtype(prefix))
    arrays: dict[str, NDArray] = {CLOCK.name: (rows["time_us"] * np.uint64(1000)).astype(np.int64)}
    begin = 0
    for signal in hello.signals:
        end = begin + int(np.prod(signal.shape))
        with np.errstate(invalid="ignore"):
            values = rows["values"].reshape(len(rows), -1)[:, begin:end].astype(np.float64)
        scale = _scale(signal, values.shape[1])
        arrays[signal.name] = (values * scale).reshape(len(rows), *signal.shape)
        begin = end
    return arrays


def _scale(signal: Signal, size: int) -> NDArray[np.float64]:
    """Return the factors to SI of a signal's values: of a pose only the position has a unit."""
    scale = np.full(size, units.to_si(signal.unit))
    if signal.name.endswith("_pose") and signal.shape == (7,):
        scale[3:] = 1.0
    return scale


def encode(values: Mapping[str, NDArray]) -> list[bytes]:
    """Return n frames, the hello before the first; `device_time` gives their times [ns], else 100 a second."""
    arrays = {name: np.asarray(block, float) for name, block in values.items() if name != CLOCK.name}
    signals = [Signal(name, block.shape[1:], _UNITS.get(name, "1")) for name, block in arrays.items()]
    hello = wire.hello_of(signals, RATE_HZ)
    rows = np.hstack([block.reshape(len(block), -1) for block in arrays.values()])
    times_ns = values.get(CLOCK.name, np.arange(len(rows)) * round(1e9 / RATE_HZ))
    frames = [hello.data_frame(k, int(times_ns[k]) // 1000, row) for k, row in enumerate(rows)]
    return [hello.frame() + frames[0], *frames[1:]]


def findings(framer: Framer) -> tuple[str, ...]:
    """Return what people should know of a stream: another version, no hello, a wrong hello, or no frame at all."""
    counts = framer.counts
    lines: list[str] = []
    if isinstance(framer, CobsFramer):
        if counts.get("other_version"):
            lines.append(f"frames of version {framer.version}: candata knows version {wire.VERSION}; they are left out")
        if framer.hello_error:
            lines.append(f"a hello is wrong, its data are left out: {framer.hello_error}")
        elif counts.get("before_hello") and counts["frames"] == 0:
            lines.append("data came without their hello: send it at the start and once a second")
        if counts.get("other_hello"):
            lines.append("the board changed its hello: what came since is left out; record again")
        if counts.get("malformed", 0) and not framer.hello_error:
            lines.append("data frames are not as long as their hello says; they are left out")
    return tuple(lines) or no_frame_finding(framer, "another baud rate, another device, or no zero byte ends a frame")


DEVICE = StreamDevice(
    summary="home-made firmware in candata's framed format (COBS, CRC-32): its hello names the signals",
    rate_hz=RATE_HZ,
    baud=BAUD,
    framer=CobsFramer,
    signals=(),
    signals_of=signals_of,
    decode=decode,
    device_time=CLOCK.name,
    encode=encode,
    findings=findings,
)
