"""Every example runs from one command: all of them are listed, their steps are commands that exist, failures stop."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from candata.scenes import load_scene
from candata_cli.main import build

FOLDER = Path(__file__).resolve().parents[2] / "examples"
#: Examples that diagnose recordings; one that is a package of its own is run in `test_plugin.py`.
NAMES = sorted(p.parent.name for p in FOLDER.glob("*/README.md") if not (p.parent / "pyproject.toml").exists())


@pytest.fixture(scope="module")
def script(loaded):
    return loaded("run.py")


@pytest.fixture(scope="module")
def accepted():
    """The function that parses a candata command as the command line does; raises on a word that it does not know."""
    root = typer.main.get_command(build())

    def parse(words: tuple[str, ...]) -> None:
        command, rest = root, list(words)
        while getattr(command, "commands", None):
            command = command.commands[rest.pop(0)]
        command.make_context("", rest)

    return parse


def test_every_folder_of_the_examples_has_its_command_and_tells_it(script):
    assert sorted(script.EXAMPLES) == NAMES
    untold = [n for n in NAMES if f"python examples/run.py {n}" not in (FOLDER / n / "README.md").read_text()]
    assert not untold


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("more", [[], ["--from", "published", "--seed", "3"]], ids=["plain", "from"])
def test_the_steps_are_commands_that_exist(script, accepted, name, more):
    steps = script.EXAMPLES[name](name, script.parsed([name, *more]))
    assert len(steps) >= 2
    for step in steps:
        if step.words[0] == "candata":
            accepted(step.words[1:])
        else:
            assert Path(step.words[0]).exists()


def test_each_set_of_real_servos_has_its_scene_and_its_steps(script):
    for name in script.REAL_SERVOS:
        steps = script.EXAMPLES["real_servos"]("real_servos", script.parsed(["real_servos", "--set", name]))
        scenes = {word for step in steps for word in step.words if word.endswith("scene.yaml")}
        (scene,) = scenes
        assert load_scene(scene).file.joints
        assert steps[0].words[:3] == ("candata", "fetch", name.replace("_", "-"))


def test_a_word_that_no_command_knows_is_seen(accepted):
    with pytest.raises(Exception, match="No such option"):
        accepted(("diagnose", "data", "--scene", "s.yaml", "--out", "o", "--sed", "1"))


def test_a_step_that_fails_ends_the_run_with_its_status(script, monkeypatch):
    ran = []

    def steps(name: str, asked: argparse.Namespace):
        return [script.Step(("candata", word)) for word in ("good", "bad", "never")]

    def fake(words: list[str], check: bool):
        ran.append(words[-1])
        return subprocess.CompletedProcess(words, 3 if words[-1] == "bad" else 0)

    monkeypatch.setitem(script.EXAMPLES, "cube_tosses", steps)
    monkeypatch.setattr(script.subprocess, "run", fake)
    monkeypatch.setattr(sys, "argv", ["run.py", "cube_tosses"])
    with pytest.raises(SystemExit) as stopped:
        script.main()
    assert stopped.value.code == 3
    assert ran == ["good", "bad"]


def test_what_is_there_already_is_not_made_again(script, monkeypatch, tmp_path):
    monkeypatch.setattr(script.subprocess, "run", lambda *_, **__: pytest.fail("ran"))
    made = tmp_path / "dataset.json"
    made.touch()
    assert script.run(script.Step(("candata", "fetch"), made)) == 0


@pytest.mark.slow
def test_the_robot_without_a_model_end_to_end(shared, tmp_path):
    given = ["g1_inspire_pick", "--from", str(shared / "realdata/g1_inspire_pick"), "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, str(FOLDER / "run.py"), *given], capture_output=True, text=True, check=False, cwd=FOLDER.parent
    )
    assert done.returncode == 0, done.stderr
    assert "13 of 26 joints move enough" in done.stdout
    assert "RightHandThumbBend" in next(line for line in done.stdout.splitlines() if "poor" in line)


def test_a_split_that_names_nothing_is_not_passed_off_as_repaired(loaded):
    measures = {
        "object_position_m": {"before": 0.03, "before_sd": 0.01, "after": 0.0131, "after_sd": 0.008},
        "object_rotation_deg": {"before": 22.0, "before_sd": 20.0, "after": 16.0, "after_sd": 19.0},
    }
    cone = {"name": "friction_cone", "parameters": {"cone": {"value": "elliptic"}}}
    made = {"measures": measures, "data": {"episodes": {"held_out": 486}}}
    reports = {
        "split-0": {**made, "verdict": "partly_explained", "effects": [cone]},
        "split-1": {**made, "verdict": "unknown_effect", "effects": []},
    }
    lines = loaded("cube_tosses/compare.py").table(reports)
    assert "split-1     unknown_effect: nothing named" in lines
    assert [line.split("  ")[1] for line in lines if "(names nothing)" in line] == ["split-1 (names nothing)"]
    assert lines[-1].startswith("split-1: ")
    assert "no repair is offered" in lines[-1]
