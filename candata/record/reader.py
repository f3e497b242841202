"""The reader: a process of its own that stamps the bytes of a port as they come, and passes them on.

It is run as a file, imports nothing of candata, and does nothing else, so that no decoding and no disk delays its
stamps. It never writes to the port. One caution no program can lift: the kernel echoes what arrives between the
opening of a serial port and its set-up, so a listener's adapter should have its transmitter left unconnected.

Records on its standard output are `<B kind, q stamp, I length>` and that many bytes: raw bytes for DATA, else JSON.
"""

from __future__ import annotations

import json
import os
import select
import signal
import struct
import sys
import time
from collections import deque
from contextlib import suppress
from typing import Any

HEAD = struct.Struct("<BqI")
DATA, OPENED, LOST, BACK, FAILED = range(5)

_READ_BYTES = 65536
#: Ahead of other work, where the user may.
_PRIORITY = -10
_RETRY_S = 0.1
#: A pause this long ends the bytes of before; a frame at 83 Hz is followed by 3.6 ms of silence.
_PAUSE_MS, _STALE_S = 2, 0.1
#: Bytes kept for a recorder that stands still (five minutes of a busy hand); then the port is left to overflow.
_BACKLOG_BYTES = 64 * 1024 * 1024


class Outlet:
    """The pipe to the recorder, which never blocks the reader."""

    def __init__(self, handle: int) -> None:
        """Take over the writing end of a pipe."""
        os.set_blocking(handle, False)
        self.handle = handle
        self._waiting: deque[memoryview] = deque()
        self._bytes = 0

    @property
    def empty(self) -> bool:
        """Whether everything was handed over."""
        return not self._waiting

    @property
    def full(self) -> bool:
        """Whether the recorder lags so far that no more is taken."""
        return self._bytes >= _BACKLOG_BYTES

    def put(self, kind: int, stamp_ns: int, data: bytes) -> None:
        """Hand over a record as far as the pipe takes it; raises BrokenPipeError when the recorder is gone."""
        record = HEAD.pack(kind, stamp_ns, len(data)) + data
        self._waiting.append(memoryview(record))
        self._bytes += len(record)
        self.drain()

    def tell(self, kind: int, **facts: Any) -> None:
        """Hand over a record of facts, stamped now."""
        self.put(kind, time.monotonic_ns(), json.dumps(facts).encode())

    def drain(self) -> None:
        """Hand over what waits, as far as the pipe takes it; raises BrokenPipeError when the recorder is gone."""
        while self._waiting:
            try:
                count = os.write(self.handle, self._waiting[0])
            except BlockingIOError:
                return
            self._bytes -= count
            rest = self._waiting.popleft()[count:]
            if rest:
                self._waiting.appendleft(rest)

    def finish(self) -> None:
        """Hand over all that waits, however long the recorder takes."""
        os.set_blocking(self.handle, True)
        self.drain()


def main(arguments: list[str]) -> int:
    """Read the port of `{"port", "baud", "reconnect_s"}` until it or the recorder is gone; return an exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _PRIORITY)
    settings = json.loads(arguments[1])
    outlet = Outlet(sys.stdout.fileno())
    try:
        port, note = open_port(settings["port"], settings["baud"])
        outlet.tell(OPENED, note=note)
        while port is not None:
            read_until_lost(port, outlet)
            port.close()
            outlet.tell(LOST)
            port = reopen(settings, outlet)
    except BrokenPipeError:
        return 0
    except (OSError, ValueError) as error:
        outlet.tell(FAILED, reason="open", found=str(error), errno=getattr(error, "errno", None))
    outlet.finish()
    return 0


def open_port(name: str, baud: int) -> tuple[Any, str | None]:
    """Return the open port and a note, or none; raises OSError or ValueError."""
    import serial

    port = serial.Serial()
    port.port, port.baudrate, port.timeout, port.exclusive = name, baud, 0, True
    # Where the adapter's transmitter is switched by RTS, an asserted RTS would hold the bus.
    port.rts = False
    port.open()
    note = None
    try:
        port.set_low_latency_mode(True)
    except (OSError, ValueError, NotImplementedError):
        note = "the port has no low latency mode: stamps may be late by the driver's timer"
    _discard_stale(port.fileno())
    return port, note


def _discard_stale(handle: int) -> None:
    """Drop what waited in the port before it was opened: nobody knows when it came."""
    poll = select.poll()
    poll.register(handle, select.POLLIN)
    end = time.monotonic() + _STALE_S
    while time.monotonic() < end and poll.poll(_PAUSE_MS):
        if not os.read(handle, _READ_BYTES):
            return


def read_until_lost(port: Any, outlet: Outlet) -> None:
    """Pass on what the port gives until it is gone; raises BrokenPipeError when the recorder is."""
    handle = port.fileno()
    while True:
        poll = select.poll()
        if not outlet.full:
            poll.register(handle, select.POLLIN)
        poll.register(outlet.handle, 0 if outlet.empty else select.POLLOUT)
        ready = dict(poll.poll())
        if handle in ready:
            try:
                data = os.read(handle, _READ_BYTES)
            except BlockingIOError:
                continue
            except OSError:
                return
            stamp_ns = time.monotonic_ns()
            if not data:
                return
            outlet.put(DATA, stamp_ns, data)
        if ready.get(outlet.handle, 0) & select.POLLERR:
            raise BrokenPipeError
        outlet.drain()


def reopen(settings: dict[str, Any], outlet: Outlet) -> Any:
    """Return the same port once it can be opened again, or None after `reconnect_s` seconds."""
    poll = select.poll()
    poll.register(outlet.handle, 0)
    end = time.monotonic() + settings["reconnect_s"]
    while time.monotonic() < end:
        try:
            port, _ = open_port(settings["port"], settings["baud"])
        except (OSError, ValueError):
            if poll.poll(_RETRY_S * 1000):
                raise BrokenPipeError from None
            outlet.drain()
            continue
        outlet.tell(BACK)
        return port
    outlet.tell(FAILED, reason="unplugged", found=f"it did not come back in {settings['reconnect_s']:g} s", errno=None)
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv))
