"""How much memory a process needs for what it reads."""

from __future__ import annotations

import os
import subprocess
import sys

GIGABYTE = 2**30
_TAIL = """
(peak,) = [line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")]
print(peak)
"""


def memory_and_words(code: str, *words: object) -> tuple[int, str]:
    """Return the most memory [bytes] that a process needs to run some code, and what it prints."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code + _TAIL, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    *said, peak_kb = done.stdout.splitlines()
    return int(peak_kb) * 1024, "\n".join(said)
