"""The recorder's end of the reader: starts the process, takes its records, says what went wrong with a port."""

from __future__ import annotations

import errno
import importlib.util
import json
import os
import select
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from candata.errors import CandataError, MissingExtraError, SetupError, Where
from candata.record import reader

_KINDS: dict[int, Literal["data", "opened", "lost", "back", "failed"]] = {
    reader.DATA: "data",
    reader.OPENED: "opened",
    reader.LOST: "lost",
    reader.BACK: "back",
    reader.FAILED: "failed",
}
_PIPE_BYTES = 1 << 20
_START_S = 20.0


@dataclass(frozen=True)
class Event:
    """What the reader says: bytes (`data`), or that the port opened, was lost, came back or failed.

    Attributes
    ----------
    kind : str
        `data`, `opened`, `lost`, `back` or `failed`.
    stamp_ns : int
        Monotonic time of it [ns]; of bytes, right after they were read.
    data : bytes
        The bytes; empty for the other kinds.
    facts : dict
        What else is known; empty for bytes.
    """

    kind: Literal["data", "opened", "lost", "back", "failed"]
    stamp_ns: int
    data: bytes
    facts: dict[str, Any]


class ReaderLink:
    """A running reader; leave the context to end it."""

    def __init__(self, port: str, baud: int, reconnect_s: float) -> None:
        """Start the reader of `port` as a fresh process, outside of the terminal's foreground.

        Raises
        ------
        MissingExtraError
            When pyserial is not installed.
        SetupError
            When there is no such port, or it may not be opened.
        """
        if importlib.util.find_spec("serial") is None:
            raise MissingExtraError("pyserial", "record")
        check_port(port)
        self.port, self.ended = port, False
        self._rest: bytes = b""
        self._kept: list[Event] = []
        settings = json.dumps({"port": port, "baud": baud, "reconnect_s": reconnect_s})
        # A group of its own: neither Ctrl-C nor Ctrl-Z in the terminal stops the reading.
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(Path(reader.__file__)), settings],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            bufsize=0,
            process_group=0,
        )
        self._pipe = self._process.stdout.fileno() if self._process.stdout else -1

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
        first, *self._kept = events
        if first.kind == "failed":
            raise port_error(self.port, first.facts)
        return first

    def receive(self, timeout_s: float) -> list[Event]:
        """Return what the reader said, waiting for it up to `timeout_s`; `ended` is set once it is gone."""
        kept, self._kept = self._kept, []
        if not self.ended and select.select([self._pipe], [], [], 0 if kept else timeout_s)[0]:
            data = os.read(self._pipe, _PIPE_BYTES)
            self.ended = not data
            self._rest += data
        return kept + self._take()

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


def check_port(port: str) -> None:
    """Refuse a port that is not there or may not be opened.

    Raises
    ------
    SetupError
        With the ports that are there, or how to be allowed.
    """
    if not Path(port).exists():
        raise port_error(port, {"errno": errno.ENOENT})
    if not Path(port).is_char_device():
        raise port_error(port, {"errno": errno.ENOTTY})
    if not os.access(port, os.R_OK | os.W_OK):
        raise port_error(port, {"errno": errno.EACCES})


def port_error(port: str, facts: dict[str, Any]) -> CandataError:
    """Return the error of a port that failed, with what to do about it."""
    where, code, found = Where(path=port), facts.get("errno"), facts.get("found")
    if facts.get("reason") == "unplugged":
        return SetupError(
            "the port is gone", found=found, where=where, fix="plug it in again; --reconnect sets how long to wait"
        )
    if code == errno.ENOENT:
        return SetupError("no such port", found=_ports_seen(), where=where, fix="plug it in, or give another --port")
    if code == errno.ENOTTY:
        return SetupError(
            "not a serial port", found=_ports_seen(), where=where, fix="give a serial port, such as /dev/ttyUSB0"
        )
    if code in (errno.EACCES, errno.EPERM):
        return SetupError(
            "no permission for the port",
            where=where,
            fix='join the group that owns it, often `sudo usermod -aG dialout "$USER"`, and log in again',
        )
    return SetupError(
        "the port cannot be opened",
        found=found,
        where=where,
        fix="end the program that holds it, or give another --port",
    )


def _ports_seen() -> str:
    """Return the ports of this machine, for people."""
    from serial.tools import list_ports

    seen = [f"{port.device} ({port.description})" for port in list_ports.comports()]
    return "these ports: " + ", ".join(seen) if seen else "no serial port on this machine"
