"""What benchmarks of the recorder share: a core that is kept busy, and a wait with an end."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def busy() -> Iterator[None]:
    """Keep a core busy."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def wait_for(done: Callable[[], bool], limit_s: float, problem: str) -> None:
    """Return once `done()`; stop the benchmark after `limit_s`."""
    until = time.monotonic() + limit_s
    while not done():
        if time.monotonic() > until:
            raise SystemExit(problem)
        time.sleep(0.02)
