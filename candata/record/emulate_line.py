"""A pseudo-terminal that behaves like a serial line: nobody who writes to it waits for its reader."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import sys
import termios
import time
import tty
from pathlib import Path
from types import TracebackType
from typing import Self

from candata.errors import SetupError, UsageError, Where

#: Looks in a row that must find nothing waiting before a port counts as read out: on a busy machine the system hands on
#: in pieces what was written.
EMPTY_POLLS = 5


class Line:
    """One end of a line; the other is a port that any program can open.

    A pseudo-terminal keeps about 12 kB for its reader and then makes the writer wait. `write` never waits: it takes
    what fits, and nothing while nobody has the port open.
    """

    def __init__(self, link: Path | None = None) -> None:
        """Open a port.

        Parameters
        ----------
        link : Path, optional
            A symbolic link to make to the port; one that stands is replaced.

        Raises
        ------
        SetupError
            When the system gives no pseudo-terminal, or the link cannot be made.
        UsageError
            When something else than a link stands in the link's place.
        """
        self.link = link
        self.received_bytes = 0
        try:
            self._end, port = pty.openpty()
        except OSError as error:
            raise SetupError("no pseudo-terminal", found=error.strerror) from None
        self.port = os.ttyname(port)
        # The settings outlive this: the pair stays while one end is open, and the poll tells whether a reader came.
        tty.setraw(port)
        os.close(port)
        os.set_blocking(self._end, False)
        self._poll = select.poll()
        self._poll.register(self._end, select.POLLIN)
        if link is not None:
            try:
                _point(link, self.port)
            except BaseException:
                os.close(self._end)
                raise

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the line."""
        self.close()

    def has_reader(self) -> bool:
        """Tell whether a program has the port open; what it sent is read and counted."""
        for _end, events in self._poll.poll(0):
            if events & select.POLLIN:
                self._receive()
            if events & select.POLLHUP:
                return False
        return True

    def _receive(self) -> None:
        """Read and count what the reader sent."""
        try:
            self.received_bytes += len(os.read(self._end, 4096))
        except OSError:
            return  # the port was closed meanwhile

    def write(self, data: bytes) -> int:
        """Return how many bytes of `data` the port took, from the first on."""
        if not self.has_reader():
            return 0
        try:
            return os.write(self._end, data)
        except OSError:
            return 0

    def drain(self, limit_s: float) -> None:
        """Wait until the reader has taken what is on the line, at most `limit_s`: a port that goes takes it along."""
        if not self.has_reader():
            return
        end_s = time.monotonic() + limit_s
        try:
            port = os.open(self.port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            return
        empty_polls = 0
        while time.monotonic() < end_s and empty_polls < EMPTY_POLLS:
            time.sleep(0.02)  # what is still between the two ends comes when the system gets to it
            unread_bytes = int.from_bytes(fcntl.ioctl(port, termios.FIONREAD, bytes(4)), sys.byteorder)
            empty_polls = 0 if unread_bytes else empty_polls + 1
        os.close(port)

    def close(self) -> None:
        """Take the port away, as an unplugged cable does, and the link if it still leads there; once."""
        if self._end < 0:
            return
        os.close(self._end)
        self._end = -1
        if self.link is not None and self.link.is_symlink() and os.readlink(self.link) == self.port:
            self.link.unlink()


def _point(link: Path, port: str) -> None:
    """Make `link` lead to `port`, at once in place of an older link."""
    place = Where(path=str(link))
    if link.exists() and not link.is_symlink():
        raise UsageError("the link's place is taken", where=place, fix="choose another --link")
    new_link = link.with_name(f".{link.name}.{os.getpid()}")
    try:
        new_link.symlink_to(port)
        new_link.replace(link)
    except OSError as error:
        raise SetupError("the link cannot be made", found=error.strerror, where=place) from None
