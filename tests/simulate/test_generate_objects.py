"""Sets of several objects: each takes its turn, with its own cloud, name and scene, wherever its folder lies."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import trimesh

from candata.datasets import get_cloud, open_dataset
from candata.errors import DataError, SceneError, UsageError
from candata.gap import diagnose
from candata.repair import export_mjcf
from candata.scenes import load_scene
from candata.scenes.object_making import ObjectSource, make_object
from candata.simulate.generate import generate
from tests.cli.command import run

#: Short tosses of two objects in two chunks.
TOSS = {"scene": "cube_toss", "episodes": 18, "seed": 7, "duration_s": 0.2}


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    """The folder of a small block."""
    folder = tmp_path_factory.mktemp("objects")
    trimesh.creation.box((0.05, 0.03, 0.02)).export(folder / "block.stl")
    make_object(ObjectSource(folder / "block.stl", "block", 0.1), folder / "block", drops=20)
    return folder / "block"


def test_objects_take_turns_with_their_own_cloud_and_scene(tmp_path, block):
    version = generate(tmp_path / "set", **TOSS, objects=("can", str(block)), workers=1)
    episodes = list(open_dataset(tmp_path / "set"))
    assert [e.meta.object for e in episodes] == ["can", "block"] * 9
    assert {(e.meta.object, e.meta.scene) for e in episodes} == {("can", "cube_toss+can"), ("block", "cube_toss+block")}
    digests = {name: load_scene(f"cube_toss+{path}").digest for name, path in (("can", "can"), ("block", block))}
    assert {e.meta.object: e.meta.labels["scene_digest"] for e in episodes} == digests
    assert version.lineage[0].details["objects"] == digests
    clouds = {e.meta.object: get_cloud(tmp_path / "set", e.meta.point_cloud) for e in episodes}
    np.testing.assert_allclose(np.abs(clouds["can"]).max(0), [0.03, 0.03, 0.06], atol=1e-3)
    np.testing.assert_allclose(np.abs(clouds["block"]).max(0), [0.025, 0.015, 0.01], atol=1e-6)


def test_each_object_is_there_for_one_round_of_the_motions(tmp_path):
    motions = ("push", "free_sweep")
    asked = {"scene": "gripper_tabletop", "episodes": 4, "seed": 1, "policies": motions, "duration_s": 0.1}
    generate(tmp_path / "set", **asked, objects=("can",), workers=1)
    assert [(e.meta.object, e.meta.task) for e in open_dataset(tmp_path / "set")] == [
        ("can", motion) for motion in motions * 2
    ]


def test_neither_workers_nor_the_place_of_a_folder_change_a_set(tmp_path, block):
    moved = shutil.copytree(block, tmp_path / "elsewhere")
    first = generate(tmp_path / "one", **TOSS, objects=("can", str(block)), workers=1)
    second = generate(tmp_path / "two", **TOSS, objects=("can", str(moved)), workers=2)
    assert first.digest == second.digest
    # The same again adds nothing; other objects under the same ids are refused.
    assert generate(tmp_path / "one", **TOSS, objects=("can", str(moved)), workers=1) == first
    with pytest.raises(UsageError, match="made from another configuration"):
        generate(tmp_path / "one", **TOSS, objects=("can",), workers=1)


def test_a_set_without_objects_says_nothing_of_them(tmp_path):
    version = generate(tmp_path / "set", **{**TOSS, "episodes": 1}, workers=1)
    (episode,) = open_dataset(tmp_path / "set")
    assert (episode.meta.labels, episode.meta.scene, episode.meta.object) == ({}, "cube_toss", "object")
    assert "objects" not in version.lineage[0].details


def test_the_command_takes_names_and_a_list_in_a_file(tmp_path, block):
    (tmp_path / "objects.yaml").write_text(f"folder: {block.parent}\nobjects: [block]\n")
    command = ("generate-sim", "--scene", "cube_toss", "--episodes", 2, "--duration-s", 0.1, "--jobs", 1)
    for name, objects in (("named", f"can,{block}"), ("listed", tmp_path / "objects.yaml")):
        assert run(*command, "--objects", objects, "--out", tmp_path / name).code == 0
    assert [e.meta.object for e in open_dataset(tmp_path / "named")] == ["can", "block"]
    assert [e.meta.object for e in open_dataset(tmp_path / "listed")] == ["block", "block"]
    for objects, words in (
        ("can,can", "an object is named twice"),
        ("kan", "did you mean 'can'?"),
        (tmp_path / "none.yaml", "does not exist"),
        (tmp_path, "holds no object"),
    ):
        done = run(*command, "--objects", objects, "--out", tmp_path / "refused")
        assert (done.code, words in done.err) == (2, True)
        assert not (tmp_path / "refused").exists()


def test_a_list_of_objects_names_folders_in_one_folder(tmp_path):
    (tmp_path / "objects.yaml").write_text("objects: [../mug]\n")
    done = run(
        "generate-sim", "--scene", "cube_toss", "--episodes", 1, "--objects", tmp_path / "objects.yaml", "--out", "x"
    )
    assert (done.code, "one word of letters, digits, _ and -" in done.err) == (2, True)


def test_a_scene_with_another_object_is_not_exported_as_if_it_had_its_own(tmp_path):
    with pytest.raises(SceneError, match="holds an object that its model does not"):
        export_mjcf(load_scene("cube_toss+can"), (), tmp_path / "out")


def test_several_objects_are_not_replayed_with_one(tmp_path, block):
    generate(tmp_path / "set", **{**TOSS, "episodes": 10}, objects=("can", str(block)), workers=1)
    dataset = open_dataset(tmp_path / "set")
    with pytest.raises(DataError, match="the episodes are of several objects"):
        diagnose(dataset, load_scene("cube_toss"))
