"""Ctrl-C ends long commands with what is kept and what to type: real signals to processes and their workers."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from candata.datasets import open_dataset
from candata.datasets.versions import pending_parts
from tests.cli.command import run

ROOT = Path(__file__).resolve().parents[2]
#: A scene that is stepped in a moment, and enough episodes of it to be stopped among.
SIM = ("generate-sim", "--scene", "gripper_tabletop", "--duration-s", "1.0")


#: Runs a command, after a file that tells that Python has started and the command line is imported.
MARKED = "import pathlib, sys, candata_cli.main as entry; pathlib.Path(sys.argv.pop(1)).touch(); entry.main()"


def stop(
    command: tuple[object, ...], when: Callable[[], bool], then_s: float = 0.0, mark: Path | None = None
) -> tuple[int, str, str]:
    """Run a command as a terminal would, press Ctrl-C once `when` holds; return its exit code, stdout and stderr.

    The signal goes to the whole group: to the command and to all processes that it began. The file `mark` is made
    once the command line is imported: a signal before is Python's own to answer.
    """
    begin = ["-m", "candata_cli.main"] if mark is None else ["-c", MARKED, str(mark)]
    words = [sys.executable, *begin, *map(str, command)]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    # A job in the background of a shell ignores Ctrl-C, and so would what it starts.
    heard = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    with subprocess.Popen(words, text=True, start_new_session=True, env=env, **pipes, **heard) as process:
        until = time.monotonic() + 60
        while not when():
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < until, "the command does not come so far"
            time.sleep(0.01)
        time.sleep(then_s)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def told(command: tuple[object, ...], how: str) -> str:
    """The last line of a command that was stopped."""
    return f"  to {how}: {shlex.join(['candata', *map(str, command)])}\n"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("stopped") / "recordings of today"
    assert run(*SIM, "--episodes", 8, "--jobs", 1, "--out", out).code == 0
    return out


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_simulation_keeps_whole_parts_and_the_same_command_goes_on(tmp_path, jobs):
    out = tmp_path / "sim 1"
    command = (*SIM, "--episodes", 400, "--jobs", jobs, "--out", out)
    code, printed, err = stop(command, lambda: (out / "parts").is_dir() and any((out / "parts").glob("*/part.json")))
    kept = sum(len(part.episodes) for part in pending_parts(out))
    assert (code, printed) == (130, "")
    assert kept > 0
    assert err == f"stopped: {kept} episodes are kept in {out}\n" + told(command, "go on")
    assert not list((out / "staging").glob("*"))


@pytest.mark.parametrize("then_s", [0.0, 0.2, 0.5, 1.0])
def test_workers_that_have_just_begun_leave_without_a_traceback(tmp_path, then_s):
    out = tmp_path / "sim"
    command = (*SIM, "--episodes", 400, "--jobs", 2, "--out", out)
    code, _, err = stop(command, (out / "dataset.json").is_file, then_s)
    kept = sum(len(part.episodes) for part in pending_parts(out))  # none yet, or the first, on a fast machine
    assert (code, err) == (130, f"stopped: {kept} episodes are kept in {out}\n" + told(command, "go on"))


def test_a_diagnosis_keeps_what_was_simulated(recordings, tmp_path):
    cache, out = tmp_path / "cache", tmp_path / "report"
    command = ("diagnose", recordings, "--scene", "gripper_tabletop", "--out", out, "--cache-dir", cache, "--jobs", 1)
    simulated = lambda: [name for _, _, names in os.walk(cache) for name in names if name.endswith(".npz")]  # noqa: E731
    code, printed, err = stop(command, lambda: len(simulated()) > 3)
    assert (code, printed) == (130, "")
    assert err.endswith(f"\nstopped: what was simulated is kept in {cache}\n" + told(command, "go on"))
    assert "Traceback" not in err
    assert not out.exists()


def test_an_import_leaves_nothing(recordings, tmp_path):
    run("export", "robomimic", recordings, "--out", tmp_path / "foreign")
    out = tmp_path / "back"
    command = ("import", "robomimic", tmp_path / "foreign", "--out", out)
    drafts = lambda: any(tmp_path.glob(".back.candata-*/dataset/dataset.json"))  # noqa: E731
    code, _, err = stop(command, drafts)
    if code == 0:
        pytest.skip("it was done before the signal came")
    assert (code, err) == (130, "stopped: nothing was written\n" + told(command, "begin again"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["foreign"]


def test_a_bench_counts_what_stands(tmp_path):
    out = tmp_path / "bench"
    words = "--kinds null --counts null=8 --only object_mass --episodes 8 --jobs 2"
    command = ("gap", "bench", "--out", out, *words.split())
    code, printed, err = stop(command, lambda: any((out / "cases").glob("case-*/case.json")))
    made = len(list((out / "cases").glob("case-*/case.json")))
    assert (code, printed) == (130, "")
    assert err.endswith(f"stopped: {made} cases and 0 results are kept in {out}\n" + told(command, "go on"))
    assert "Traceback" not in err
    assert not list((out / "cases").glob(".*"))


@pytest.mark.parametrize("then_s", [0.02, 0.2])
def test_a_command_that_begins_is_stopped_without_a_traceback(recordings, tmp_path, then_s):
    command, mark = ("inspect", recordings), tmp_path / "imported"
    code, _, err = stop(command, mark.is_file, then_s, mark)
    if code == 0:
        pytest.skip("it was done before the signal came")
    assert (code, err) == (130, "stopped\n" + told(command, "begin again"))


def test_what_was_stopped_goes_on_to_the_same_dataset(tmp_path):
    out, whole = tmp_path / "sim", tmp_path / "whole"
    command = (*SIM, "--episodes", 40, "--jobs", 1)
    code, _, _ = stop((*command, "--out", out), lambda: any(out.glob("parts/*/part.json")))
    assert code == 130
    assert run(*command, "--out", out).code == run(*command, "--out", whole).code == 0
    assert open_dataset(out).digest == open_dataset(whole).digest
