"""A hand on a pseudo-terminal, for the recorder's tests: it sends requests and replies and never reads."""

from __future__ import annotations

import os
import resource
import threading
import time
import tty
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from candata.record.devices import _xhand_frames as wire

ROWS = 40


class HandOnPty:
    """Sends frames at 83 Hz from a thread, waiting for a full buffer, or dropping what it does not take.

    A silent one has sent nothing until it is told to speak.
    """

    def __init__(self, link: str, frames: list[bytes], drops: bool, silent: bool):
        self.port, self.frames, self._drops = link, frames, drops
        self.wrote, self.dropped, self._next = bytearray(), 0, 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._plugged = False
        self.plug(silent)

    def plug(self, silent: bool = False) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        os.symlink(os.ttyname(self._slave), self.port)
        self._plugged = True
        if not silent:
            self.speak()

    def speak(self) -> None:
        self._stop.clear()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        if not self._plugged:
            return
        self._plugged = False
        self.hush()
        os.unlink(self.port)
        os.close(self.master)
        os.close(self._slave)

    def hush(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def heard(self) -> bytes:
        """What the other side wrote."""
        try:
            return os.read(self.master, 1000)
        except BlockingIOError:
            return b""

    def _send(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            self._write(self.frames[self._next % len(self.frames)])
            self._next += 1
            due += 1 / 83
            time.sleep(max(0.0, due - time.monotonic()))

    def _write(self, frame: bytes) -> None:
        while frame and not self._stop.is_set():
            try:
                count = os.write(self.master, frame)
            except BlockingIOError:
                count = 0
            self.wrote += frame[:count]
            frame = frame[count:]
            if self._drops:
                self.dropped += bool(frame)
                return
            if frame:
                time.sleep(0.001)


def frames_of(position=None, force=None) -> list[bytes]:
    """A request and its reply for each row; by default a resting hand."""
    position = np.zeros((ROWS, 12)) if position is None else position
    force = np.zeros((len(position), 5, 3), int) if force is None else force
    states = wire.state_frames(position, force, np.zeros((len(position), 5, 120, 3), int))
    return [a + b for a, b in zip(wire.command_frames(position), states, strict=True)]


@pytest.fixture
def hand(tmp_path) -> Iterator[Callable[..., HandOnPty]]:
    """Makes hands: `hand()` rests; `hand(frames=[...])` sends those bytes, one item a period."""
    made: list[HandOnPty] = []

    def make(
        frames: list[bytes] | None = None, drops: bool = False, silent: bool = False, **rows: np.ndarray
    ) -> HandOnPty:
        made.append(HandOnPty(str(tmp_path / f"port{len(made)}"), frames or frames_of(**rows), drops, silent))
        return made[-1]

    yield make
    for one in made:
        one.unplug()


@pytest.fixture
def file_limit():
    """Lets files of this process grow to 150 kB only: the nearest to a full disk that needs no privilege."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
