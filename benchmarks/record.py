"""What the recorder loses: frames at 83 Hz beside a busy core, and time when the whole program is killed.

    python benchmarks/record.py --seconds 120 --kills 20

Both parts record the emulated hand, which drops what is not taken in time and keeps a table of what it sent. Lost
frames are those that went out whole between the first recorded state and the last and are not in the log. Lost time is
from the last state in the log to the last one sent before recorder and reader were killed, read without a repair.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from busy_machine import busy, wait_for

from candata.record.logs import read_log


def start(*arguments: object, stdout: int = subprocess.DEVNULL) -> subprocess.Popen:
    """Return a running `candata` command."""
    command = [sys.executable, "-m", "candata_cli.main", *map(str, arguments)]
    return subprocess.Popen(command, stdout=stdout, stderr=subprocess.DEVNULL, text=True)


@contextmanager
def hand(folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the port of an emulated hand at 83 Hz and where its truth stands once the context is left."""
    folder.mkdir()
    port, truth = folder / "hand", folder / "truth.npz"
    process = start("emulate", "xhand", "--rate", 83, "--loop", 0, "--link", port, "--truth", truth)
    try:
        wait_for(port.exists, 60, "the emulator made no port")
        yield port, truth
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def lost_frames(folder: Path, seconds: float) -> dict:
    """Return the states sent whole, the ones missing in the log, and the recorder's report."""
    log = folder / "busy.mcap"
    with hand(folder) as (port, truth_file), busy():
        recorder = start(
            "record-real",
            "--port",
            port,
            "--out",
            log,
            "--no-calibrate",
            "--duration",
            seconds,
            "--json",
            stdout=subprocess.PIPE,
        )
        report = json.loads(recorder.communicate()[0])
    read = read_log(log)
    with np.load(truth_file) as truth:
        sent_ns = truth["state_time_ns"]
        whole = truth["state_whole"]
    half_period = int(0.5e9 / read.meta.rate_hz)
    inside = (sent_ns > read.state_time_ns[0] - half_period) & (sent_ns < read.state_time_ns[-1] + half_period)
    dropped = int(np.count_nonzero(inside & ~whole))
    missing = int(np.count_nonzero(inside)) - len(read.state_time_ns)
    return {"sent": int(np.count_nonzero(inside)), "lost": missing, "dropped": dropped, "report": report}


def lost_time(folder: Path, kills: int, rng: np.random.Generator) -> list[float]:
    """Return the seconds lost by each kill."""
    logs = [folder / f"kill{i}.mcap" for i in range(kills)]
    killed_ns = []
    with hand(folder) as (port, truth_file):
        for log in logs:
            recorder = start("record-real", "--port", port, "--out", log, "--no-calibrate", "--plain")
            wait_for(lambda log=log: log.exists() and log.stat().st_size > 30_000, 60, "the recorder wrote nothing")
            time.sleep(rng.uniform(1.0, 3.0))
            killed_ns.append(kill(recorder))
    with np.load(truth_file) as truth:
        sent_ns = truth["state_time_ns"]
    lost = []
    for log, at_ns in zip(logs, killed_ns, strict=True):
        last = read_log(log).state_time_ns[-1]
        lost.append(max(0.0, (sent_ns[sent_ns <= at_ns][-1] - last) / 1e9))
    return lost


def kill(recorder: subprocess.Popen) -> int:
    """Kill the recorder and its reader at once; return when, in unix nanoseconds."""
    children = Path(f"/proc/{recorder.pid}/task/{recorder.pid}/children").read_text().split()
    at_ns = time.time_ns()
    for pid in (recorder.pid, *map(int, children)):
        os.kill(pid, signal.SIGKILL)
    recorder.wait()
    return at_ns


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0, help="length of the recording beside a busy core")
    parser.add_argument("--kills", type=int, default=20, help="number of kills")
    parser.add_argument("--seed", type=int, default=1, help="draws the moments of the kills")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.seconds > 0:
            result = lost_frames(folder / "busy", args.seconds)
            report = result["report"]
            print(
                f"frames lost in {report['duration_s']:.1f} s at {report['rate_hz']:.1f} Hz beside a busy core: "
                f"{result['lost']} of {result['sent']} (target 0); the port itself dropped {result['dropped']}"
            )
            longest_ms = report["longest_gap_s"] * 1e3
            print(f"  recorder: {report['gaps']} gaps, the longest {longest_ms:.0f} ms, {report['losses']}")
        if args.kills > 0:
            lost = lost_time(folder / "kills", args.kills, np.random.default_rng(args.seed))
            print(
                f"data lost on SIGKILL over {args.kills} kills: at most {max(lost):.3f} s, "
                f"median {np.median(lost):.3f} s (target 0.3 s)"
            )


if __name__ == "__main__":
    main()
