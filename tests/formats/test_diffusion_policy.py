"""Diffusion Policy buffers: the layout its own reader takes, maps, and what is refused."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
import yaml
import zarr

from candata.errors import DataError, UsageError
from candata.formats import Reading, Writing
from candata.formats.diffusion_policy import FORMAT
from tests.conftest import make_episode


def read(path, **told):
    return list(FORMAT.read(path, Reading(**told)))


@pytest.fixture
def others(tmp_path):
    """Writes a buffer as others do: two episodes of three and two rows."""

    def write(ends=(3, 5), **arrays):
        path = tmp_path / "pusht.zarr"
        root = zarr.open_group(str(path), mode="w", zarr_format=2)
        data = {"state": np.arange(10.0).reshape(5, 2), "action": np.ones((5, 2)), "img": np.zeros((5, 4, 4, 3))}
        for name, values in (data | arrays).items():
            root.create_array(f"data/{name}", data=values)
        root.create_array("meta/episode_ends", data=np.array(ends, np.int64))
        return path

    return write


@pytest.fixture
def mapped(tmp_path):
    path = tmp_path / "features.yaml"
    channels = {"joint_position": "state", "action": "action"}
    path.write_text(yaml.safe_dump({"rate_hz": 10, "channels": channels, "units": {"joint_position": "deg"}}))
    return path


def test_an_export_is_a_buffer_of_format_2(tmp_path):
    episodes = [make_episode("a"), make_episode("b", seed=1, rows=30)]
    FORMAT.write(episodes, tmp_path, Writing("set", "d" * 64))
    path = tmp_path / "replay_buffer.zarr"
    assert json.loads((path / ".zgroup").read_text()) == {"zarr_format": 2}
    root = zarr.open_group(str(path), mode="r")
    assert root["meta/episode_ends"][:].tolist() == [20, 50]
    # Its ReplayBuffer demands that all arrays of `data` have as many rows as the last episode ends at.
    arrays = dict(root["data"].arrays())
    assert {array.shape[0] for array in arrays.values()} == {50}
    assert np.array_equal(arrays["joint_position"][20:], episodes[1]["joint_position"])
    both = [np.concatenate([e["joint_position"], e["fingertip_force"].reshape(len(e), 6)], axis=1) for e in episodes]
    assert np.array_equal(arrays["state"][:], np.concatenate(both))
    assert arrays["state"].chunks == (50, 8)


def test_a_long_export_is_written_by_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr("candata.formats._diffusion_policy_write._CHUNK_BYTES", 300)
    episodes = [make_episode(f"e{k}", seed=k, rows=11 + k) for k in range(4)]
    FORMAT.write(episodes, tmp_path, Writing("set", "d" * 64))
    pose = zarr.open_group(str(tmp_path / "replay_buffer.zarr"), mode="r")["data/object_pose"]
    assert pose.chunks == (11, 7)
    assert np.array_equal(pose[:], np.concatenate([e["object_pose"] for e in episodes]))


def test_a_map_reads_buffers_of_others(others, mapped):
    notes = []
    first, second = read(others(), mapping=mapped, note=notes.append)
    assert (first.meta.id, second.meta.id, second.meta.rate_hz) == ("pusht-0", "pusht-1", 10)
    assert second["joint_position"] == pytest.approx(np.radians([[6, 7], [8, 9]]))
    assert second["time_ns"].tolist() == [0, 100_000_000]
    assert notes == ["left out: img"]


def test_what_is_wrong_is_said(others, mapped, tmp_path):
    with pytest.raises(UsageError, match="--map FILE"):
        read(others())
    with pytest.raises(DataError, match="more episodes than there are rows"):
        read(others(range(1, 60)), mapping=mapped)
    os.mkfifo(others() / "data" / "pipe")
    with pytest.raises(DataError, match="holds what is no file"):
        read(tmp_path / "pusht.zarr", mapping=mapped)
    for ends in [(), (0, 5), (5, 3)]:
        with pytest.raises(DataError, match="episode_ends does not rise"):
            read(others(ends), mapping=mapped)
    with pytest.raises(DataError, match="arrays differ in length") as caught:
        read(others(state=np.ones((4, 2))), mapping=mapped)
    assert "found: state: 4" in str(caught.value)
    with pytest.raises(DataError, match=r"no \.zgroup"):
        read(tmp_path / "none")
    mapped.write_text(yaml.safe_dump({"channels": {"joint_position": "state"}}))
    with pytest.raises(UsageError, match="lacks rate_hz"):
        read(others(), mapping=mapped)
