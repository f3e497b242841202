"""`candata scene export` and `candata gap edit-test`: what they write, print and refuse; what effects.yaml runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import candata.gap
from candata.datasets import open_dataset
from candata.gap.verdict.figures import Evidence
from candata.gap.verdict.findings import Diagnosis
from candata.scenes import load_scene
from candata.schema.effect import EffectsFile
from candata.schema.report import DiagnosisData, EpisodeCount, Gap, Report
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.cli.test_diagnose import run
from tests.effects.gripper import write_scene

EFFECTS = """scene: scene.yaml
effects:
- {name: servo_gain, element: left, parameters: {kp_scale: 0.7}}
- {name: friction_cone, parameters: {cone: pyramidal}}
- {name: time_step, parameters: {time_step_s: 0.00125}}
- {name: clock_drift, parameters: {ppm: 20000}}
"""
MOTION = ("--episodes", 2, "--duration-s", 0.5, "--policies", "squeeze", "--jobs", 1, "--no-noise")


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A user's scene with its effects, seen from another working directory."""
    folder = tmp_path / "mine"
    folder.mkdir()
    write_scene(folder)
    (folder / "effects.yaml").write_text(EFFECTS)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return folder


@pytest.mark.parametrize("which", range(4))
def test_each_effect_of_the_file_runs(mine, which):
    effects = EffectsFile.parse(yaml.safe_load(EFFECTS), "effects.yaml").effects[which : which + 1]
    one = EffectsFile(scene="scene.yaml", effects=effects)
    (mine / "one.yaml").write_text(yaml.safe_dump(one.model_dump(mode="json")))
    done = run("generate-sim", "--effects", "../mine/one.yaml", *MOTION, "--out", "set")
    assert done.code == 0, done.err
    made = [e["joint_position"] for e in open_dataset("set").episodes()]
    scene = load_scene(mine / "scene.yaml")
    jobs = [EpisodeJob(e.meta.id, i, "squeeze", 1) for i, e in enumerate(open_dataset("set").episodes())]
    plain = [e["joint_position"] for e in make_episodes(scene, jobs, duration_s=0.5)]
    assert all(np.abs(a - b).max() > 1e-9 for a, b in zip(made, plain, strict=True))


def test_the_whole_file_runs_as_its_effects_do(mine):
    assert run("generate-sim", "--effects", "../mine/effects.yaml", *MOTION, "--out", "set").code == 0
    effects = EffectsFile.parse(yaml.safe_load(EFFECTS), "effects.yaml").effects
    scene = load_scene(mine / "scene.yaml")
    for i, episode in enumerate(open_dataset("set").episodes()):
        job = EpisodeJob(episode.meta.id, i, "squeeze", 1, effects)
        (again,) = make_episodes(scene, [job], duration_s=0.5)
        assert np.array_equal(episode["joint_position"], again["joint_position"])


def test_an_export_says_what_changed_and_what_is_left(mine):
    done = run("scene", "export", "--effects", "../mine/effects.yaml", "--out", "out")
    assert done.code == 0, done.err
    assert done.out == (
        "scene.yaml: your files, patched; holds servo_gain on left, friction_cone, time_step\n"
        "\n"
        "where         element        attribute  before    after\n"
        "scene.xml:32  position left  kp         -         1.4\n"
        "scene.xml:4   option         timestep   0.0025    0.00125\n"
        "scene.xml:4   option         cone       elliptic  pyramidal\n"
        "\n"
        "not in it:\n"
        "  clock_drift: MJCF has no attribute for it: the clock of the readings runs fast or slow against that of the "
        "commands\n"
        "    clock: stamp the recording with its true rate, or step this much more or less time between two rows; "
        "or run the effects.yaml beside this with candata\n"
    )
    assert done.err == "written: out\n"
    assert sorted(p.name for p in Path("out").iterdir()) == [
        "changes.diff",
        "effects.yaml",
        "export.json",
        "scene.xml",
        "scene.yaml",
    ]
    assert run("generate-sim", "--effects", "out/effects.yaml", *MOTION, "--out", "set").code == 0


def test_an_export_as_json_is_what_it_wrote(mine):
    done = run("scene", "export", "--effects", "../mine/effects.yaml", "--out", "out", "--json")
    assert json.loads(done.out) == json.loads(Path("out/export.json").read_text())
    assert json.loads(done.out)["left"][0]["name"] == "clock_drift"


def test_an_export_for_the_toolbox_takes_a_dataset(mine):
    assert run("generate-sim", "--scene", "../mine/scene.yaml", *MOTION, "--out", "set").code == 0
    args = ("scene", "export", "--effects", "../mine/effects.yaml", "--to", "mujoco-sysid", "--dataset", "set")
    done = run(*args, "--out", "out")
    assert done.code == 0, done.err
    assert done.out.startswith(
        "scene.xml: 2 sequences; free: servo_gain.left.kp_scale 0.7; fixed in the model: friction_cone, time_step\n"
    )
    assert "clock_drift" in done.out.partition("not in it:")[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--effects", "none.yaml", "--out", "o"), "the effects file cannot be read"),
        (("--effects", "../mine/effects.yaml", "--out", "."), "the output exists already"),
        (("--effects", "../mine/effects.yaml", "--out", "o", "--scene", "cube_toss"), "cannot act in scene cube_toss"),
        (("--effects", "../mine/effects.yaml", "--out", "o", "--to", "urdf"), "unknown target 'urdf'"),
        (("--effects", "../mine/effects.yaml", "--out", "o", "--to", "mujoco-sysid"), "go together"),
        (("--effects", "../mine/effects.yaml", "--out", "o", "--dataset", "set"), "go together"),
        (("--effects", "../mine/bare.yaml", "--out", "o"), "bare.yaml names no scene"),
        (("--effects", "../mine/lost.yaml", "--out", "o"), "scene file gone.yaml does not exist"),
    ],
)
def test_bad_input_is_refused_in_words(mine, arguments, message):
    (mine / "bare.yaml").write_text("effects: []\n")
    (mine / "lost.yaml").write_text("scene: gone.yaml\neffects: []\n")
    done = run("scene", "export", *arguments)
    assert (done.code, "Traceback" in done.err) == (2, False)
    assert message in done.err
    assert done.out == ""
    assert not Path("o").exists()


def test_another_scene_than_that_of_the_effects_is_said(mine):
    (mine / "effects.yaml").write_text(
        "scene: cube_toss\neffects: [{name: sliding_friction, parameters: {scale: 0.5}}]\n"
    )
    done = run("scene", "export", "--effects", "../mine/effects.yaml", "--scene", "../mine/scene.yaml", "--out", "o")
    assert done.code == 0
    assert done.err == "effects.yaml was made for another scene: cube_toss\nwritten: o\n"


TOSS = ("generate-sim", "--scene", "cube_toss", "--episodes", 8, "--duration-s", 0.7, "--jobs", 1)
#: A cube with half of the friction slides on.
SLIPPERY = "scene: cube_toss\neffects: [{name: sliding_friction, parameters: {scale: 0.5}}]\n"


@pytest.fixture
def tosses(tmp_path, monkeypatch):
    """Tosses of the slippery cube, and the effect that says so."""
    monkeypatch.chdir(tmp_path)
    Path("effects.yaml").write_text(SLIPPERY)
    assert run(*TOSS, "--effects", "effects.yaml", "--out", "real").code == 0
    return tmp_path


def test_edit_test_after_the_fact(tosses):
    done = run("gap", "edit-test", "real", "--effects", "effects.yaml", "--jobs", 1, "--json")
    found = json.loads(done.out)
    assert (done.code, found["kept"], found["reference"]) == (0, True, 1.0)
    assert run(*TOSS, "--seed", 3, "--out", "plain").code == 0
    done = run("gap", "edit-test", "plain", "--effects", "effects.yaml", "--jobs", 1)
    assert done.code == 1
    assert done.out.startswith("In plain@")
    assert "opens a gap" in done.out


def test_diagnose_adds_the_edit_test_to_its_report(tosses, monkeypatch):
    named = EffectsFile.parse(yaml.safe_load(SLIPPERY), "effects.yaml")
    data = DiagnosisData(dataset="first@0", episodes=EpisodeCount(total=8, folds=4, held_out=8))
    report = Report(verdict="explained", data=data, gap=Gap(before=3.0, after=1.1, closed=0.95, low=0.9, high=0.98))
    diagnosis = Diagnosis(report, Evidence(), named, named=named.effects)
    monkeypatch.setattr(candata.gap, "diagnose", lambda *a, **k: diagnosis)
    done = run("diagnose", "real", "--scene", "cube_toss", "--edit", "real", "--out", "out", "--jobs", 1)
    assert done.code == 0, done.err
    assert "edit test  It is kept in real@" in done.out
    written = json.loads(Path("out/report.json").read_text())["edit"]
    assert (written["kept"], written["reference"], written["episodes"]) == (True, 0.95, 8)
    assert "It is kept in real@" in Path("out/report.html").read_text()


def test_an_edit_that_does_not_fit_is_refused_before_the_diagnosis(tosses, monkeypatch):
    monkeypatch.setattr(candata.gap, "diagnose", lambda *a, **k: pytest.fail("diagnosed first"))
    first = ("diagnose", "real", "--scene", "cube_toss", "--out", "out")
    done = run(*first, "--edit", "real", "--edit-scene", "xhand_tabletop")
    assert (done.code, "Traceback" in done.err) == (2, False)
    done = run(*first, "--edit-scene", "cube_toss")
    assert done.code == 2
    assert "--edit-scene without --edit" in done.err
    assert not Path("out").exists()
