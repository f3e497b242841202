"""What every stream keeps: frames say what was encoded, whatever the reads, and garbage costs no sound one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from candata import units
from candata.record.devices import DEVICES, Frame, StreamDevice
from candata.testing._claims import require, require_words

ROWS = 24


class StreamConformance:
    """Conformance of one stream device.

    Attributes
    ----------
    device : StreamDevice
        The constant of the plug-in.
    values : mapping, optional
        `{signal: (n, *shape)}` to encode; by default small numbers, and unit quaternions in a pose.
    step : float
        By how much a value may differ after the wire: its resolution.
    """

    device: ClassVar[StreamDevice]
    values: ClassVar[Mapping[str, NDArray] | None] = None
    step: ClassVar[float] = 1e-3

    def test_it_is_registered_and_in_words(self) -> None:
        """Users come to it by its name, and read what it is."""
        require_words(DEVICES, self.device)

    def test_what_it_declares_makes_sense(self) -> None:
        """Names once each, known units, a positive rate, a clock among its signals."""
        device = self.device
        names = [signal.name for signal in device.signals]
        require(len(set(names)) == len(names), f"a signal stands twice: {', '.join(names)}")
        require(bool(names) != bool(device.signals_of), "either `signals` or `signals_of` says what the frames hold")
        for signal in device.signals:
            units.to_si(signal.unit)
            require(not signal.names or len(signal.names) == signal.shape[0], f"{signal.name}: names are not its rows")
        require(device.rate_hz > 0, "rate_hz is not positive")
        require(device.link != "serial" or device.baud > 0, "a serial device has no baud rate")
        require(device.device_time in (None, *names) or device.signals_of, "device_time is none of its signals")

    def test_what_is_encoded_is_decoded(self) -> None:
        """Values within the wire's resolution, in the declared shapes."""
        values, frames = self._rows()
        decoded = self.device.values(frames)
        for name, sent in values.items():
            error = float(np.abs(decoded[name] - sent).max())
            require(error <= self.step, f"{name} is off by {error:.3g} after the wire")

    def test_frames_do_not_depend_on_how_the_bytes_were_read(self) -> None:
        """A read ends anywhere; a datagram of UDP comes whole."""
        values, frames = self._rows()
        stream = b"".join(frames)
        for size in (1, 7, 64, len(stream)) if self.device.link != "udp" else (len(stream),):
            states = [f for f in self._read(stream, size) if f.kind == "state"]
            require(len(states) == ROWS, f"reads of {size} bytes give {len(states)} of {ROWS} states")
            decoded = self.device.values([f.data for f in states])
            for name, sent in values.items():
                require(np.abs(decoded[name] - sent).max() <= self.step, f"reads of {size} bytes change {name}")

    def test_no_bytes_break_it(self) -> None:
        """A framer never raises, and a state that comes out of noise decodes."""
        for seed in range(3):
            for frame in self._read(np.random.default_rng(seed).bytes(20_000), 997):
                if frame.kind == "state":
                    self.device.values([frame.data])

    def _rows(self) -> tuple[Mapping[str, NDArray], list[bytes]]:
        """Return values and their frames; skips the test where the device has no encoder."""
        if self.device.encode is None:
            import pytest

            pytest.skip("the device has no encoder: nothing can be encoded")
        values = self.values or {s.name: _small(s.name, s.shape, s.unit) for s in self.device.signals}
        return values, self.device.encode(values)

    def _read(self, stream: bytes, size: int) -> list[Frame]:
        """Return the frames of a stream that is read in pieces, one a millisecond."""
        framer = self.device.framer()
        frames: list[Frame] = []
        for number, start in enumerate(range(0, len(stream), size)):
            frames += framer.feed(stream[start : start + size], (number + 1) * 1_000_000)
        return frames + framer.finish()


def _small(name: str, shape: tuple[int, ...], unit: str) -> NDArray:
    """Return ROWS values of one signal: a rising clock, unit quaternions in a pose, else numbers from -1 to 1."""
    if unit == "ns":
        return np.arange(1, ROWS + 1) * 5_000_000
    values = np.random.default_rng(1).uniform(-1, 1, (ROWS, *shape))
    if unit == "count":
        return np.round(100 * np.abs(values))
    if name.endswith("_pose"):
        values[:, 3:] /= np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return values
