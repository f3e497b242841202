"""Bursts: bytes that a USB adapter holds until its latency timer runs out, told by the rhythm in which they are read.

An FTDI chip passes on what it received once 62 bytes are together, or else each time its latency timer runs out: every
16 ms, unless it is told otherwise. What is short of a packet is then read at multiples of 16 ms, however evenly the
device sends, several frames at once where its period is shorter, and after one or two ticks where it is longer. Nothing
tells by how much each reading was late.

Source: FTDI AN232B-04, "Data Throughput, Latency and Handshaking", sections 2 and 3; Linux `ftdi_sio`, whose default
`latency_timer` is 16.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]
#: Period of the timer [s].
TIMER_S = 0.016
#: Length of the windows that are judged [s], and the fewest reads of one. Chosen: in two seconds the phases of a stream
#: of 60 Hz, 16.7 ms apart, go round five times; clocks that differ by 100 ppm move by 0.2 ms.
WINDOW_S, FEWEST = 2.0, 16
#: Mean resultant length of the phases of the reads from which a window is in step with the timer, and up to which what
#: is sent evenly may be (Mardia & Jupp 2000, section 2.3.1). Reads that come up to w late are in step to sin(x) / x,
#: where x is pi w / 16 ms: 0.6 allows 8 ms. Jitter only lowers what an even stream reaches. Record 43.
IN_STEP, EVEN_SHARE = 0.6, 0.4
#: Share of the windows that must be in step. Chosen.
MOST_SHARE = 0.5
#: How bytes come then, in words.
WORDS = (
    f"come in bursts, every {1e3 * TIMER_S:.0f} ms, as a USB adapter's latency timer makes them: stamps are up to "
    f"{1e3 * TIMER_S:.0f} ms late"
)
#: What is done about it on a port of this name.
_REMEDY = (
    "echo 1 > /sys/bus/usb-serial/devices/{name}/latency_timer (as root), or setserial /dev/{name} low_latency, and "
    "record again"
)


def comes_in_bursts(read_ns: Times, rates_hz: Sequence[float]) -> bool:
    """Tell whether most of a recording was read at the beat of a latency timer.

    Parameters
    ----------
    read_ns : (n,) int64 [ns]
        When bytes were read, not decreasing.
    rates_hz : sequence of float
        At which the device may send, such as its nominal rate and the one that was seen. Where one of them is that of
        the timer, or a whole part of it, an even stream looks the same: then nothing is told, nor is it far off.
    """
    return share_in_step(windows(read_ns)) >= MOST_SHARE and not any(looks_timed(rate) for rate in rates_hz)


def windows(read_ns: Times) -> Iterator[Times]:
    """Yield the reads of each `WINDOW_S` that has enough of them."""
    number = (read_ns - read_ns[:1]) // round(1e9 * WINDOW_S)
    parts = np.split(read_ns, np.flatnonzero(np.diff(number)) + 1)
    return (part for part in parts if len(part) >= FEWEST)


def share_in_step(parts: Iterator[Times]) -> float:
    """Return the share of windows that are in step with the timer; 0 where there are none."""
    steps = [in_step(part) for part in parts]
    return float(np.mean(steps)) if steps else 0.0


def in_step(read_ns: Times) -> bool:
    """Tell whether reads come at one phase of the timer."""
    period_ns = round(1e9 * TIMER_S)
    phase = 2 * np.pi * (read_ns % period_ns) / period_ns
    return bool(np.hypot(np.cos(phase).mean(), np.sin(phase).mean()) >= IN_STEP)


def looks_timed(rate_hz: float) -> bool:
    """Tell whether what is sent evenly at a rate may itself be in step with the timer.

    The phases of n stamps, each x turns after the last, have a resultant length of at most 1 / (n |sin(pi x)|), the
    envelope of the Dirichlet kernel.
    """
    if not rate_hz > 0:
        return True
    turns = abs(float(np.sin(np.pi / (rate_hz * TIMER_S))))
    return WINDOW_S * rate_hz * turns * EVEN_SHARE < 1


def seen_rate_hz(time_ns: Times) -> float:
    """Return the mean rate of a stream; 0 for fewer than two stamps."""
    span_ns = int(time_ns[-1] - time_ns[0]) if len(time_ns) > 1 else 0
    return 1e9 * (len(time_ns) - 1) / span_ns if span_ns else 0.0


def remedy(port: str) -> str:
    """Return what to do about the bursts of a port, in words."""
    name = Path(port).resolve().name
    return _REMEDY.format(name=name if name.startswith("ttyUSB") else "ttyUSB0")


class Rhythm:
    """The rhythm of a recording that goes on; feed it the time of each read."""

    def __init__(self) -> None:
        """Begin without a read."""
        self._reads: list[int] = []
        self._judged = self._steps = 0

    def read(self, stamp_ns: int) -> None:
        """Take the time of a read [ns]."""
        if self._reads and stamp_ns - self._reads[0] >= 1e9 * WINDOW_S:
            self._judge()
        self._reads.append(stamp_ns)

    def is_in_bursts(self, rates_hz: Sequence[float]) -> bool:
        """Tell whether most of what was read so far came at the beat of a latency timer; rates as `comes_in_bursts`."""
        in_step_so_far = self._judged > 0 and self._steps >= MOST_SHARE * self._judged
        return in_step_so_far and not any(looks_timed(rate) for rate in rates_hz)

    def _judge(self) -> None:
        """Judge the window that is over."""
        if len(self._reads) >= FEWEST:
            self._judged += 1
            self._steps += in_step(np.array(self._reads, np.int64))
        self._reads = []
