"""The reader: a process of its own that stamps the bytes of a port or socket as they come, and passes them on.

It is run as a file, imports nothing of candata, and does nothing else, so that no decoding and no disk delays its
stamps. It never writes to a port unless it is given a `poll`: bytes that the caller wants repeated. One caution no
program can lift: the kernel echoes what arrives between the opening of a serial port and its set-up, so a listener's
adapter should have its transmitter left unconnected.

Records on its standard output are `<B kind, q stamp, I length>` and that many bytes: raw bytes for DATA, else JSON.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import struct
import sys
import time
from collections import deque
from contextlib import suppress
from typing import Any

HEAD = struct.Struct("<BqI")
DATA, EVENT_OPENED, EVENT_LOST, EVENT_BACK, EVENT_FAILED, EVENT_ASKED = range(6)

_READ_BYTES = 65536
#: Ahead of other work, where the user may.
_PRIORITY = -10
_RETRY_S = 0.1
#: A pause this long ends the bytes of before; a frame at 83 Hz is followed by 3.6 ms of silence.
_PAUSE_MS, _STALE_S = 2, 0.1
#: Bytes kept for a recorder that stands still (five minutes of a busy hand); then the port is left to overflow.
_BACKLOG_BYTES = 64 * 1024 * 1024
#: How long a server has to take a connection, and what the kernel keeps of a socket that is not read for a while.
_CONNECT_S, _SOCKET_BYTES = 5.0, 4 * 1024 * 1024


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
    """Read the port of `{"link", "port", "baud", "reconnect_s", "poll"}` until it or the recorder is gone.

    `poll` is absent, or the hexadecimal bytes to write and how often: `{"bytes", "rate_hz"}`. Returns an exit code.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _go_ahead_of_others()
    settings = json.loads(arguments[1])
    outlet = Outlet(sys.stdout.fileno())
    try:
        port, note = open_port(settings)
        outlet.tell(EVENT_OPENED, note=note)
        while port is not None:
            read_until_lost(port, outlet, settings.get("poll"))
            port.close()
            outlet.tell(EVENT_LOST)
            port = reopen(settings, outlet)
    except BrokenPipeError:
        return 0
    except (OSError, ValueError) as error:
        outlet.tell(EVENT_FAILED, reason="open", found=str(error), errno=getattr(error, "errno", None))
    outlet.finish()
    return 0


def _go_ahead_of_others() -> None:
    """Be scheduled before all ordinary processes where the user may, or at least more often; stamps are late else."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, _PRIORITY)
    with suppress(OSError, AttributeError):  # not on macOS
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def open_port(settings: dict[str, Any]) -> tuple[Any, str | None]:
    """Return the open port or socket and a note, or none; raises OSError or ValueError."""
    if settings["link"] == "serial":
        return open_serial(settings["port"], settings["baud"])
    host, _, number = settings["port"].rpartition(":")
    host = host.strip("[]")
    if settings["link"] == "tcp":
        connection = socket.create_connection((host, int(number)), _CONNECT_S)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    else:
        family, *_, address = socket.getaddrinfo(host, int(number), type=socket.SOCK_DGRAM)[0]
        connection = socket.socket(family, socket.SOCK_DGRAM)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)
        connection.bind(address)
    connection.setblocking(False)
    return connection, None


def open_serial(name: str, baud: int) -> tuple[Any, str | None]:
    """Return the open serial port and a note, or none; raises OSError or ValueError."""
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


def read_until_lost(port: Any, outlet: Outlet, poll_plan: dict[str, Any] | None) -> None:
    """Pass on what the port gives until it is gone; raises BrokenPipeError when the recorder is."""
    handle = port.fileno()
    is_datagram = isinstance(port, socket.socket) and port.type == socket.SOCK_DGRAM
    due_s = time.monotonic()
    while True:
        poll = select.poll()
        if not outlet.full:
            poll.register(handle, select.POLLIN)
        poll.register(outlet.handle, 0 if outlet.empty else select.POLLOUT)
        wait_ms = None
        if poll_plan:
            due_s = ask(handle, outlet, poll_plan, due_s)
            wait_ms = max(0.0, 1e3 * (due_s - time.monotonic()))
        ready_handles = dict(poll.poll(wait_ms))
        if handle in ready_handles:
            try:
                data = os.read(handle, _READ_BYTES)
            except BlockingIOError:
                continue
            except OSError:
                return
            stamp_ns = time.monotonic_ns()
            if data:
                outlet.put(DATA, stamp_ns, data)
            elif not is_datagram:  # a datagram may be empty
                return
        if ready_handles.get(outlet.handle, 0) & select.POLLERR:
            raise BrokenPipeError
        outlet.drain()


def ask(handle: int, outlet: Outlet, plan: dict[str, Any], due_s: float) -> float:
    """Write the bytes of a poll if it is due, tell so, and return when the next one is [s]."""
    now_s = time.monotonic()
    if now_s < due_s:
        return due_s
    try:
        os.write(handle, bytes.fromhex(plan["bytes"]))
    except BlockingIOError:
        pass  # the port takes no more: this one is left out
    except OSError:
        return now_s + _RETRY_S  # a lost port shows when it is read
    else:
        outlet.tell(EVENT_ASKED)
    return max(due_s + 1.0 / plan["rate_hz"], now_s)


def reopen(settings: dict[str, Any], outlet: Outlet) -> Any:
    """Return the same port once it can be opened again, or None after `reconnect_s` seconds."""
    poll = select.poll()
    poll.register(outlet.handle, 0)
    end = time.monotonic() + settings["reconnect_s"]
    if settings["link"] == "tcp" and poll.poll(_RETRY_S * 1000):  # a server that drops at once is not hammered
        raise BrokenPipeError
    while time.monotonic() < end:
        try:
            port, _ = open_port(settings)
        except (OSError, ValueError):
            if poll.poll(_RETRY_S * 1000):
                raise BrokenPipeError from None
            outlet.drain()
            continue
        outlet.tell(EVENT_BACK)
        return port
    outlet.tell(
        EVENT_FAILED, reason="unplugged", found=f"it did not come back in {settings['reconnect_s']:g} s", errno=None
    )
    return None


if __name__ == "__main__":
    sys.exit(main(sys.argv))
