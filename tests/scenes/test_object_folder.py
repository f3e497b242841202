"""Objects made of meshes: mass, inertia and pieces in the model, resting poses, clouds, and meshes that are refused."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest
import trimesh

from candata.errors import DataError, UsageError
from candata.rotation import rotate
from candata.scenes import load_scene
from candata.scenes.clouds import surface_cloud
from candata.scenes.object_folder import named_object, read_object
from candata.scenes.object_making import ObjectSource, make_object

#: Sides of a box [m] and its mass [kg].
SIDES, MASS = np.array([0.03, 0.05, 0.08]), 0.2
#: Offset of a box from the origin of its file [m].
OFFSET = np.array([0.1, 0.0, 0.0])
#: Drops: a quarter of the usual.
DROPS = 50
#: Radius, wall and height of a cup [m].
RADIUS, WALL, HEIGHT = 0.03, 0.004, 0.06


def box(offset=(0.0, 0.0, 0.0)):
    made = trimesh.creation.box(SIDES)
    made.apply_translation(offset)
    return made


def cup():
    """A cup on its base, hollow from above."""
    inner = RADIUS - WALL
    profile = [(0, 0), (RADIUS, 0), (RADIUS, HEIGHT), (inner, HEIGHT), (inner, WALL), (0, WALL)]
    return trimesh.creation.revolve(np.array(profile), sections=24)


def without_a_side(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:-2], process=False)


def turned(mesh, faces=slice(None)):
    """The mesh with some triangles facing the other way."""
    corners = mesh.faces.copy()
    corners[faces] = corners[faces][:, ::-1]
    return trimesh.Trimesh(mesh.vertices, corners, process=False)


def make(folder, mesh, ending="stl", drops=DROPS, **of):
    """An object made of a mesh that lies in a file."""
    path = folder / f"scan.{ending}"
    mesh.export(path)
    return make_object(ObjectSource(path, "thing", MASS, **of), folder / "thing", drops=drops)


def body_of(folder):
    """Mass, mass centre and principal moments of the body in the scene that was written."""
    model = load_scene(folder / "thing" / "scene.yaml").model
    body = model.body("thing").id
    return model.body_mass[body], model.body_ipos[body], np.sort(model.body_inertia[body])


def box_moments():
    """Closed form of a solid box: m / 12 (a^2 + b^2)."""
    return np.sort(MASS / 12 * (np.sum(SIDES**2) - SIDES**2))


@pytest.mark.parametrize("ending", ["stl", "obj", "ply"])
def test_a_box_has_its_mass_and_inertia_and_rests_on_its_faces(tmp_path, ending):
    made = make(tmp_path, box(OFFSET), ending)
    assert made.warnings == ()
    mass, centre, moments = body_of(tmp_path)
    # Corners are stored with 32 bits: some 1e-7 of their places.
    np.testing.assert_allclose((mass, *centre), (MASS, 0.1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(moments, box_moments(), rtol=1e-4)
    rests = made.scene_object.file.rests
    assert sum(rest.probability for rest in rests) == pytest.approx(1, abs=1e-3)
    assert sorted(round(np.degrees(rest.tilt_rad)) for rest in rests) == [0, 90, 90, 90, 90, 180]
    # It rests on its largest faces most often. Half the side that stands lies under its middle, less some 0.1 mm of
    # soft contact.
    assert sum(rest.probability for rest in rests[:2]) > 0.5
    middles = [rest.height_m + rotate(np.array(rest.quaternion), OFFSET)[2] for rest in rests]
    np.testing.assert_allclose(sorted(middles), np.repeat(SIDES / 2, 2), atol=3e-4)
    assert made.scene_object.file.upright.height_m == pytest.approx(SIDES[2] / 2, abs=3e-4)


def test_a_mesh_in_millimetres_needs_its_scale(tmp_path):
    large = box().apply_scale(1000)
    with pytest.raises(DataError, match=r"80 m\n.*\n.*0\.08 m: --scale 0\.001"):
        make(tmp_path, large)
    make(tmp_path, large, scale=0.001)
    np.testing.assert_allclose(body_of(tmp_path)[2], box_moments(), rtol=1e-4)


def test_a_mesh_that_is_inside_out_is_turned_and_said(tmp_path):
    made = make(tmp_path, turned(box()))
    assert made.warnings == ("the normals of thing pointed inward and were turned",)
    np.testing.assert_allclose(body_of(tmp_path)[2], box_moments(), rtol=1e-4)


def test_an_open_mesh_has_the_inertia_of_its_hull_and_it_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    made = make(tmp_path, without_a_side(box()))
    assert made.scene_object.file.inertia == "hull"
    assert "the mesh of thing is open" in made.warnings[0]
    np.testing.assert_allclose(body_of(tmp_path)[2], box_moments(), rtol=1e-4)


def test_a_cup_is_filled_by_its_hull_with_a_warning_and_its_cloud_is_not(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    made = make(tmp_path, cup())
    assert len(made.scene_object.file.pieces) == 1
    assert len(made.warnings) == 1
    assert 'pip install "candata[objects]"' in made.warnings[0]
    # Its mass lies in wall and base, so below the middle; that of the hull would lie in the middle.
    volumes = np.pi * np.array([RADIUS**2 * WALL, (RADIUS**2 - (RADIUS - WALL) ** 2) * (HEIGHT - WALL)])
    middle = volumes @ np.array([WALL / 2, (HEIGHT + WALL) / 2]) / volumes.sum()
    assert body_of(tmp_path)[1][2] == pytest.approx(middle, rel=0.01)  # a prism of 24 sides for a round
    cloud = surface_cloud(load_scene(tmp_path / "thing" / "scene.yaml"))
    in_cavity = (np.hypot(cloud[:, 0], cloud[:, 1]) < RADIUS - WALL + 1e-4) & (cloud[:, 2] > WALL - 1e-4)
    inner = 2 * np.pi * (RADIUS - WALL) * (HEIGHT - WALL) + np.pi * (RADIUS - WALL) ** 2
    # 512 points: the share is known to 0.02.
    assert in_cavity.mean() == pytest.approx(inner / cup().area, abs=0.08)


def test_pieces_of_a_folder_are_what_touches(tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    cup().export(folder / "visual.obj")
    base = trimesh.creation.cylinder(RADIUS, WALL).apply_translation((0, 0, WALL / 2))
    base.export(folder / "convex_0.stl")
    trimesh.creation.box((0.004, 0.004, HEIGHT)).apply_translation((0.028, 0, HEIGHT / 2)).export(
        folder / "convex_1.stl"
    )
    made = make_object(ObjectSource(folder, "thing", MASS), tmp_path / "thing", drops=DROPS)
    assert made.warnings == ()
    scene = load_scene(tmp_path / "thing" / "scene.yaml")
    assert [scene.model.geom(g).name for g in scene.object_geoms] == ["thing_piece_0", "thing_piece_1"]
    assert scene.object_geoms.size == len(made.scene_object.file.pieces)


def test_pieces_in_another_frame_are_refused(tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    box().export(folder / "visual.obj")
    box((0, 0, SIDES[2] / 2)).export(folder / "convex_0.stl")
    with pytest.raises(DataError, match=r"do not fit its mesh\n.*\n.*off by 40 mm"):
        make_object(ObjectSource(folder, "thing", MASS), tmp_path / "thing")


def test_a_ball_has_one_resting_pose(tmp_path):
    made = make(tmp_path, trimesh.creation.icosphere(subdivisions=3, radius=0.03), drops=200)
    assert made.scene_object.file.rests[0].probability > 0.9


def test_the_folder_holds_the_object_and_the_same_mesh_gives_the_same_bytes(tmp_path):
    made = make(tmp_path, box())
    assert read_object(tmp_path / "thing").file == made.scene_object.file
    assert named_object(str(tmp_path / "thing")).name == "thing"
    make_object(ObjectSource(tmp_path / "scan.stl", "thing", MASS), tmp_path / "again", drops=DROPS)
    for path in (tmp_path / "thing").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


@pytest.mark.parametrize("file", ["../x.obj", "/x.obj", "a/../../x.obj", "..\\x.obj"])
def test_an_object_file_names_nothing_outside_its_folder(tmp_path, file):
    make(tmp_path, box())
    path = tmp_path / "thing" / "object.yaml"
    path.write_text(path.read_text().replace("visual.obj", file))
    with pytest.raises(UsageError, match="in the folder of the object"):
        read_object(tmp_path / "thing")


@pytest.mark.parametrize("name", ["../x", "a/b", "", ".", "..", "a b", "-x", "x\n"])
def test_a_name_is_one_word_and_no_path(tmp_path, name):
    box().export(tmp_path / "scan.stl")
    with pytest.raises(UsageError, match="no name of an object"):
        make_object(ObjectSource(tmp_path / "scan.stl", name, MASS), tmp_path / "thing")
    assert [path.name for path in tmp_path.iterdir()] == ["scan.stl"]


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), float("inf")])
def test_a_mass_is_above_0(tmp_path, mass):
    box().export(tmp_path / "scan.stl")
    with pytest.raises(UsageError, match="--mass is no number above 0"):
        make_object(ObjectSource(tmp_path / "scan.stl", "thing", mass), tmp_path / "thing")


def write_stl(path, faces):
    """A binary STL of so many triangles that are points."""
    path.write_bytes(bytes(80) + np.uint32(faces).tobytes() + bytes(50 * faces))


def write_large(path):
    """A file of 100 MB, the size of 2 million triangles."""
    path.touch()
    os.truncate(path, 100_000_000)


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
.1 0 0
0 .1 0
{}
"""
BAD = {
    "empty file": ("scan.obj", lambda path: path.write_text(""), "scan.obj"),
    "no triangles": ("scan.stl", lambda path: write_stl(path, 0), "is empty"),
    "only points": ("scan.ply", lambda path: trimesh.PointCloud(np.eye(3)).export(path), "is empty"),
    "too many triangles": ("scan.stl", lambda path: write_stl(path, 200_001), "200,001 triangles"),
    "too large": ("scan.stl", write_large, "100,000,000 bytes"),
    "text": ("scan.stl", lambda path: path.write_text("not a mesh"), "is empty"),
    "torn": ("scan.stl", lambda path: path.write_bytes(bytes(80) + np.uint32(9).tobytes() + bytes(50)), "scan.stl"),
    "header alone": ("scan.ply", lambda path: path.write_text("ply\nformat ascii 1.0\nend_header\n"), "scan.ply"),
    "another ending": ("scan.txt", lambda path: path.write_text("v 0 0 0"), "ends in .obj, .stl, .ply"),
    "a folder without a mesh": ("scan", lambda path: path.mkdir(), "which mesh is seen"),
    "missing": ("scan.obj", lambda path: None, "not there"),
    "a pipe": ("scan.obj", os.mkfifo, "a FIFO"),
    "a corner that is no number": (
        "scan.obj",
        lambda path: path.write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n"),
        "no numbers",
    ),
    "a corner that is not there": (
        "scan.ply",
        lambda path: path.write_text(PLY.format("3 0 1 9")),
        "a triangle without a corner|cannot be read",
    ),
    "flat": ("scan.obj", lambda path: path.write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 3\n"), "is flat"),
    "tiny": ("scan.stl", lambda path: box().apply_scale(1e-3).export(path), "--scale NUMBER"),
    "torn normals": ("scan.stl", lambda path: turned(box(), slice(0, 3)).export(path), "opposite ways"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_mesh_that_spoils_a_simulation_is_one_error(tmp_path, case):
    name, write, words = BAD[case]
    write(tmp_path / name)
    with pytest.raises(DataError, match=words):
        make_object(ObjectSource(tmp_path / name, "thing", MASS), tmp_path / "thing")
    assert not (tmp_path / "thing").exists()


def test_a_name_that_is_neither_registered_nor_a_folder_lists_the_known():
    with pytest.raises(UsageError, match="can"):
        named_object("no_such_object")
