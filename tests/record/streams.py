"""Streams for tests: devices of one text line a frame, and senders of them over UDP and TCP."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from candata.record.addresses import Address, StreamSource
from candata.record.devices import Frame, Signal, StreamDevice


class LineFramer:
    """Cuts lines that begin with `v1 `; others are malformed."""

    def __init__(self) -> None:
        self._rest, self._counts = b"", {"frames": 0, "bytes": 0, "malformed": 0}

    @property
    def counts(self) -> Mapping[str, int]:
        return dict(self._counts)

    def feed(self, data: bytes, stamp_ns: int) -> list[Frame]:
        self._counts["bytes"] += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        good = [line for line in lines if line.startswith(b"v1 ")]
        self._counts["frames"] += len(good)
        self._counts["malformed"] += len(lines) - len(good)
        return [Frame("state", line, stamp_ns) for line in good]

    def finish(self) -> list[Frame]:
        self._rest = b""
        return []


def line_device(link: str, rate_hz: float, *signals: Signal, baud: int = 0) -> StreamDevice:
    """A device whose line holds a clock [ns] and then the numbers of its signals."""
    sizes = [int(np.prod(signal.shape)) for signal in signals]

    def decode(frames: Sequence[bytes]) -> dict[str, np.ndarray]:
        rows = [frame.split()[1:] for frame in frames]
        numbers = np.array([row[1:] for row in rows], np.float64).reshape(len(rows), sum(sizes))
        parts = np.split(numbers, np.cumsum(sizes)[:-1], axis=1)
        values = {s.name: part.reshape(len(rows), *s.shape) for s, part in zip(signals, parts, strict=True)}
        return {"clock": np.array([int(row[0]) for row in rows]), **values}

    return StreamDevice(
        summary="a line a frame",
        rate_hz=rate_hz,
        link=link,
        baud=baud,
        signals=(Signal("clock", (), "ns"), *signals),
        framer=LineFramer,
        decode=decode,
        device_time="clock",
    )


ARM_JOINTS = ("w0", "w1")
ARM = line_device(
    "tcp",
    200.0,
    Signal("joint_position", (2,), "rad", ARM_JOINTS),
    Signal("joint_target", (2,), "rad", ARM_JOINTS),
)
POSE = line_device("udp", 15.0, Signal("object_pose", (7,), "m"))
WRENCH = line_device("serial", 100.0, Signal("wrench", (6,), "N"), baud=19200)


def source(name: str, device: StreamDevice, place: str) -> StreamSource:
    return StreamSource(name, "line", device, Address(device.link, place, device.baud))


def line(number: int, values: Sequence[float]) -> bytes:
    return f"v1 {number * 1_000_000} {' '.join(map(repr, values))}\n".encode()


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Sender(threading.Thread):
    """Sends `line_of(number)` at a rate until stopped; `sent` holds the lines."""

    def __init__(self, send: Callable[[bytes], object], rate_hz: float, line_of: Callable[[int], bytes]) -> None:
        super().__init__(daemon=True)
        self.sent: list[bytes] = []
        self._send, self._period_s, self._line_of, self._ended = send, 1 / rate_hz, line_of, threading.Event()

    def run(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            text = self._line_of(len(self.sent))
            try:
                self._send(text)
            except OSError:
                return
            self.sent.append(text)
            due += self._period_s
            self._ended.wait(max(0.0, due - time.monotonic()))

    def stop(self) -> None:
        self._ended.set()
        self.join()


@contextmanager
def udp_sender(port: int, rate_hz: float, line_of: Callable[[int], bytes]) -> Iterator[Sender]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        sender = Sender(lambda data: out.sendto(data, ("127.0.0.1", port)), rate_hz, line_of)
        sender.start()
        yield sender
        sender.stop()


class LineServer:
    """A TCP server that sends lines to each client in turn; `drop` closes the connection of the one it has."""

    def __init__(self, rate_hz: float, line_of: Callable[[int], bytes]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._rate_hz, self._line_of = rate_hz, line_of
        self.senders: list[Sender] = []
        self._clients: list[socket.socket] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self._clients.append(client)
            self.senders.append(Sender(client.sendall, self._rate_hz, self._line_of))
            self.senders[-1].start()

    def heard(self) -> bytes:
        """What the newest client wrote."""
        try:
            return self._clients[-1].recv(1000, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return b""

    def drop(self) -> None:
        client = self._clients[-1]
        client.shutdown(socket.SHUT_RDWR)
        client.close()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for sender in self.senders:
            sender.stop()
        for client in self._clients:
            client.close()
        self._thread.join()
