"""`candata scene init`, and what a new user sees around it: from a model alone to a simulated set."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from candata.scenes import load_scene
from tests.cli.command import run
from tests.scenes import hand_models as models


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_from_a_model_to_a_simulated_set(folder):
    Path("hand.xml").write_text(models.TIP_GEOMS)
    done = run("diagnose", "real", "--scene", "hand.xml", "--out", "out")
    assert (done.code, "  do: candata scene init hand.xml, then give the scene file" in done.err) == (2, True)
    done = run("scene", "init", "hand.xml")
    assert (done.code, done.out) == (0, "scene.yaml: joints 16, actuators 16, fingertips 4, object cube, 100 Hz\n")
    assert done.err == "edit it, then: candata scene show scene.yaml\n"
    done = run("scene", "show", "scene.yaml")
    assert done.code == 0
    assert "object    cube, 0.1 kg; support floor" in done.out.splitlines()
    made = ("--episodes", 2, "--duration-s", 0.5, "--jobs", 1, "--out", "sim")
    assert run("generate-sim", "--scene", "scene.yaml", *made).code == 0


def test_every_key_has_a_comment_and_the_noise_is_left_to_the_user(folder):
    Path("hand.xml").write_text(models.TIP_BODIES)
    assert run("scene", "init", "hand.xml", "--out", "mine.yaml").code == 0
    lines = Path("mine.yaml").read_text().splitlines()
    keys = ["rate_hz", "joints", "actuators", "fingertips", "# object", "# support", "groups", "# noise"]
    for key in keys:
        at = next(i for i, line in enumerate(lines) if line.startswith(f"{key}:"))
        assert lines[at - 1].startswith("# "), key
    assert load_scene("mine.yaml").file.noise is None


def test_open_questions_are_told(folder):
    Path("hand.urdf").write_text(models.URDF)
    done = run("scene", "init", "hand.urdf")
    assert done.err.splitlines()[0] == (
        "check: the model has no actuators: the gains are guessed, fill in those of your drives"
    )
    Path("arm.xml").write_text(models.ON_ARM)
    done = run("scene", "init", "arm.xml", "--out", "arm.yaml")
    assert "check: several bodies are free, can, mug: the object is taken to be the first\n" in done.err
    Path("loose.xml").write_text(models.FLOATING)
    done = run("scene", "init", "loose.xml", "--out", "loose.yaml")
    assert "check: palm is the robot's own floating base: its pose has to be recorded\n" in done.err


def test_what_stands_is_overwritten_only_by_force(folder):
    Path("hand.xml").write_text(models.TIP_BODIES)
    Path("scene.yaml").write_text("mine")
    done = run("scene", "init", "hand.xml")
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        "the output exists already\n  where: scene.yaml\n  do: name another --out, or overwrite it with --force\n"
    )
    assert Path("scene.yaml").read_text() == "mine"
    assert run("scene", "init", "hand.xml", "--force").code == 0


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (("none.xml",), "model none.xml does not exist"),
        ((".",), "model . is a folder, no file"),
        (("hand.xml", "--out", "."), "the output exists already"),
        (("hand.xml", "--out", ".", "--force"), "--out . is a folder"),
        (("hand.xml", "--out", "scene.txt"), "scene.txt is no scene file"),
        (("pointer.xml",), "pointer.xml is a Git LFS pointer, which stands in place of the file"),
        (("text.xml",), "model text.xml is not XML"),
    ],
)
def test_a_wrong_word_is_a_usage_error(folder, words, first):
    Path("hand.xml").write_text(models.TIP_BODIES)
    Path("text.xml").write_text("hello")
    Path("pointer.xml").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12\n")
    before = sorted(os.listdir())
    done = run("scene", "init", *words)
    assert (done.code, done.err.splitlines()[0]) == (2, first)
    assert sorted(os.listdir()) == before


def test_a_place_where_no_file_can_be(folder):
    Path("hand.xml").write_text(models.TIP_BODIES)
    done = run("scene", "init", "hand.xml", "--out", "hand.xml/scene.yaml")
    assert (done.code, done.err.splitlines()[0]) == (3, "--out hand.xml/scene.yaml cannot be written")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written(folder):
    Path("models").mkdir()
    Path("models/hand.xml").write_text(models.TIP_BODIES)
    Path("models").chmod(0o500)
    done = run("scene", "init", "models/hand.xml")
    Path("models").chmod(0o700)
    assert (done.code, done.err.splitlines()[0]) == (3, "--out models/scene.yaml cannot be written")


def test_show_says_what_kind_of_drive_each_joint_has(folder):
    Path("arm.xml").write_text(models.ON_ARM)
    assert run("scene", "init", "arm.xml").code == 0
    lines = run("scene", "show", "scene.yaml").out.splitlines()
    rows = {cells[0]: cells[4:] for line in lines if (cells := re.split(r"  +", line))}
    assert rows["ffj0"] == ["ffj0", "torque motor", "-", "-", "1 N m", "ff"]
    assert rows["arm0"] == ["arm0", "position servo", "200 N m/rad", "20 N m s/rad", "-", "arm"]


def test_show_notes_what_is_commanded_and_not_recorded(folder):
    Path("hand.xml").write_text(models.TIP_BODIES)
    assert run("scene", "init", "hand.xml").code == 0
    text = Path("scene.yaml").read_text()
    Path("scene.yaml").write_text(text.replace("joints: [ffj0, ", "joints: [").replace("ff: [ffj0, ", "ff: ["))
    done = run("scene", "show", "scene.yaml")
    assert done.out.splitlines()[-1] == (
        "note: actuator ffj0_drive, a position servo, pulls joint ffj0, which is not recorded"
    )


def test_an_unknown_key_of_an_edited_file(folder):
    Path("hand.xml").write_text(models.TIP_BODIES)
    assert run("scene", "init", "hand.xml").code == 0
    with Path("scene.yaml").open("a") as file:
        file.write("suport: floor\n")
    done = run("scene", "show", "scene.yaml")
    assert done.code == 2
    assert done.err.startswith("scene.yaml is not valid: unknown key `suport`, did you mean `support`\n")
