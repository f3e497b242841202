"""Files whose headers claim more than any memory: one clear error, at once, and nothing written."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zarr

from tests.cli.command import run
from tests.formats.made_bags import POSE_MAP, POSE_TOPIC, write_ros2
from tests.formats.made_sets import sparse, write_buffer, write_demos, write_lerobot, write_map

h5py = pytest.importorskip("h5py")
TB = 10**12
ROWS = 5 * TB // 56


def refused(tmp_path: Path, *arguments) -> str:
    """Return what a refused import says."""
    found = run("import", *arguments, "--out", tmp_path / "out")
    assert found.code == 2
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith((".", "out"))] == []
    return found.err


def claim(file, early: bool) -> None:
    """Let two datasets claim 5 TB each: with `early`, of a file that is as large, and holds nothing."""
    demo = file["data/demo_0"]
    demo.attrs["num_samples"] = ROWS
    for name in ("obs/robot0_joint_pos", "actions"):
        del demo[name]
        plan = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        if early:
            plan.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            plan.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        else:
            plan.set_chunk((1000, 7))
        space = h5py.h5s.create_simple((ROWS, 7))
        h5py.h5d.create(demo.id, name.encode(), h5py.h5t.NATIVE_DOUBLE, space, plan)


def test_a_sparse_hdf5_file(tmp_path):
    text = refused(tmp_path, "robomimic", write_demos(tmp_path / "d.hdf5", lambda file: claim(file, True)))
    assert "a dataset of d.hdf5 does not fit into memory" in text
    assert "found: 5,000 GB" in text


def test_an_hdf5_dataset_that_was_never_written(tmp_path):
    text = refused(tmp_path, "robomimic", write_demos(tmp_path / "d.hdf5", lambda file: claim(file, False)))
    assert "a dataset claims more than the file can hold" in text


def buffer(tmp_path: Path, chunks: int) -> list:
    path = write_buffer(tmp_path / "b.zarr")
    root = zarr.open_group(str(path), mode="a")
    del root["data/state"]
    root.create_array("data/state", shape=(ROWS, 7), chunks=(chunks, 7), dtype="f8")
    root["meta/episode_ends"][:] = [3, ROWS]
    return ["diffusion_policy", path, "--map", write_map(tmp_path / "m.yaml", rate_hz=10, channels=STATE)]


STATE = {"joint_position": "state"}


def test_a_zarr_array_that_was_never_written(tmp_path):
    assert "an array claims more than the buffer can hold" in refused(tmp_path, *buffer(tmp_path, 1000))


def test_a_chunk_larger_than_the_memory(tmp_path):
    arguments = buffer(tmp_path, ROWS)
    (arguments[1] / "data/state/0.0").touch()
    sparse(arguments[1] / "data/img/9.9.9.9", 10 * TB)  # makes the buffer as large as it claims
    assert "a chunk of data/state does not fit into memory" in refused(tmp_path, *arguments)


def test_a_chunk_file_larger_than_the_memory(tmp_path):
    arguments = buffer(tmp_path, 1000)
    sparse(arguments[1] / "data/state/0.0", 10 * TB)
    assert "0.0 does not fit into memory" in refused(tmp_path, *arguments)


def test_a_zip_file_without_its_end(tmp_path):
    path = sparse(tmp_path / "b.zarr.zip", 10 * TB)
    assert refused(tmp_path, "diffusion_policy", path).startswith("there is no Diffusion Policy buffer")


@pytest.mark.parametrize("name", ["meta/info.json", "meta/episodes.jsonl"])
def test_texts_of_a_lerobot_set(tmp_path, name):
    root = write_lerobot(tmp_path / "set", version="v2.1")
    sparse(root / name, 10 * TB)
    assert refused(tmp_path, "lerobot", root).startswith(f"{Path(name).name} cannot be read\n  found: 10,")


def test_a_parquet_file_that_is_followed_by_blanks(tmp_path):
    root = write_lerobot(tmp_path / "set")
    sparse(root / "data/chunk-000/file-000.parquet", 10 * TB)
    assert "file-000.parquet cannot be read" in refused(tmp_path, "lerobot", root)


def test_an_npz_array(tmp_path):
    with zipfile.ZipFile(tmp_path / "t.npz", "w") as packed:
        for name in "tq":
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                header, {"descr": "<f8", "fortran_order": False, "shape": (10 * TB // 8,)}
            )
            packed.writestr(f"{name}.npy", header.getvalue())
    path = write_map(tmp_path / "m.yaml", file="t.npz", time_s="t", rate_hz=50, channels={"joint_position": ["q"]})
    assert refused(tmp_path, "table", path).startswith("the array t does not fit into memory\n")


@pytest.mark.parametrize("record", [b"", b"\x06" + (9 * TB).to_bytes(8, "little")])
def test_a_sparse_mcap_file(tmp_path, record):
    path = write_ros2(tmp_path / "run.mcap", POSE_TOPIC)
    data = path.read_bytes()
    header = 17 + int.from_bytes(data[9:17], "little")
    path.write_bytes(data[:header] + record)
    sparse(path, 10 * TB)
    text = refused(tmp_path, "mcap", path, "--map", write_map(tmp_path / "m.yaml", **POSE_MAP))
    assert text.startswith("the recording is damaged\n")
    assert f"whole records end at byte {header}" in text


def test_a_frame_of_foundationpose(tmp_path):
    (tmp_path / "run/ob_in_cam").mkdir(parents=True)
    np.savetxt(tmp_path / "run/ob_in_cam/0.txt", np.eye(4))
    sparse(tmp_path / "run/ob_in_cam/0.txt", 10 * TB)
    path = write_map(tmp_path / "m.yaml", rate_hz=30)
    assert refused(tmp_path, "foundationpose", tmp_path / "run", "--map", path).startswith("frame 0 holds no matrix\n")


def test_a_map(tmp_path):
    path = sparse(write_map(tmp_path / "m.yaml", channels=STATE), 10 * TB)
    text = refused(tmp_path, "diffusion_policy", write_buffer(tmp_path / "b.zarr"), "--map", path)
    assert text.startswith("the map is no YAML\n  expected: at most 400,000 bytes\n  found: 10,")
