"""Models that crash, hang or fill memory, shown as a user shows a scene; target: one clear error or a scene, each.

    python benchmarks/hard_models.py                    # all of them; some minutes
    python benchmarks/hard_models.py --only attach,fifo

Each model is made in a temporary folder with an empty cache, and `candata scene show` is run on its scene.yaml in a
process of its own. An answer is clear when the exit code is 0 and stderr holds no error, or 2 with an error of
candata's and no traceback, within 30 s of processor time and 90 s by the clock, with at most 5 GB in all its processes,
and nothing but the model's own files in the folder afterwards.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

from hard.models import CASES, SCENE

#: What an answer may take of a processor and by the clock [s], and its processes may hold together [bytes].
LIMIT_S, CLOCK_S, LIMIT_BYTES = 30.0, 90.0, 5_000_000_000
ROOT = Path(__file__).resolve().parents[1]


class Answer(NamedTuple):
    """What a user sees of a model: exit code, first line, whether that is clear, time, and memory of all processes."""

    code: int
    line: str
    clear: bool
    seconds: float
    cpu_s: float
    peak_bytes: int


def show(folder: Path, place: Path) -> Answer:
    """Return how `candata scene show` answers to the scene of a folder, nothing known from before."""
    (model,) = [path.name for path in folder.iterdir() if path.name.startswith("model.")]
    text = SCENE.format(model)
    if model.endswith("urdf"):
        text = text.replace("[a]", "{j: {kp: 1}}").replace("object: o\n", "")
    (folder / "scene.yaml").write_text(text)
    before = sorted(os.listdir(folder))
    env = os.environ | {"XDG_CACHE_HOME": str(place / "cache"), "PYTHONPATH": str(ROOT)}
    begun, before_s = time.monotonic(), cpu_of_children()
    with subprocess.Popen(
        [sys.executable, "-m", "candata_cli.main", "scene", "show", "scene.yaml"],
        cwd=folder,
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    ) as process:
        peak: list[int] = [0]
        watching = threading.Thread(target=watch, args=(process, peak, begun + CLOCK_S))
        watching.start()
        _, said = process.communicate()
        watching.join()
    seconds, cpu_s = time.monotonic() - begun, cpu_of_children() - before_s
    lines = [line for line in said.splitlines() if not re.match(r"model .* is loaded", line)]
    error = process.returncode == 2 and bool(lines)
    clear = (error or process.returncode == 0) and "Traceback" not in said and sorted(os.listdir(folder)) == before
    within = cpu_s <= LIMIT_S and seconds <= CLOCK_S and peak[0] <= LIMIT_BYTES
    line = "loads" if process.returncode == 0 else next(iter(lines), "")
    return Answer(process.returncode, line, clear and within, seconds, cpu_s, peak[0])


def cpu_of_children() -> float:
    """Return the CPU time of all processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def watch(process: subprocess.Popen[str], peak: list[int], ends_s: float) -> None:
    """Keep the most memory that a process and its children held; end them when it is too late or too much."""
    while process.poll() is None:
        held = {pid: resident(pid) for pid in family(process.pid)}
        peak[0] = max(peak[0], sum(held.values()))
        if time.monotonic() > ends_s or peak[0] > 2 * LIMIT_BYTES:
            for pid in held:
                os.kill(pid, 9)
        time.sleep(0.02)


def family(pid: int) -> list[int]:
    """Return a process and all that it started."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [pid, *(below for child in children for below in family(int(child)))]


def resident(pid: int) -> int:
    """Return the memory that a process holds [bytes]; 0 when it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="words that the kinds hold, comma-separated")
    words = parser.parse_args().only.split(",")
    print(f"{'kind':42}  exit  seconds  CPU s    MB  first line")
    unclear = []
    chosen = [kind for kind in CASES if any(word in kind for word in words)]
    for kind in chosen:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place, "scene")
            folder.mkdir()
            CASES[kind](folder)
            answer = show(folder, Path(place))
        if not answer.clear:
            unclear.append(kind)
        mark = " " if answer.clear else "*"
        numbers = f"{answer.code:4}{mark} {answer.seconds:8.1f}  {answer.cpu_s:5.1f}  {answer.peak_bytes / 1e6:4.0f}"
        print(f"{kind:42}  {numbers}  {answer.line[:110]!r}", flush=True)
    print(f"{len(chosen)} models: {len(chosen) - len(unclear)} clear errors or scenes; target: all")
    if unclear:
        print(f"not clear: {', '.join(unclear)}")
        sys.exit(1)


if __name__ == "__main__":
    main()
