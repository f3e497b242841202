"""The YCB objects: each is checked, loose pieces are left out, and the folder appears whole or not at all."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from candata.errors import DataError, SetupError
from candata.fetch import SOURCES, ycb
from candata.fetch._ycb_trees import TREES
from candata.scenes import load_scene
from candata.scenes.object_folder import read_object
from candata.schema.object import ObjectList
from candata.schema.yaml_text import read_yaml
from tests.cli.command import run


@pytest.fixture
def prepared(shared, tmp_path):
    """A prepared folder with two objects."""
    folder = tmp_path / "prepared"
    folder.mkdir()
    shutil.copy(shared / "ycb" / "objects.csv", folder)
    for name in ("dice", "mug"):
        shutil.copytree(shared / "ycb" / name, folder / name)
    return folder


def test_a_folder_without_the_table_and_a_download_are_refused_with_what_to_do(tmp_path):
    source = SOURCES.load("ycb")
    with pytest.raises(DataError, match=r"objects\.csv is missing"):
        source.from_folder(tmp_path)
    with pytest.raises(SetupError, match="--from FOLDER") as refused:
        source.download(tmp_path, print)
    assert source.origin in str(refused.value)


def test_every_prepared_object_is_the_pinned_one_but_for_scans_of_loose_pieces(shared):
    fetched = ycb.from_folder(shared / "ycb")
    names = [public_object.name for public_object in fetched.objects]
    assert len(names) == fetched.count == 75
    assert not ycb.LOOSE & set(names)


def test_objects_have_the_mass_centre_and_inertia_of_the_table_and_rest_on_their_faces(prepared, tmp_path):
    done = run("fetch", "ycb", "--from", prepared, "--out", tmp_path / "ycb")
    assert (done.code, done.out) == (0, f"{tmp_path}/ycb: 2 objects\n")
    assert "Creative Commons Attribution 4.0" in (tmp_path / "ycb" / "LICENSE.txt").read_text()
    with (prepared / "objects.csv").open(newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["object"] == "mug")
    folder = tmp_path / "ycb" / "mug"
    assert (read_object(folder).file.licence, read_object(folder).file.inertia) == ("CC-BY-4.0", "exact")
    scene = load_scene(folder / "scene.yaml")
    body = scene.model.body("mug").id
    assert scene.model.body_mass[body] == pytest.approx(float(row["mass_kg"]))
    # The table rounds to 0.01 mm.
    np.testing.assert_allclose(scene.model.body_ipos[body], [float(row[f"com_{x}_m"]) for x in "xyz"], atol=1e-5)
    xx, yy, zz, xy, xz, yz = (float(row[f"i{axes}"]) for axes in ("xx", "yy", "zz", "xy", "xz", "yz"))
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    np.testing.assert_allclose(np.sort(scene.model.body_inertia[body]), moments, rtol=1e-3)
    # It stands as scanned, on its base.
    assert read_object(folder).file.upright.tilt_rad < np.deg2rad(3)
    # A die is fair: 200 drops give each face a sixth, to 0.026. It never rests on an edge.
    shares = [rest.probability for rest in read_object(tmp_path / "ycb" / "dice").file.rests]
    np.testing.assert_allclose(shares, 1 / 6, atol=0.08)
    assert len(shares) == 6


def test_an_object_that_was_changed_is_refused_and_nothing_is_left(prepared, tmp_path):
    with (prepared / "mug" / "visual.obj").open("a") as file:
        file.write("\n")
    done = run("fetch", "ycb", "--from", prepared, "--out", tmp_path / "ycb")
    assert (done.code, done.out) == (2, "")
    assert "mug is not the prepared object" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["prepared"]


def test_the_list_for_the_paper_names_40_objects_of_the_set():
    path = Path(__file__).parents[2] / "examples" / "paper" / "objects.yaml"
    names = ObjectList.parse(read_yaml(path), path).objects
    assert len(set(names)) == len(names) == 40
    assert set(names) <= set(TREES) - ycb.LOOSE
