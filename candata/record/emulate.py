"""The stand-in for a hand: plays a script on a pseudo-terminal at the pace of the wire."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.record.devices._wire import wire_time_ns
from candata.record.emulate_faults import NO_FAULTS, Faults, with_fault
from candata.record.emulate_line import Line
from candata.record.emulate_script import Script

#: Between a reader opening the port and the first frame: programs set the port up and empty it first.
SETTLE_S = 0.2
#: Longest wait at the end for the reader to take the last bytes, which go with the port.
DRAIN_S = 1.0
#: Most that waits for a reader which is late, beside the 12 kB of the pseudo-terminal [bytes]. Source: Linux keeps so
#: much for the reader of a serial port (`TTYB_DEFAULT_MEM_LIMIT` of tty_buffer.c, 65536; newer kernels keep more).
WAITING_BYTES = 65_536
#: How soon a full port is tried again [s].
RETRY_S = 0.002
#: Longest sleep, so that a stop is heard soon.
_NAP_NS = 50_000_000


@dataclass(frozen=True)
class Transmission:
    """What an emulation sent, a row for each request and reply.

    Attributes
    ----------
    script : Script
        What was played.
    index : (n,) int64
        Row of the script.
    command_time_ns, state_time_ns : (n,) int64
        When the first byte of the request and of the reply was on the wire [ns since 1970].
    command_whole, state_whole : (n,) bool
        The frame went out whole and without damage; false too where nothing was sent.
    counts : dict
        `whole_commands`, `whole_states`, `dropped_frames`, `dropped_bytes`, `received_bytes` (what the reader
        wrote), `faults` by name.
    late_s : float
        The most by which a frame was behind its time.
    """

    script: Script
    index: NDArray[np.int64]
    command_time_ns: NDArray[np.int64]
    state_time_ns: NDArray[np.int64]
    command_whole: NDArray[np.bool_]
    state_whole: NDArray[np.bool_]
    counts: dict[str, Any]
    late_s: float

    def report(self) -> dict[str, Any]:
        """Return the counts, with what the device's range clipped, as plain values."""
        row_count = len(self.index)
        return {
            "rows": row_count,
            "rate_hz": self.script.rate_hz,
            "seconds": round((self.state_time_ns[-1] - self.command_time_ns[0]) * 1e-9, 3) if row_count else 0.0,
            **self.counts,
            "clipped": {
                "force_counts": int(self.script.force_clipped[self.index].sum()),
                "taxel_counts": int(self.script.taxels_clipped[self.index].sum()),
            },
            "late_s": round(self.late_s, 6),
        }


@dataclass
class _Tally:
    """What has been sent so far."""

    index: list[int] = field(default_factory=list)
    times: list[tuple[int, int]] = field(default_factory=list)
    arrived_whole: list[list[bool]] = field(default_factory=list)
    late_ns: int = 0
    dropped_frames: int = 0
    dropped_bytes: int = 0
    received_bytes: int = 0
    faults: Counter[str] = field(default_factory=Counter)


class _HeldFrame(NamedTuple):
    """A frame that waits: what is still to arrive of it, whether that is undamaged, and where to note that it did."""

    data: bytes
    is_undamaged: bool
    arrived_whole: list[bool]
    place: int


class _Wire:
    """The line with its faults; None in its place while it is unplugged or silent."""

    def __init__(self, line: Line, script: Script, faults: Faults, rng: np.random.Generator) -> None:
        self.line: Line | None = line
        self._link, self._script, self._faults, self._rng = line.link, script, faults, rng
        self._held: list[_HeldFrame] = []
        self._timer_ns = round(1e9 * faults.burst_s)
        self._tick_ns = time.monotonic_ns() + self._timer_ns
        self.tally = _Tally()

    def follow(self, at_s: float, on_port: Callable[[str], None]) -> bool:
        """Unplug or plug in as the faults say for second `at_s`; return False once it is unplugged for good."""
        if self._faults.unplug is None:
            return True
        begin, length = self._faults.unplug
        is_unplugged = begin <= at_s and (length is None or at_s < begin + length)
        if is_unplugged and self.line is not None:
            self.close()
        elif not is_unplugged and self.line is None:
            self.line = Line(self._link)
            on_port(self.line.port)
        return not is_unplugged or length is not None

    def close(self) -> None:
        """Close the line."""
        line, self.line = self.line, None
        self._hand_over()
        if line is not None:
            line.has_reader()
            self.tally.received_bytes += line.received_bytes
            line.close()

    def is_silent(self, at_s: float) -> bool:
        """Tell whether nothing is sent in second `at_s`."""
        return self.line is None or any(t <= at_s < t + length for t, length in self._faults.stalls)

    def has_room(self, count: int) -> bool:
        """Tell whether so many bytes may wait for the reader beside those that do."""
        return count + sum(len(frame.data) for frame in self._held) <= WAITING_BYTES

    def send(self, frame: bytes, is_silent: bool, has_room: bool, arrived_whole: list[bool]) -> None:
        """Send a frame, or hold it until timer and reader let it out, or lose it where there is no room.

        `arrived_whole` takes whether it went out undamaged.
        """
        arrived_whole.append(False)
        if is_silent or self.line is None:
            return
        if not has_room:
            self._lose(frame)
            return
        data, fault = with_fault(frame, self._faults, self._script.encoder.with_heads, self._rng)
        if fault:
            self.tally.faults[fault] += 1
        self._held.append(_HeldFrame(data, fault in (None, "head"), arrived_whole, len(arrived_whole) - 1))
        if not self._timer_ns:
            self._hand_over()

    def tick(self, now_ns: int) -> int:
        """Hand over what is held unless a timer keeps it; return when to do so again [ns from now]."""
        if not self._timer_ns:
            self._hand_over()
            return round(1e9 * RETRY_S) if self._held else _NAP_NS
        if now_ns >= self._tick_ns:
            self._hand_over()
            self._tick_ns += self._timer_ns * (1 + (now_ns - self._tick_ns) // self._timer_ns)
        return self._tick_ns - now_ns

    def drain(self) -> None:
        """Wait until nothing is held, and the reader has taken what is on the line; each at most `DRAIN_S`."""
        end_ns = time.monotonic_ns() + round(1e9 * DRAIN_S)
        while self._held and (now_ns := time.monotonic_ns()) < end_ns:
            time.sleep(self.tick(now_ns) * 1e-9)
        if self.line is not None:
            self.line.drain(DRAIN_S)

    def _hand_over(self) -> None:
        """Write what is held as far as the port takes it; where nobody listens all of it is lost."""
        if self.line is None or not self.line.has_reader():
            for frame in self._held:
                self._lose(frame.data)
            self._held = []
            return
        while self._held:
            frame = self._held.pop(0)
            count = self.line.write(frame.data)
            if count < len(frame.data):
                self._held.insert(0, frame._replace(data=frame.data[count:]))
                return
            frame.arrived_whole[frame.place] = frame.is_undamaged

    def _lose(self, data: bytes) -> None:
        """Count a frame, or what is left of it, that is lost."""
        self.tally.dropped_frames += 1
        self.tally.dropped_bytes += len(data)


def wait_for_reader(line: Line, stop: Callable[[], bool]) -> bool:
    """Return once a program has opened the port and had `SETTLE_S` to set it up; False when stopped before."""
    while not line.has_reader():
        if stop():
            return False
        time.sleep(0.02)
    time.sleep(SETTLE_S)
    return True


def play(
    script: Script,
    line: Line,
    rng: np.random.Generator,
    *,
    faults: Faults = NO_FAULTS,
    passes: int = 1,
    hold: bool = False,
    stop: Callable[[], bool] = lambda: False,
    on_port: Callable[[str], None] = lambda _port: None,
) -> Transmission:
    """Return what was sent, once the script has been played, the port unplugged for good, or a stop asked for.

    Each row is sent at its own absolute time, so that no delay adds up; one that is late is followed as fast as the
    wire allows. A frame is written when its last byte would be on the wire: request, then reply, 8.38 ms a row.

    Parameters
    ----------
    script : Script
        What to play.
    line : Line
        Where to; closed at the end.
    rng : numpy.random.Generator
        Draws the faults.
    faults : Faults
        What goes wrong.
    passes : int
        How often the script is played, its still stretch included; 0 plays it until stopped.
    hold : bool
        Go on sending the last row until stopped.
    stop : callable
        Tells whether to end.
    on_port : callable
        Told the name of the new port after an unplug.
    """
    wire = _Wire(line, script, faults, rng)
    wall_ns = time.time_ns() - time.monotonic_ns()
    period_ns = 1e9 / script.rate_hz
    begin = free = time.monotonic_ns()
    try:
        for k, index in enumerate(_rows(len(script), passes, hold)):
            due = begin + round(k * period_ns)
            at_s = (due - begin) * 1e-9
            if not wire.follow(at_s, on_port):
                break
            timing = _send_row(wire, script, index, max(due, free), wire.is_silent(at_s), stop)
            if timing is None:
                break
            free, times = timing
            wire.tally.index.append(index)
            wire.tally.times.append((times[0] + wall_ns, times[1] + wall_ns))
            wire.tally.late_ns = max(wire.tally.late_ns, times[0] - due)
        wire.drain()
    finally:
        wire.close()
    return _transmission(script, wire.tally)


def _rows(count: int, passes: int, hold: bool) -> Iterator[int]:
    """Yield rows of the script in the order in which they are sent."""
    passes_done = 0
    while passes == 0 or passes_done < passes:
        yield from range(count)
        passes_done += 1
    while hold:
        yield count - 1


def _send_row(
    wire: _Wire, script: Script, index: int, start_ns: int, is_silent: bool, stop: Callable[[], bool]
) -> tuple[int, tuple[int, int]] | None:
    """Send request and reply; return when the wire is free and when each began, or None when stopped before."""
    begin_times: list[int] = []
    arrived_whole: list[bool] = []
    free_ns = start_ns
    frames = script.commands[index], script.states[index]
    # A request and its reply go or are lost together.
    has_room = wire.has_room(sum(map(len, frames)))
    for frame in frames:
        length_ns = wire_time_ns(len(frame), script.device.baud)
        # A request that went out is answered: a stop ends between rows.
        moment_ns = _wait(free_ns + length_ns, (lambda: False) if arrived_whole else stop, wire)
        if moment_ns is None:
            return None
        wire.send(frame, is_silent, has_room, arrived_whole)
        begin_times.append(moment_ns - length_ns)
        free_ns = moment_ns
    wire.tally.arrived_whole.append(arrived_whole)
    return free_ns, (begin_times[0], begin_times[1])


def _wait(until_ns: int, stop: Callable[[], bool], wire: _Wire) -> int | None:
    """Sleep until a moment of the monotonic clock; return the moment it is then, or None when stopped."""
    while True:
        if stop():
            return None
        remaining_ns = until_ns - (moment_ns := time.monotonic_ns())
        nap = wire.tick(moment_ns)
        if remaining_ns <= 0:
            return moment_ns
        time.sleep(min(remaining_ns, nap, _NAP_NS) * 1e-9)


def _transmission(script: Script, tally: _Tally) -> Transmission:
    """Return the value of a tally."""
    count = len(tally.index)
    times = np.array(tally.times, np.int64).reshape(count, 2)
    arrived_whole = np.array(tally.arrived_whole, bool).reshape(count, 2)
    counts = {
        "whole_commands": int(arrived_whole[:, 0].sum()),
        "whole_states": int(arrived_whole[:, 1].sum()),
        "dropped_frames": tally.dropped_frames,
        "dropped_bytes": tally.dropped_bytes,
        "received_bytes": tally.received_bytes,
        "faults": dict(sorted(tally.faults.items())),
    }
    return Transmission(
        script,
        np.array(tally.index, np.int64),
        times[:, 0],
        times[:, 1],
        arrived_whole[:, 0],
        arrived_whole[:, 1],
        counts,
        tally.late_ns * 1e-9,
    )
