"""`generate-sim` killed at any moment of its first seconds: nothing half stands, and the same command goes on."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from candata.datasets import open_dataset
from candata.errors import CandataError
from candata.simulate.generate import generate

pytestmark = pytest.mark.hard

#: Six chunks: enough to be killed between two of them.
SET = ("--scene", "cube_toss", "--episodes", "96", "--seed", "7", "--duration-s", "0.4", "--jobs", "2")
#: What a dataset may consist of before its first version, as seen from it.
BEGUN = {"dataset.json", "staging", "objects", "parts"}


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> str:
    """The digest of the set, made by one that nobody kills."""
    folder = tmp_path_factory.mktemp("whole") / "set"
    return generate(folder, "cube_toss", 96, 7, duration_s=0.4, workers=1).digest


def begin(folder: Path, words: tuple[str, ...] = SET) -> subprocess.Popen[str]:
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "candata_cli.main", "generate-sim", *words, "--out", str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)


def killed_again_and_again(folder: Path, kills: int, rng: random.Random, reference: str) -> None:
    for _ in range(kills):
        with begin(folder) as run:
            time.sleep(rng.uniform(0.0, 4.0))
            run.kill()
            run.communicate(timeout=60)  # its workers hold the pipes: they have ended too
        if not list(folder.glob("versions/*.json")):
            assert not folder.exists() or {path.name for path in folder.iterdir()} <= BEGUN
            assert all((path / "part.json").is_file() for path in folder.glob("parts/*"))
            with pytest.raises(CandataError, match=r"not a dataset|empty dataset"):
                open_dataset(folder)
    stand = sum(1 for _ in folder.glob("parts/*"))
    with begin(folder) as run:
        printed, said = run.communicate(timeout=240)
    assert run.returncode == 0
    assert printed == f"{folder}: 96 episodes in version 1, digest {reference[:12]}\n"
    if 0 < stand < 6:
        assert f"going on: {stand * 16} of 96 episodes stand already\n" in said
    opened = open_dataset(folder)
    assert opened.digest == reference
    assert dict(opened.contents(opened.ids)) == {name: place.content_hash for name, place in opened.places.items()}


def test_killed_in_its_first_seconds(tmp_path, reference):
    killed_again_and_again(tmp_path / "set", 3, random.Random(1), reference)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_killed_in_its_first_seconds_many_times(tmp_path, reference, seed):
    killed_again_and_again(tmp_path / "set", 6, random.Random(seed), reference)


@pytest.mark.slow
def test_killed_while_it_tries_for_outcomes_and_leaves_episodes_out(tmp_path):
    words = ("--scene", "gripper_tabletop", "--policies", "grasp_lift_shake", "--episodes", "48", "--duration-s", "2")
    words = (*words, "--outcomes", "drop:0.5,success:0.5", "--jobs", "1")
    printed = []
    for name, kills in (("whole", 0), ("killed", 6)):
        rng = random.Random(3)
        for _ in range(kills):
            with begin(tmp_path / name, words) as run:
                time.sleep(rng.uniform(3.0, 12.0))
                run.kill()
                run.communicate(timeout=60)
        with begin(tmp_path / name, (*words, "--json")) as run:
            printed.append(json.loads(run.communicate(timeout=240)[0]))
    whole, killed = printed
    assert whole["quarantined"]
    assert {**killed, "dataset": whole["dataset"]} == whole


def test_a_run_that_was_killed_between_two_parts_says_how_much_stands(tmp_path, reference):
    told: list[str] = []

    def stop(_count: int) -> None:
        if list(tmp_path.glob("set/parts/*/part.json")):
            raise KeyboardInterrupt

    arguments = (tmp_path / "set", "cube_toss", 96, 7)
    with pytest.raises(KeyboardInterrupt):
        generate(*arguments, duration_s=0.4, workers=1, progress=stop, note=told.append)
    assert generate(*arguments, duration_s=0.4, workers=1, note=told.append).digest == reference
    assert told == ["going on: 16 of 96 episodes stand already"]
    assert generate(*arguments, duration_s=0.4, workers=1, note=told.append).number == 1
    assert len(told) == 1
