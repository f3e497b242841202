"""Git LFS pointers: every reader and every file of a scene says what they are, and the one thing that helps."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from candata.errors import DataError
from candata.lfs import refuse_pointer
from tests.cli.command import run
from tests.formats.made_bags import POSE_MAP, POSE_TOPIC, write_bag, write_ros2
from tests.formats.made_sets import POINTER, write_buffer, write_lerobot, write_map

MODEL = """<mujoco><compiler meshdir="parts"/><asset><mesh name="tip" file="tip.stl"/></asset><include file="more.xml"/>
<worldbody><body><joint name="j"/><geom type="mesh" mesh="tip"/></body></worldbody></mujoco>"""
URDF = """<robot name="r"><link name="base"/><link name="l"><visual><geometry>
<mesh filename="package://hand/meshes/l.stl"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="base"/><child link="l"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def told(path: Path, size: int = 1_234_567) -> str:
    return (
        f"{path.name} is a Git LFS pointer, which stands in place of the file\n"
        f"  expected: the file itself, of {size:,} bytes\n"
        f"  found: {len(POINTER)} bytes that name it\n"
        f"  where: {path}\n"
        "  do: run `git lfs pull` in that clone, or download the file itself\n"
    )


def test_a_pointer_is_known_by_its_first_line_and_its_size(tmp_path):
    path = tmp_path / "x"
    for text in ("", "version 1", "a,b\n" + POINTER, POINTER + " " * 1024):
        path.write_text(text)
        refuse_pointer(path)
    refuse_pointer(tmp_path / "none")
    refuse_pointer(tmp_path)
    path.write_text(POINTER.replace("git-lfs", "hawser").replace("size 1234567\n", ""))
    with pytest.raises(DataError, match="Git LFS pointer") as caught:
        refuse_pointer(path)
    assert caught.value.expected == "the file itself"


def pointer(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(POINTER)
    return path


def table(tmp_path: Path, kind: str) -> tuple[list, Path]:
    fields = {
        "file": f"t.{kind}",
        "source": "real",
        "time_s": "t",
        "rate_hz": 30,
        "channels": {"joint_position": ["q"]},
    }
    return ["table", write_map(tmp_path / "map.yaml", **fields)], pointer(tmp_path / f"t.{kind}")


def lerobot(tmp_path: Path, name: str, version: str = "v3.0") -> tuple[list, Path]:
    return ["lerobot", write_lerobot(tmp_path / "set", version=version)], pointer(tmp_path / "set" / name)


def buffer(tmp_path: Path, name: str, version: int = 2) -> tuple[list, Path]:
    mapping = write_map(tmp_path / "m.yaml", rate_hz=10, channels={"joint_position": "state", "action": "action"})
    path = write_buffer(tmp_path / "b.zarr", version)
    return ["diffusion_policy", path, "--map", mapping], pointer(path / name)


def frames(tmp_path: Path) -> tuple[list, Path]:
    path = pointer(tmp_path / "run" / "ob_in_cam" / "0000000.txt")
    return ["foundationpose", tmp_path / "run", "--map", write_map(tmp_path / "f.yaml", rate_hz=30)], path


def bag(tmp_path: Path) -> tuple[list, Path]:
    path = write_bag(tmp_path / "bag", [POSE_TOPIC])
    return ["mcap", path, "--map", write_map(tmp_path / "m.yaml", **POSE_MAP)], pointer(path / "metadata.yaml")


def feature_map(tmp_path: Path) -> tuple[list, Path]:
    path = pointer(tmp_path / "m.yaml")
    return ["mcap", write_ros2(tmp_path / "run.mcap", POSE_TOPIC), "--map", path], path


SOURCES = {
    "csv": lambda p: table(p, "csv"),
    "parquet": lambda p: table(p, "parquet"),
    "npz": lambda p: table(p, "npz"),
    "map": lambda p: (["table", pointer(p / "map.yaml")], p / "map.yaml"),
    "hdf5": lambda p: (["robomimic", pointer(p / "d.hdf5")], p / "d.hdf5"),
    "mcap": lambda p: (["mcap", pointer(p / "run.mcap")], p / "run.mcap"),
    "log": lambda p: (["log", pointer(p / "run.mcap")], p / "run.mcap"),
    "bag": bag,
    "topics": feature_map,
    "info": lambda p: lerobot(p, "meta/info.json"),
    "lines": lambda p: lerobot(p, "meta/episodes.jsonl", "v2.1"),
    "episodes": lambda p: lerobot(p, "meta/episodes/chunk-000/file-000.parquet"),
    "rows": lambda p: lerobot(p, "data/chunk-000/file-000.parquet"),
    "chunk": lambda p: buffer(p, "data/state/0.0"),
    "array": lambda p: buffer(p, "data/state/.zarray"),
    "chunk of format 3": lambda p: buffer(p, "data/state/c/0/0", 3),
    "ends": lambda p: buffer(p, "meta/episode_ends/0"),
    "attributes": lambda p: buffer(p, ".zattrs"),
    "zip": lambda p: (["diffusion_policy", pointer(p / "b.zarr.zip")], p / "b.zarr.zip"),
    "frame": frames,
}


@pytest.mark.parametrize("kind", SOURCES)
def test_every_reader_tells_a_pointer(tmp_path, kind):
    pytest.importorskip("h5py")
    arguments, path = SOURCES[kind](tmp_path)
    found = run("import", *arguments, "--out", tmp_path / "out")
    assert found.code == 2
    assert found.err.endswith(told(path))
    assert not (tmp_path / "out").exists()


def test_pointers_in_place_of_pictures_that_are_not_asked_for_do_not_matter(tmp_path):
    arguments, _ = buffer(tmp_path, "data/img/0.0.0.0")
    assert run("import", *arguments, "--out", tmp_path / "out").code == 0


@pytest.mark.parametrize("name", ["dataset.json", "versions/*.json", "parts/*/part.json", "parts/*/*.parquet"])
def test_a_dataset_of_ours_tells_a_pointer(tmp_path, name):
    arguments, _ = buffer(tmp_path, "data/img/0.0.0.0")
    assert run("import", *arguments, "--out", tmp_path / "out").code == 0
    path = pointer(next((tmp_path / "out").glob(name)))
    found = run("inspect", tmp_path / "out")
    assert (found.code, found.err) == (2, told(path))


@pytest.fixture
def scene(tmp_path):
    """Files of a scene by name, some of them pointers; returns the scene.yaml."""

    def write(model: str, files: dict[str, str]) -> Path:
        for name, text in files.items():
            pointer(tmp_path / name).write_text(text)
        path = tmp_path / "hand" / "scene.yaml"
        path.parent.mkdir(exist_ok=True)
        if not path.exists():
            path.write_text(yaml.safe_dump({"model": model, "rate_hz": 50, "joints": ["j"]}))
        return path

    return write


@pytest.mark.parametrize(
    ("model", "files", "name"),
    [
        ("m.xml", {"hand/scene.yaml": POINTER}, "hand/scene.yaml"),
        ("m.xml", {"hand/m.xml": POINTER}, "hand/m.xml"),
        ("m.xml", {"hand/m.xml": MODEL, "hand/more.xml": POINTER}, "hand/more.xml"),
        (
            "m.xml",
            {"hand/m.xml": MODEL, "hand/more.xml": "<mujoco/>", "hand/parts/tip.stl": POINTER},
            "hand/parts/tip.stl",
        ),
        ("r.urdf", {"hand/r.urdf": POINTER}, "hand/r.urdf"),
        ("r.urdf", {"hand/r.urdf": URDF, "hand/meshes/l.stl": POINTER}, "hand/meshes/l.stl"),
        ("urdf/r.urdf", {"hand/urdf/r.urdf": URDF, "hand/meshes/l.stl": POINTER}, "hand/meshes/l.stl"),
    ],
)
def test_every_file_of_a_scene_tells_a_pointer(tmp_path, scene, model, files, name):
    found = run("scene", "show", scene(model, files))
    assert (found.code, found.err) == (2, told(tmp_path / name))
