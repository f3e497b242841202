"""The stand-ins beside an emulated hand: they play their streams on pseudo-terminals and sockets of this machine."""

from __future__ import annotations

import heapq
import select
import socket
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from candata.errors import SetupError, Where
from candata.record.emulate import DRAIN_S, RETRY_S, SETTLE_S, WAITING_BYTES
from candata.record.emulate_faults import Faults, with_fault
from candata.record.emulate_line import Line
from candata.record.emulate_session import SentStream

HOST = "127.0.0.1"
#: Longest sleep, so that a stop is heard soon [s].
_NAP_S = 0.05


class Heard(Protocol):
    """What a program may listen to."""

    def has_reader(self) -> bool:
        """Tell whether somebody listens, as far as it can be known."""


class Outlet(Heard, Protocol):
    """Where the bytes of a stream go; what nobody takes in time is lost."""

    @property
    def address(self) -> str:
        """What a recorder is told."""

    def write(self, data: bytes) -> int:
        """Return how many bytes went out."""

    def drain(self, limit_s: float) -> None:
        """Wait until the reader has taken what is on the way, at most `limit_s`."""

    def close(self) -> None:
        """Take it away."""


class SerialOutlet(Line):
    """A pseudo-terminal behind a link; frames wait for a late reader, up to `WAITING_BYTES`, or are lost whole."""

    def __init__(self, link: Path) -> None:
        """Open a port behind a link; raises as `Line`."""
        super().__init__(link)
        self._waiting_data = bytearray()

    @property
    def address(self) -> str:
        """The link."""
        return str(self.link or self.port)

    def write(self, data: bytes) -> int:
        """Return the length of a frame that goes out, now or later; 0 where it is lost."""
        if not self.has_reader():
            self._waiting_data.clear()
            return 0
        is_taken = len(self._waiting_data) + len(data) <= WAITING_BYTES
        self._waiting_data += data if is_taken else b""
        del self._waiting_data[: super().write(bytes(self._waiting_data))]
        return len(data) if is_taken else 0

    def drain(self, limit_s: float) -> None:
        """Wait until nothing waits, and the reader has taken what is on the line; each at most `limit_s`."""
        end_s = time.monotonic() + limit_s
        while self._waiting_data and time.monotonic() < end_s:
            self.write(b"")
            time.sleep(RETRY_S)
        super().drain(limit_s)


class TcpOutlet:
    """A server that sends the same to each client; a client that does not keep up loses whole frames.

    Parameters
    ----------
    port : int
        0: one that is free.

    Raises
    ------
    SetupError
        When the port is taken.
    """

    def __init__(self, port: int) -> None:
        """Listen."""
        self._server = _bound(socket.SOCK_STREAM, port)
        self._server.listen(4)
        self._server.setblocking(False)
        self._clients: list[socket.socket] = []
        self._rests: dict[socket.socket, bytes] = {}

    @property
    def address(self) -> str:
        """HOST:PORT."""
        return f"{HOST}:{self._server.getsockname()[1]}"

    def has_reader(self) -> bool:
        """Tell whether a client is connected."""
        while select.select([self._server], [], [], 0)[0]:
            client = self._server.accept()[0]
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients.append(client)
        return bool(self._clients)

    def write(self, data: bytes) -> int:
        """Return how many bytes went to the client that took least; nothing is cut within a frame."""
        if not self.has_reader():
            return 0
        return min(self._send(client, data) for client in list(self._clients))

    def _send(self, client: socket.socket, data: bytes) -> int:
        """Send to one client: the rest of the frame before first, then this one unless that still waits."""
        rest = self._rests.pop(client, b"")
        try:
            if rest and (sent := client.send(rest)) < len(rest):
                self._rests[client] = rest[sent:]
                return 0
            sent = client.send(data)
        except BlockingIOError:
            if rest:
                self._rests[client] = rest
            return 0
        except OSError:
            self._clients.remove(client)
            client.close()
            return 0
        if sent < len(data):
            self._rests[client] = data[sent:]
        return len(data)

    def drain(self, limit_s: float) -> None:
        """Return at once: the system delivers what was sent after the socket is closed."""

    def close(self) -> None:
        """Close all sockets."""
        for client in self._clients:
            client.close()
        self._clients = []
        self._server.close()


class UdpOutlet:
    """Sends datagrams to a port of this machine, whether somebody listens or not.

    Parameters
    ----------
    port : int
        0: one that is free now.
    """

    def __init__(self, port: int) -> None:
        """Open a socket."""
        if not port:
            with _bound(socket.SOCK_DGRAM, 0) as probe:
                port = probe.getsockname()[1]
        self._port = port
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    @property
    def address(self) -> str:
        """The address as a user types it."""
        return f"udp://{HOST}:{self._port}"

    def has_reader(self) -> bool:
        """Return True: UDP does not tell."""
        return True

    def write(self, data: bytes) -> int:
        """Return how many bytes went out."""
        try:
            return self._socket.sendto(data, (HOST, self._port))
        except OSError:
            return 0  # nobody listens yet, or no longer

    def drain(self, limit_s: float) -> None:
        """Return at once: a datagram is with its reader or lost."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _bound(kind: socket.SocketKind, port: int) -> socket.socket:
    """Return a socket of this machine at a port."""
    bound = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((HOST, port))
    except OSError as error:
        bound.close()
        place = Where(path=f"{HOST}:{port}")
        raise SetupError("the port is taken", found=error.strerror, where=place, fix="choose other --ports") from None
    return bound


def open_outlet(sent: SentStream, folder: Path, port: int) -> Outlet:
    """Return where a stream goes: `folder/NAME` for a serial one, else a port, 0 for a free one.

    Raises
    ------
    SetupError
        When the port is taken or there is no pseudo-terminal.
    """
    if sent.link == "serial":
        return SerialOutlet(folder / sent.name)
    return TcpOutlet(port) if sent.link == "tcp" else UdpOutlet(port)


def record_line(streams: Sequence[SentStream], outlets: Sequence[Outlet], hand_port: Path) -> str:
    """Return the `candata record-real` command that hears the hand and these streams."""
    options = {"xarm": "--arm", "pose_lines": "--pose", "ft300": "--wrench"}
    words = ["candata record-real", f"--port {hand_port}"]
    for sent, outlet in zip(streams, outlets, strict=True):
        option = options.get(sent.device_name)
        words.append(
            f"{option} {outlet.address}" if option else f"--stream {sent.name}={sent.device_name}@{outlet.address}"
        )
    return " ".join([*words, "--out session.mcap"])


@dataclass
class StreamTally:
    """What a stream has sent: a row for each frame.

    Attributes
    ----------
    at_s, time_ns, device_time_ns, is_whole : list
        The moment it describes [s from the start], when its first byte was on the wire [ns since 1970], what the
        device's clock said, whether it went out undamaged.
    dropped : int
        Frames that were not taken.
    faults : Counter
        By name.
    late_ns : int
        The most by which a frame was behind its time.
    """

    at_s: list[float] = field(default_factory=list)
    time_ns: list[int] = field(default_factory=list)
    device_time_ns: list[int] = field(default_factory=list)
    is_whole: list[bool] = field(default_factory=list)
    dropped: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    late_ns: int = 0

    def report(self) -> dict[str, Any]:
        """Return the counts as plain values."""
        return {
            "frames": len(self.at_s),
            "whole": sum(self.is_whole),
            "dropped": self.dropped,
            "faults": dict(sorted(self.faults.items())),
            "late_s": round(self.late_ns * 1e-9, 6),
        }


def wait_for_all(outlets: Sequence[Heard], stop: Callable[[], bool]) -> bool:
    """Return once each outlet that can tell has a reader that had `SETTLE_S` to set up; False when stopped before."""
    # Each is asked every time, so that clients are let in.
    while not all([outlet.has_reader() for outlet in outlets]):
        if stop():
            return False
        time.sleep(0.02)
    time.sleep(SETTLE_S)
    return True


def play_streams(
    streams: Sequence[SentStream],
    outlets: Sequence[Outlet],
    rng: np.random.Generator,
    *,
    faults: Faults,
    passes: int,
    stop: Callable[[], bool],
) -> list[StreamTally]:
    """Return what was sent, once all streams have been played `passes` times (0: for ever), or a stop was asked for.

    Each frame is written at its own absolute time, when its last byte would be on the wire. Serial streams have the
    faults of frames, all have the stalls.

    Parameters
    ----------
    streams, outlets : sequence
        What is sent, and where to; the outlets are closed at the end.
    rng : numpy.random.Generator
        Draws the faults.
    faults, passes, stop
        As in `candata.record.emulate.play`.
    """
    tallies = [StreamTally() for _ in streams]
    wall_ns, begin_ns = time.time_ns() - time.monotonic_ns(), time.monotonic_ns()
    due = [(sent.delay_s + sent.wire_s, index, 0) for index, sent in enumerate(streams)]
    heapq.heapify(due)
    try:
        while due and not stop():
            due_s, index, number = due[0]
            sent = streams[index]
            remaining_s = due_s - (time.monotonic_ns() - begin_ns) * 1e-9
            if remaining_s > 0:
                time.sleep(min(remaining_s, _NAP_S))
                continue
            _send(sent, outlets[index], tallies[index], number, faults, rng, wall_ns)
            tallies[index].late_ns = max(tallies[index].late_ns, round(-1e9 * remaining_s))
            heapq.heappop(due)
            next_s = (number + 1) / sent.rate_hz
            if passes == 0 or next_s < passes * sent.pass_s:
                heapq.heappush(due, (next_s + sent.delay_s + sent.wire_s, index, number + 1))
        for outlet in outlets:
            outlet.drain(DRAIN_S)
    finally:
        for outlet in outlets:
            outlet.close()
    return tallies


def _send(
    sent: SentStream,
    outlet: Outlet,
    tally: StreamTally,
    number: int,
    faults: Faults,
    rng: np.random.Generator,
    wall_ns: int,
) -> None:
    """Send one frame and note it; in a stall nothing is sent."""
    at_s = number / sent.rate_hz
    if any(begin <= at_s < begin + length for begin, length in faults.stalls):
        return
    device_time_ns = sent.device_time_ns(at_s)
    frame = sent.write(sent.value_at(at_s), number, device_time_ns)
    data, fault = frame, None
    if sent.link == "serial":
        data, fault = with_fault(frame, faults, lambda whole: whole, rng)
    if fault:
        tally.faults[fault] += 1
    tally.at_s.append(at_s)
    tally.time_ns.append(time.monotonic_ns() + wall_ns - round(1e9 * sent.wire_s))
    tally.device_time_ns.append(device_time_ns)
    is_taken = outlet.write(data) == len(data)
    tally.is_whole.append(is_taken and fault in (None, "head"))
    tally.dropped += not is_taken


def stream_truth(streams: Sequence[SentStream], tallies: Sequence[StreamTally]) -> Mapping[str, NDArray]:
    """Return what was sent as arrays: `NAME_time_ns`, `NAME_device_time_ns`, `NAME_whole`, and `NAME_SIGNAL`."""
    arrays: dict[str, NDArray] = {}
    for sent, tally in zip(streams, tallies, strict=True):
        arrays[f"{sent.name}_time_ns"] = np.array(tally.time_ns, np.int64)
        arrays[f"{sent.name}_device_time_ns"] = np.array(tally.device_time_ns, np.int64)
        arrays[f"{sent.name}_whole"] = np.array(tally.is_whole, bool)
        rows = [sent.value_at(at_s) for at_s in tally.at_s]
        arrays |= {f"{sent.name}_{name}": np.array([row[name] for row in rows]) for name in sent.values}
    return arrays
