"""`record-real` killed at random moments beside `emulate`: what was flushed stands, and `recover` makes it whole."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.errors import DataError
from candata.record.logs import read_log
from candata.record.recover import recover
from candata.record.session_run import FILE_NAME, LOG_NAME, session_of
from tests.cli.command import run

pytestmark = pytest.mark.hard

#: 0.25 s lie between two flushes, and the rest is room for a busy machine; `benchmarks/record.py` holds it to 0.3 s.
LOST_S = 1.0


#: Python reads this first: the wall clock is set back by an hour once the log `{log}` has grown.
SET_BACK = """
import os, time
seconds, nanoseconds = time.time, time.time_ns
late_s = lambda: 3600 * (os.path.exists({log!r}) and os.path.getsize({log!r}) > 60_000)
time.time = lambda: seconds() - late_s()
time.time_ns = lambda: nanoseconds() - late_s() * 10**9
"""


def start(*words: object, stdout: int = subprocess.DEVNULL, first: Path | None = None) -> subprocess.Popen[str]:
    """Start a command; Python looks for its modules in the folder `first` before all others."""
    path = [str(first)] if first else []
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([*path, *sys.path])}
    command = [sys.executable, "-m", "candata_cli.main", *map(str, words)]
    return subprocess.Popen(command, stdout=stdout, stderr=subprocess.DEVNULL, text=True, env=env)


@contextmanager
def emulated(folder: Path) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """Yield the port of an emulated hand and its process; the truth stands in `truth.npz` once it has ended."""
    words = ("--duration-s", 0.6, "--still", 0.2, "--rate", 83, "--loop", 0, "--truth", folder / "truth.npz", "--json")
    with start("emulate", "xhand", *words, "--link", folder / "hand", stdout=subprocess.PIPE) as hand:
        assert hand.stdout is not None
        assert json.loads(hand.stdout.readline())["link"] == str(folder / "hand")
        try:
            yield folder / "hand", hand
        finally:
            hand.send_signal(signal.SIGINT)
            hand.communicate(timeout=60)


def children(pid: int) -> list[int]:
    try:
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def wait_until(done, limit_s: float = 60.0) -> None:
    until = time.monotonic() + limit_s
    while not done():
        assert time.monotonic() < until
        time.sleep(0.01)


def killed(port: Path, log: Path, moment_s: float, whole_program: bool) -> int:
    """Start a recording and kill it after so long, its reader too or not; return when [unix ns]."""
    with start("record-real", "--port", port, "--out", log, "--no-calibrate", "--plain") as recorder:
        time.sleep(moment_s)
        readers = children(recorder.pid)
        killed_ns = time.time_ns()
        recorder.kill()
        for pid in readers if whole_program else ():
            os.kill(pid, signal.SIGKILL)
        recorder.wait()
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in readers))  # none outlives its recorder
    return killed_ns


def kills(folder: Path, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    recorded: list[tuple[Path, int]] = []
    with emulated(folder) as (port, hand):
        for number in range(count):
            log = folder / f"{number}.mcap"
            # Half of them while it starts: a process begins within a second, or several on a busy machine.
            killed_ns = killed(
                port, log, rng.uniform(0.1, 2.0) if number % 2 else rng.uniform(2.0, 5.0), bool(number % 3)
            )
            assert hand.poll() is None, "the hand went with the recorder"
            if log.exists():
                recorded.append((log, killed_ns))
    with np.load(folder / "truth.npz") as truth:
        sent_ns = truth["state_time_ns"]
    with_states = 0
    for log, killed_ns in recorded:
        before = log.read_bytes()
        if not before:  # killed as the file was made
            with pytest.raises(DataError, match="the log is empty"):
                recover(log)
            continue
        saved = recover(log)
        assert log.read_bytes() == before
        whole = read_log(saved.out)
        assert not whole.torn
        assert saved.torn
        sent_last = int(sent_ns[sent_ns <= killed_ns][-1])
        if len(whole.state_time_ns):
            with_states += 1
            assert sent_last - whole.state_time_ns[-1] < LOST_S * 1e9
        else:  # nothing was flushed after its head
            assert sent_last - log.stat().st_mtime_ns < LOST_S * 1e9
    assert with_states >= count // 4


def test_killed_at_random_moments(tmp_path):
    kills(tmp_path, 4, seed=1)


@pytest.mark.slow
def test_killed_at_fifty_random_moments(tmp_path):
    kills(tmp_path, 50, seed=2)


def marks_beside(folder: Path) -> list[dict[str, object]]:
    """The marks in `session.json`, none before it is there."""
    path = folder / FILE_NAME
    return json.loads(path.read_text())["marks"] if path.exists() else []


def test_a_killed_session_keeps_every_mark_that_was_made(tmp_path):
    folder = tmp_path / "session"
    words = ("--session", folder, "--episodes", 50, "--duration", 0.2, "--gap", 0.05, "--calibrate-s", 0.5, "--plain")
    still = ("--duration-s", 0.6, "--still", 30, "--rate", 83, "--json", "--link", tmp_path / "hand")
    with start("emulate", "xhand", *still, stdout=subprocess.PIPE) as hand:
        assert hand.stdout is not None
        hand.stdout.readline()
        with start("record-real", "--port", tmp_path / "hand", *words) as recorder:
            wait_until(lambda: len(marks_beside(folder)) >= 7)
            recorder.kill()
            recorder.wait()
        hand.kill()
    kept = marks_beside(folder)  # whole, at whatever moment
    saved = recover(folder / LOG_NAME)
    session, drift = session_of(read_log(saved.out))
    assert [mark.model_dump(mode="json") for mark in session.marks][: len(kept)] == kept
    assert len(session.marks) <= len(kept) + 1  # a mark is flushed to the log before it is in the file
    assert drift is None
    done = run("import", "log", saved.out, "--out", tmp_path / "set")
    assert done.code == 0
    ended = [e.number for e in session.episodes if e.end_ns is not None]
    assert open_dataset(tmp_path / "set").ids[: len(ended)] == tuple(f"session-{number:04d}" for number in ended)


def test_a_hand_that_is_killed_leaves_a_log_that_says_so(tmp_path):
    """The other way round: the recorder waits for the port to come back, and ends in good order when told to."""
    with emulated(tmp_path) as (port, hand):
        log = tmp_path / "log.mcap"
        with start(
            "record-real", "--port", port, "--out", log, "--no-calibrate", "--plain", "--json", stdout=subprocess.PIPE
        ) as recorder:
            wait_until(lambda: log.exists() and log.stat().st_size > 30_000)
            hand.kill()
            hand.wait()
            time.sleep(0.5)
            recorder.send_signal(signal.SIGINT)
            facts = json.loads(recorder.communicate(timeout=60)[0])
    assert recorder.returncode == 0
    assert len(facts["unplugs"]) == 1
    whole = read_log(log)
    assert (whole.torn, len(whole.state_time_ns)) == (False, facts["rows"])


def test_a_clock_that_is_set_back_while_it_records_moves_no_row(tmp_path):
    log = tmp_path / "log.mcap"
    (tmp_path / "python").mkdir()
    (tmp_path / "python" / "sitecustomize.py").write_text(SET_BACK.format(log=str(log)))
    words = ("record-real", "--port", tmp_path / "hand", "--out", log, "--no-calibrate", "--plain", "--duration", 6)
    with emulated(tmp_path), start(*words, first=tmp_path / "python") as recorder:
        assert recorder.wait(timeout=120) == 0
    whole = read_log(log)
    offsets_s = [1e-9 * (s["clock"]["wall_ns"] - s["clock"]["monotonic_ns"]) for s in whole.statistics]
    assert max(offsets_s) - min(offsets_s) == pytest.approx(3600, abs=1)
    period_s = np.diff(whole.state_time_ns) * 1e-9
    assert period_s.min() > 0
    assert period_s.sum() == pytest.approx(6, abs=1)
    done = run("import", "log", log, "--uncalibrated", "--out", tmp_path / "set")
    assert done.code == 0
    (imported,) = open_dataset(tmp_path / "set")
    assert imported.time_s[-1] == pytest.approx(period_s.sum(), abs=0.1)
