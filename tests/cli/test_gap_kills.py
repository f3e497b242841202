"""`diagnose` and `gap bench` killed at any moment: the same command ends with the same report, from the same cache."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from candata.gap.run import cache as kept
from tests.cli.command import run

pytestmark = pytest.mark.hard

SCENE = ("--scene", "gripper_tabletop")
#: The fewest recordings that are diagnosed, short ones.
RECORDED = ("--episodes", 8, "--duration-s", 0.8, "--seed", 5, "--jobs", 1)
BENCH = (
    *("--scene", "cube_toss", "--episodes", 8, "--duration-s", 0.5, "--jobs", 2, "--kinds", "one,null"),
    *("--counts", "one=2,null=1", "--only", "sliding_friction,pose_bias", "--no-follow"),
)


def begin(*words: object) -> subprocess.Popen[str]:
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "candata_cli.main", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)


def kill_at(words: tuple[object, ...], moment) -> None:
    """Kill a command once `moment()` holds, unless it has ended by then."""
    with begin(*words) as process:
        while process.poll() is None and not moment():
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=60)


def after(seconds: float):
    until = time.monotonic() + seconds
    return lambda: time.monotonic() > until


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("kills") / "real"
    assert run("generate-sim", *SCENE, *RECORDED, "--out", folder).code == 0
    return folder


def whole(folder: Path) -> list[Path]:
    """The files of a cache that are under their names, not drafts in hidden folders; each reads back."""
    files = []
    for place, folders, names in os.walk(folder):  # unlike a glob, it bears folders that vanish meanwhile
        folders[:] = [name for name in folders if not name.startswith(".")]
        files += [Path(place, name) for name in names if name.endswith(".npz") and not name.startswith(".")]
    assert all(kept.read(path) is not None for path in files)
    return files


def test_a_diagnosis_that_was_killed_among_its_simulations_ends_with_the_same_report(recorded, tmp_path):
    words = ("diagnose", recorded, *SCENE, "--only", "joint_damping", "--jobs", 1)
    cache = ("--cache-dir", tmp_path / "cache")
    clean = run(*words, "--no-cache", "--out", tmp_path / "clean", "--json")
    assert clean.code == 0
    kill_at((*words, *cache, "--out", tmp_path / "out"), lambda: len(whole(tmp_path / "cache")) >= 2)
    assert len(whole(tmp_path / "cache")) >= 2
    assert not list((tmp_path / "out").glob("report.*"))
    again = run(*words, *cache, "--out", tmp_path / "out", "--json")
    assert again.out == clean.out
    assert (tmp_path / "out" / "report.json").read_bytes() == (tmp_path / "clean" / "report.json").read_bytes()
    assert whole(tmp_path / "cache")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_diagnosis_that_was_killed_at_random_moments_ends_with_the_same_report(recorded, tmp_path, seed):
    rng = random.Random(seed)
    words = ("diagnose", recorded, *SCENE, "--only", "joint_damping,object_mass,sliding_friction", "--jobs", 2)
    cache = ("--cache-dir", tmp_path / "cache")
    began = time.monotonic()
    clean = run(*words, "--no-cache", "--out", tmp_path / "clean", "--json")
    took_s = time.monotonic() - began
    for _ in range(5):
        kill_at((*words, *cache, "--out", tmp_path / "out"), after(rng.uniform(1.0, 1.3 * took_s)))
        whole(tmp_path / "cache")
        standing = tmp_path / "out" / "report.json"
        assert not standing.exists() or standing.read_text().strip() == clean.out.strip()
    assert run(*words, *cache, "--out", tmp_path / "out", "--json").out == clean.out


def reports(folder: Path) -> dict[str, object]:
    """Each case's report, by name; each once."""
    lines = [json.loads(line) for line in (folder / "results.jsonl").read_text().splitlines()]
    assert len({line["case"] for line in lines}) == len(lines)
    return {line["case"]: (line["report"], line["error"]) for line in lines}


@pytest.mark.slow
def test_a_bench_that_was_killed_at_random_moments_ends_with_the_same_score(tmp_path):
    rng = random.Random(0)
    words = ("gap", "bench", *BENCH, "--out")
    began = time.monotonic()
    assert run(*words, tmp_path / "clean").code == 0
    took_s = time.monotonic() - began
    (tmp_path / "out").mkdir()
    shutil.copy(tmp_path / "clean" / "sealed.json", tmp_path / "out")  # the same secrets, nothing else
    for _ in range(6):
        kill_at((*words, tmp_path / "out"), after(rng.uniform(0.5, 0.6 * took_s)))
        whole(tmp_path / "out")
    again = run(*words, tmp_path / "out")
    assert again.code == 0
    assert reports(tmp_path / "out") == reports(tmp_path / "clean")
    scores = [json.loads((tmp_path / name / "bench.json").read_text()) for name in ("out", "clean")]
    assert scores[0]["misses"] == scores[1]["misses"]


def test_a_second_bench_in_a_folder_is_refused(tmp_path):
    with begin("gap", "bench", *BENCH, "--out", tmp_path) as first:
        while not (tmp_path / "sealed.json").exists():
            assert first.poll() is None
            time.sleep(0.01)
        second = run("gap", "bench", *BENCH, "--out", tmp_path)
        first.kill()
        first.communicate(timeout=60)
    assert second.code == 2
    assert second.err.startswith("another gap bench or gap score works in this folder\n")
