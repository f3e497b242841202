"""`candata scene object add`: from a mesh to a simulated set; what stands is not overwritten."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.command import run

#: A block with three square corners; its box is 60 x 40 x 30 mm.
BLOCK = "v 0 0 0\nv .06 0 0\nv 0 .04 0\nv 0 0 .03\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with a mesh."""
    monkeypatch.chdir(tmp_path)
    Path("block.obj").write_text(BLOCK)
    return tmp_path


def test_from_a_mesh_to_a_simulated_set(folder):
    done = run("scene", "object", "add", "block.obj", "--mass", 0.1, "--out", "objects/block")
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert lines[0] == "objects/block: block, 60 x 40 x 30 mm, 0.1 kg; convex pieces 1, inertia of its closed mesh"
    assert lines[1].split("  ")[0] == "rests in"
    shown = run("scene", "show", "objects/block/scene.yaml")
    assert "object    block, 0.1 kg; support table" in shown.out
    made = ("--episodes", 2, "--duration-s", 0.3, "--jobs", 1, "--out", "tosses")
    assert run("generate-sim", "--scene", "objects/block/scene.yaml", *made).code == 0


def test_json_is_the_record_of_the_object(folder):
    done = run("scene", "object", "add", "block.obj", "--mass", 0.1, "--out", "a", "--name", "wedge", "--json")
    record = json.loads(done.out)
    assert (record["name"], record["inertia"], len(record["pieces"])) == ("wedge", "exact", 1)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--mass", 0.1, "--out", "stands"), "the output exists already"),
        (("--mass", 0.1, "--out", "new", "--name", "../x"), "'../x' is no name of an object"),
        (("--mass", 0, "--out", "new"), "--mass is no number above 0"),
        (("--mass", 0.1, "--out", "new", "--scale", 1000), "--scale 0.001"),
    ],
)
def test_a_refusal_is_one_error_and_writes_nothing(folder, words, said):
    Path("stands").mkdir()
    done = run("scene", "object", "add", "block.obj", *words)
    assert (done.code, said in done.err, done.out) == (2, True, "")
    assert sorted(path.name for path in folder.iterdir()) == ["block.obj", "stands"]
    assert list(Path("stands").iterdir()) == []
