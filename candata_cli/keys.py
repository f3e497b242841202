"""Keys of a terminal, one by one and without Enter; the terminal is put back as it was at any end."""

from __future__ import annotations

import os
import queue
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

#: How soon the thread that reads notices the end [s].
_PERIOD_S = 0.1
#: Bytes of one reading: more than a person types at once; a sequence of a special key comes in one.
_READ_BYTES = 64
_ESCAPE = "\x1b"

#: Returns what was typed since it was last asked: monotonic stamps [ns] and keys.
Typed = Callable[[], Sequence[tuple[int, str]]]


@contextmanager
def typed_keys() -> Iterator[tuple[Typed, str]]:
    """Yield `typed()`, and why there are no keys (empty where there are).

    Without a terminal on stdin, or in the background of one, there are none.
    """
    problem = _problem()
    if problem:
        yield (lambda: ()), problem
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    pressed: queue.SimpleQueue[tuple[int, str]] = queue.SimpleQueue()
    ended = threading.Event()
    reader = threading.Thread(target=_read, args=(terminal, pressed, ended), name="keys", daemon=True)
    try:
        tty.setcbreak(terminal, termios.TCSANOW)
        reader.start()
        try:
            yield (lambda: [pressed.get_nowait() for _ in range(pressed.qsize())]), ""
        finally:
            ended.set()
            # What is typed after the end is not this reader's, nor is a terminal that is opened later.
            reader.join(2 * _PERIOD_S)
    finally:
        with suppress(termios.error, OSError):  # the terminal may have gone
            termios.tcsetattr(terminal, termios.TCSANOW, before)


def _problem() -> str:
    """Return why keys cannot be read; empty where they can."""
    try:
        terminal = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return "stdin is closed"
    if not os.isatty(terminal):
        return "stdin is no terminal"
    with suppress(OSError):  # not the terminal that the command was started from: no job control
        return "" if os.tcgetpgrp(terminal) == os.getpgrp() else "the command runs in the background"
    return ""


def _read(terminal: int, pressed: queue.SimpleQueue[tuple[int, str]], ended: threading.Event) -> None:
    """Put what is typed into the queue until it ends or the terminal goes; what special keys send is no key."""
    with suppress(OSError, ValueError):
        while not ended.is_set():
            if not select.select([terminal], [], [], _PERIOD_S)[0]:
                continue
            data, stamp_ns = os.read(terminal, _READ_BYTES), time.monotonic_ns()
            if not data:
                return
            text = data.decode("utf-8", errors="replace")
            for key in "" if text.startswith(_ESCAPE) else text:
                pressed.put((stamp_ns, key))
