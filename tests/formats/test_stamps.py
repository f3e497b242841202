"""Stamps: one rule for the unit, for unix time, for rows without one, in all readers."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pytest

from candata.errors import DataError, UsageError
from candata.formats import Reading, table
from candata.formats.lerobot import FORMAT
from tests.formats.made_bags import POSE_MAP, START, STEP, pose, read, stamp, write_ros2
from tests.formats.made_sets import write_lerobot, write_map

FRAMES = np.array([0, 1, 2, 3, 0, 1, 2])
UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}
CHANNELS = {"joint_position": "observation.state", "action": "action"}


@pytest.fixture
def lerobot(tmp_path):
    """Reads a LeRobot set at 50 Hz with the given stamps."""

    def read(stamps, **fields):
        root = write_lerobot(tmp_path / "set", columns={"timestamp": stamps})
        mapping = write_map(tmp_path / "map.yaml", channels=CHANNELS, **fields) if fields else None
        return list(FORMAT.read(root, Reading(mapping=mapping)))

    return read


@pytest.fixture
def tabled(tmp_path):
    """Reads a table at 50 Hz with the given stamps."""

    def read(stamps, **fields):
        np.savez(tmp_path / "t.npz", t=stamps, q=np.zeros(len(stamps)), e=np.repeat([0, 1], [4, 3]))
        fields |= {"file": "t.npz", "time_s": "t", "rate_hz": 50, "episode": "e", "channels": {"joint_position": ["q"]}}
        return list(table.read(write_map(tmp_path / "map.yaml", **fields)))

    return read


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("start_s", [0.0, 1.7e9])
def test_a_unit_that_fits_the_rate_is_named_and_helps(lerobot, tabled, unit, start_s):
    stamps = np.rint((start_s + FRAMES / 50) * UNITS[unit])
    for reader, column in ((lerobot, "timestamp"), (tabled, "t")):
        with pytest.raises(DataError, match=r"^time ") as caught:
            reader(stamps)
        assert f"units: {{{column}: {unit}}}" in caught.value.fix
        first, _ = reader(stamps, units={column: unit})
        # Unix nanoseconds are more than a float64 holds.
        assert first["time_ns"] - start_s * 1e9 == pytest.approx([0, 2e7, 4e7, 6e7], abs=1000)


def test_a_set_that_is_read_by_its_names_is_told_the_whole_map(lerobot):
    with pytest.raises(DataError) as caught:
        lerobot(FRAMES * 20.0)
    assert str(caught.value).splitlines()[:3] == [
        "time does not fit the rate",
        "  expected: steps near 0.02 s (rate_hz: 50)",
        "  found: steps of 20 s",
    ]
    assert caught.value.fix == (
        "the steps fit the rate if the stamps are in ms: say `units: {timestamp: ms}` in a --map FILE, with "
        "`channels: {action: action, joint_position: observation.state}`"
    )


def test_unix_time_is_kept(lerobot, tabled):
    stamps = 1.7e9 + FRAMES / 50
    for reader in (lerobot, tabled):
        first, second = reader(stamps)
        for episode in (first, second):
            assert episode["time_ns"][0] == START
            assert np.diff(episode["time_ns"]) == pytest.approx(2e7, abs=300)  # float64 is 238 ns coarse there


def test_unix_time_in_float32_is_told(lerobot, tabled):
    stamps = (1.7e9 + FRAMES / 50).astype(np.float32)
    for reader in (lerobot, tabled):
        with pytest.raises(DataError, match="time is too coarse") as caught:
            reader(stamps)
        assert caught.value.found == "float32, which tells times near 1.7e+09 s 128 s apart"


@pytest.mark.parametrize("stamps", [[0, 0.02, np.nan, 0.06, 0, 0.02, 0.04], [0, 0.02, None, 0.06, 0, 0.02, 0.04]])
def test_a_row_without_a_stamp_is_named(lerobot, tabled, stamps):
    with pytest.raises(DataError, match="time is missing") as caught:
        lerobot(pa.array(stamps))
    assert caught.value.where.index == 2
    with pytest.raises(DataError, match="time is missing") as caught:
        tabled(np.array(stamps, float))
    assert caught.value.where.index == 2


def test_a_rate_that_no_unit_explains_is_told(lerobot):
    with pytest.raises(DataError, match="time does not fit the rate") as caught:
        lerobot(FRAMES * 8.0)
    assert caught.value.fix.startswith("give the unit of the stamps, such as `units: {timestamp: ms}`")
    assert caught.value.fix.endswith(", or correct rate_hz")


def test_the_unit_of_stamps_is_one_of_time(lerobot):
    with pytest.raises(UsageError, match="timestamp cannot be in deg"):
        lerobot(FRAMES / 50, units={"timestamp": "deg"})


def test_header_stamps_in_another_unit_are_told(tmp_path):
    def messages(factor: int):
        return [
            (START + k * STEP, {"header": {"stamp": stamp(START + k * STEP * factor), "frame_id": ""}, "pose": pose(k)})
            for k in range(50)
        ]

    kind = "geometry_msgs/msg/PoseStamped"
    path = write_ros2(tmp_path / "run.mcap", {"/pose": (kind, messages(1000))})
    with pytest.raises(DataError, match="the header stamps of /pose are in ms, not in s and ns") as caught:
        read(path, POSE_MAP)
    assert caught.value.fix.startswith("{topic: /pose, clock: log}")
    (episode,) = read(path, {"rate_hz": 100, "channels": {"object_pose": {"topic": "/pose", "clock": "log"}}})
    assert len(episode) == 50
    assert len(read(write_ros2(tmp_path / "slow.mcap", {"/pose": (kind, messages(3))}), POSE_MAP)) == 1


def test_an_episode_key_that_is_no_whole_number_is_told_with_its_row(tmp_path):
    keys = np.array([0, 0, 0, 0, 1, 1, 1.5])
    with pytest.raises(DataError, match="column episode_index holds what is no whole number") as caught:
        list(FORMAT.read(write_lerobot(tmp_path / "set", columns={"episode_index": keys}), Reading()))
    assert (caught.value.where.channel, caught.value.where.index) == ("episode_index", 6)
    whole = write_lerobot(tmp_path / "set", columns={"episode_index": np.floor(keys)})
    assert len(list(FORMAT.read(whole, Reading()))) == 2

    def half(lines):
        lines[1]["episode_index"] = 1.5

    root = write_lerobot(tmp_path / "set", version="v2.1", edit=half)
    with pytest.raises(DataError, match="a record of an episode is not valid") as caught:
        list(FORMAT.read(root, Reading()))
    assert caught.value.where.path.endswith("meta/episodes.jsonl, line 2")
    assert json.loads((root / "meta/episodes.jsonl").read_text().splitlines()[1])["episode_index"] == 1.5
