"""Where a buffer may lie, in which format of zarr, and how its rows are read."""

from __future__ import annotations

import numpy as np
import pytest
import zarr

from candata.errors import DataError
from candata.formats import Reading
from candata.formats.diffusion_policy import FORMAT
from tests.formats.made_sets import write_buffer, write_map, zipped


def read(source, tmp_path, **fields):
    fields = {"rate_hz": 10, "channels": {"joint_position": "state", "action": "action"}} | fields
    return list(FORMAT.read(source, Reading(mapping=write_map(tmp_path / "map.yaml", **fields))))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("inside", [None, "", "replay.zarr/"])
def test_formats_2_and_3_are_read_from_folders_and_zip_files(tmp_path, version, inside):
    (tmp_path / "in").mkdir()
    path = write_buffer(tmp_path / "in" / "pusht.zarr", version)
    path = path if inside is None else zipped(path, inside)
    for source in (path, path.parent):
        first, second = read(source, tmp_path)
        assert (first.meta.id, second.meta.id) == ("pusht-0", "pusht-1")
        assert second["joint_position"].tolist() == [[6, 7], [8, 9]]


@pytest.mark.parametrize("version", [2, 3])
def test_metadata_that_is_gathered_in_one_file_is_not_needed(tmp_path, version):
    path = write_buffer(tmp_path / "b.zarr", version)
    with pytest.warns(UserWarning, match="Consolidated") if version == 3 else np.errstate():
        zarr.consolidate_metadata(str(path))
    assert len(read(path, tmp_path)) == 2


@pytest.mark.parametrize("chunk", [1, 7, 64, 1000])
@pytest.mark.parametrize("version", [2, 3])
def test_every_row_is_read_once_whatever_the_chunks(tmp_path, chunk, version):
    ends = [1, 40, 41, 333, 1000]
    values = np.random.default_rng(1).normal(size=(1000, 3)).astype(np.float32)
    path = write_buffer(tmp_path / "b.zarr", version, ends, action=np.ones((1000, 2)), img=np.ones((1000, 2)))
    root = zarr.open_group(str(path), mode="a")
    del root["data/state"]
    root.create_array("data/state", shape=values.shape, chunks=(chunk, 2), dtype="f4")[:] = values
    episodes = read(path, tmp_path)
    assert [len(episode) for episode in episodes] == np.diff([0, *ends]).tolist()
    assert np.array_equal(np.concatenate([e["joint_position"] for e in episodes]), values)


def test_shards_are_read(tmp_path):
    path = write_buffer(tmp_path / "b.zarr", 3)
    root = zarr.open_group(str(path), mode="a")
    del root["data/state"]
    root.create_array("data/state", shape=(5, 2), chunks=(1, 2), shards=(4, 2), dtype="f8")[:] = np.eye(5)[:, :2]
    first, second = read(path, tmp_path)
    assert np.concatenate([first["joint_position"], second["joint_position"]]).tolist() == np.eye(5)[:, :2].tolist()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"episode_ends": [2.5, 5.0]}, "episode_ends holds what is no whole number"),
        ({"episode_ends": [3.0, np.nan]}, "episode_ends holds what is no whole number"),
        ({"state": np.array(list("abcde"))}, "data/state does not hold rows of numbers"),
        ({"state": np.zeros((5, 2), complex)}, "data/state does not hold rows of numbers"),
        ({"state": np.float64(1)}, "data/state does not hold rows of numbers"),
    ],
)
def test_what_is_asked_for_must_be_rows_of_numbers(tmp_path, change, text):
    path = write_buffer(tmp_path / "b.zarr")
    root = zarr.open_group(str(path), mode="a")
    for name, values in change.items():
        key = f"meta/{name}" if name == "episode_ends" else f"data/{name}"
        del root[key]
        root.create_array(key, data=np.array(values))
    with pytest.raises(DataError, match=text):
        read(path, tmp_path)


def test_a_chunk_that_is_damaged_names_its_array(tmp_path):
    path = write_buffer(tmp_path / "b.zarr")
    (path / "data/state/0.0").write_bytes(b"no chunk")
    with pytest.raises(DataError, match="data/state of the buffer cannot be read"):
        read(path, tmp_path)
    path = write_buffer(tmp_path / "b.zarr")
    (path / "meta/episode_ends/.zarray").unlink()
    with pytest.raises(DataError, match="meta/episode_ends of the buffer cannot be read"):
        read(path, tmp_path)


@pytest.mark.parametrize("data", [b"", b"a text", b"PK\x03\x04 cut"])
def test_a_file_that_is_no_zip_file_is_refused(tmp_path, data):
    (tmp_path / "b.zarr.zip").write_bytes(data)
    with pytest.raises(DataError, match="there is no Diffusion Policy buffer") as caught:
        read(tmp_path / "b.zarr.zip", tmp_path)
    assert "File is not a zip file" in caught.value.found


def test_a_zip_file_of_something_else_is_refused(tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.txt").write_text("a")
    with pytest.raises(DataError, match=r"no \.zgroup and no zarr\.json"):
        read(zipped(tmp_path / "other"), tmp_path)


def test_a_folder_of_two_buffers_is_refused(tmp_path):
    for name in "ab":
        write_buffer(tmp_path / "in" / f"{name}.zarr")
    with pytest.raises(DataError, match=r"found: a\.zarr, b\.zarr"):
        read(tmp_path / "in", tmp_path)


def test_a_zip_file_whose_attributes_are_damaged(tmp_path):
    path = zipped(write_buffer(tmp_path / "b.zarr"))
    data = bytearray(path.read_bytes())
    place = data.index(b".zattrs")
    data[place - 30 : place - 26] = b"XXXX"  # the mark of the member's own header
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"\.zattrs of the buffer cannot be read"):
        read(path, tmp_path)
