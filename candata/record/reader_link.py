"""The recorder's end of the reader: starts the process, takes its records, says what went wrong with a port."""

from __future__ import annotations

import errno
import grp
import importlib.util
import json
import os
import select
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from candata.errors import CandataError, MissingExtraError, SetupError, UsageError, Where
from candata.record import reader
from candata.record.addresses import Address

EventKind = Literal["data", "opened", "lost", "back", "failed", "asked"]
_KINDS: dict[int, EventKind] = {
    reader.DATA: "data",
    reader.EVENT_OPENED: "opened",
    reader.EVENT_LOST: "lost",
    reader.EVENT_BACK: "back",
    reader.EVENT_FAILED: "failed",
    reader.EVENT_ASKED: "asked",
}
_PIPE_BYTES = 1 << 20
_START_S = 20.0
#: Debian's group of serial ports.
_SERIAL_GROUP = "dialout"


@dataclass(frozen=True)
class Event:
    """What the reader says: bytes (`data`), or that the port opened, was lost, came back, failed or was asked.

    Attributes
    ----------
    kind : str
        `data`, `opened`, `lost`, `back`, `failed`, or `asked`: bytes of a poll were written.
    stamp_ns : int
        Monotonic time of it [ns]; of bytes, right after they were read.
    data : bytes
        The bytes; empty for the other kinds.
    facts : dict
        What else is known; empty for bytes.
    """

    kind: EventKind
    stamp_ns: int
    data: bytes
    facts: dict[str, Any]


@dataclass(frozen=True)
class Poll:
    """What is written to a port, and how often [Hz]: a caller's set-point, repeated."""

    frame: bytes
    rate_hz: float


class ReaderLink:
    """A running reader; leave the context to end it."""

    def __init__(self, address: Address, reconnect_s: float, poll: Poll | None = None) -> None:
        """Start the reader of an address as a fresh process, outside of the terminal's foreground.

        Raises
        ------
        MissingExtraError
            When pyserial is not installed.
        SetupError
            When there is no such port, or it may not be opened.
        UsageError
            When there is a poll for something that is no serial port.
        """
        if poll is not None and address.link != "serial":
            raise UsageError("only a hand on a serial port is polled", found=str(address), fix="leave out --poll")
        if address.link == "serial":
            if importlib.util.find_spec("serial") is None:
                raise MissingExtraError("pyserial", "record")
            check_port(address.place)
        self.address, self.ended = address, False
        self._rest: bytes = b""
        self._kept: list[Event] = []
        settings = {**vars(address), "port": address.place, "reconnect_s": reconnect_s}
        if poll is not None:
            settings["poll"] = {"bytes": poll.frame.hex(), "rate_hz": poll.rate_hz}
        # A group of its own: neither Ctrl-C nor Ctrl-Z in the terminal stops the reading.
        self._process = subprocess.Popen(
            [*_command(address), json.dumps(settings)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)} if address.link == "log" else None,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            bufsize=0,
            process_group=0,
        )
        self.pipe = self._process.stdout.fileno() if self._process.stdout else -1

    @property
    def pid(self) -> int:
        """Process id of the reader."""
        return self._process.pid

    def opened(self) -> Event:
        """Wait until the port is open and return that event.

        Raises
        ------
        SetupError
            When it cannot be opened.
        """
        events = self.receive(_START_S)
        if not events:
            raise SetupError("the reader did not start", found=f"nothing in {_START_S:g} s", fix="try again")
        first_event, *self._kept = events
        if first_event.kind == "failed":
            raise port_error(self.address, first_event.facts)
        return first_event

    def receive(self, timeout_s: float) -> list[Event]:
        """Return what the reader said, waiting for it up to `timeout_s`; `ended` is set once it is gone."""
        kept_events, self._kept = self._kept, []
        if not self.ended and select.select([self.pipe], [], [], 0 if kept_events else timeout_s)[0]:
            data = os.read(self.pipe, _PIPE_BYTES)
            self.ended = not data
            self._rest += data
        return kept_events + self._take()

    def close(self) -> None:
        """End the reader: it stops by itself once its pipe has no reader."""
        if self._process.stdout:
            self._process.stdout.close()
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the reader."""
        self.close()

    def _take(self) -> list[Event]:
        """Return the whole records among what was received."""
        events, at = [], 0
        while len(self._rest) >= at + reader.HEAD.size:
            kind, stamp_ns, length = reader.HEAD.unpack_from(self._rest, at)
            end = at + reader.HEAD.size + length
            if end > len(self._rest):
                break
            data, at = self._rest[at + reader.HEAD.size : end], end
            facts = {} if kind == reader.DATA else json.loads(data)
            events.append(Event(_KINDS[kind], stamp_ns, data if kind == reader.DATA else b"", facts))
        self._rest = self._rest[at:]
        return events


def _command(address: Address) -> list[str]:
    """Return the command of the reader of an address."""
    if address.link == "log":
        return [sys.executable, "-P", "-m", "candata.record.replay"]
    return [sys.executable, "-P", str(Path(reader.__file__))]


def wait_for_events(links: Sequence[ReaderLink], timeout_s: float) -> None:
    """Wait until one of the readers says something, for at most `timeout_s`."""
    select.select([link.pipe for link in links if not link.ended], [], [], timeout_s)


def check_port(port: str) -> None:
    """Refuse a serial port that is not there or may not be opened.

    Raises
    ------
    SetupError
        With the ports that are there, or how to be allowed.
    """
    address = Address("serial", port)
    if not Path(port).exists():
        raise port_error(address, {"errno": errno.ENOENT})
    if not Path(port).is_char_device():
        raise port_error(address, {"errno": errno.ENOTTY})
    if not os.access(port, os.R_OK | os.W_OK):
        raise port_error(address, {"errno": errno.EACCES})


def port_error(address: Address, facts: dict[str, Any]) -> CandataError:
    """Return the error of a port or socket that failed, with what to do about it."""
    place, code, reason = Where(path=str(address)), facts.get("errno"), facts.get("found")
    if facts.get("reason") == "unplugged":
        fix = "plug it in again" if address.link == "serial" else "start what serves it"
        return SetupError(
            f"the {'port' if address.link == 'serial' else 'connection'} is gone",
            found=reason,
            where=place,
            fix=f"{fix}; --reconnect sets how long to wait",
        )
    if address.link != "serial":
        return _network_error(address, code, reason)
    if code == errno.ENOENT:
        return SetupError("no such port", found=_ports_seen(), where=place, fix="plug it in, or give another port")
    if code == errno.ENOTTY:
        return SetupError(
            "not a serial port", found=_ports_seen(), where=place, fix="give a serial port, such as /dev/ttyUSB0"
        )
    if code in (errno.EACCES, errno.EPERM):
        group = _group_of(address.place)
        return SetupError(
            "no permission for the port",
            expected=f"a member of the group {group}, which owns it",
            where=place,
            fix=f'join it, `sudo usermod -aG {group} "$USER"`, and log in again',
        )
    return SetupError(
        "the port cannot be opened",
        found=reason,
        where=place,
        fix="end the program that holds it, or give another port",
    )


def _network_error(address: Address, code: int | None, reason: str | None) -> CandataError:
    """Return the error of a connection that was refused or a socket that was not given."""
    if code == errno.ECONNREFUSED:
        words, fix = "nothing serves this address", "switch the device on, check its address and port"
    elif code == errno.EADDRINUSE:
        words, fix = "the address is taken by another program", "end that program, or send to another port"
    elif code == errno.EADDRNOTAVAIL and address.link == "udp":
        words, fix = "this machine has no such address", "give one of its own, or 0.0.0.0 for all of them"
    elif code in (errno.EACCES, errno.EPERM):
        words, fix = "no permission for the address", "give a port above 1023"
    else:
        words, fix = "the address cannot be reached", "check host, port, cable and network"
    return SetupError(words, found=reason, where=Where(path=str(address)), fix=fix)


def _group_of(port: str) -> str:
    """Return the group that owns a port; that of serial ports where nobody should join the owner's."""
    try:
        group = grp.getgrgid(Path(port).stat().st_gid).gr_name
    except (OSError, KeyError):
        return _SERIAL_GROUP
    return _SERIAL_GROUP if group == "root" else group


def _ports_seen() -> str:
    """Return the ports of this machine, for people."""
    from serial.tools import list_ports

    ports = [f"{port.device} ({port.description})" for port in list_ports.comports()]
    return "these ports: " + ", ".join(ports) if ports else "no serial port on this machine"
