"""Rows of LeRobot sets: a stale index, sets without tasks, lists that are uneven, percent of range."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from candata.errors import DataError, UsageError
from candata.formats import Reading
from candata.formats.lerobot import FORMAT
from tests.formats.made_sets import POINTER, feature, write_lerobot, write_map

FIRST, SECOND = "data/chunk-000/file-000.parquet", "data/chunk-000/file-001.parquet"
PERCENT = np.array([[-99.0, 5], [20, 30], [95, 99], [3, 4], [1, 2], [1, 2], [1, 2]])


def read(root, **told):
    return list(FORMAT.read(root, Reading(**told)))


def split(root, rows: int = 4, keep: bool = False):
    """Move the rows from `rows` on to a second file that the index does not name; keep them in the first as well."""
    table = pq.read_table(root / FIRST)
    pq.write_table(table.slice(rows), root / SECOND)
    if not keep:
        pq.write_table(table.slice(0, rows), root / FIRST)
    return root


def test_an_episode_is_taken_from_the_one_file_that_holds_it(tmp_path):
    whole = read(write_lerobot(tmp_path / "set", rows=(4, 3, 2)))
    notes: list[str] = []
    moved = read(split(tmp_path / "set"), note=notes.append)
    for one, other in zip(whole, moved, strict=True):
        assert np.array_equal(one["joint_position"], other["joint_position"])
    assert notes[1:] == [
        f"episode {k}: the index names file-000.parquet, its rows are in file-001.parquet: taken there" for k in (1, 2)
    ]


def test_an_index_that_names_a_file_which_is_not_there_is_stale_too(tmp_path):
    def off_by_one(lines):
        lines[1]["data/file_index"] = 1

    root = write_lerobot(tmp_path / "set", edit=off_by_one)
    notes: list[str] = []
    assert [len(episode) for episode in read(root, note=notes.append)] == [4, 3]
    assert notes[1:] == ["episode 1: the index names file-001.parquet, its rows are in file-000.parquet: taken there"]
    pq.write_table(pq.read_table(root / FIRST).slice(0, 4), root / FIRST)
    with pytest.raises(DataError, match=r"file-001\.parquet is missing"):
        read(root)


def test_an_index_that_is_right_is_followed_whatever_other_files_hold(tmp_path):
    notes: list[str] = []
    assert len(read(split(write_lerobot(tmp_path / "set"), keep=True), note=notes.append)) == 2
    assert not [line for line in notes if "index" in line]


def test_where_two_files_hold_an_episode_both_are_named(tmp_path):
    root = split(write_lerobot(tmp_path / "set"))
    pq.write_table(pq.read_table(root / SECOND), root / "data/chunk-000/file-002.parquet")
    with pytest.raises(DataError, match="the file does not hold the episode's rows") as caught:
        read(root)
    assert caught.value.found == "0 rows; 3 in chunk-000/file-001.parquet, 3 in chunk-000/file-002.parquet"
    assert caught.value.fix.startswith("correct the file numbers in meta/episodes")


def test_an_episode_that_another_file_holds_in_part_is_not_taken(tmp_path):
    root = split(write_lerobot(tmp_path / "set"))
    pq.write_table(pq.read_table(root / SECOND).slice(1), root / SECOND)
    with pytest.raises(DataError, match="does not hold the episode's rows") as caught:
        read(root)
    assert caught.value.found == "0 rows; 2 in chunk-000/file-001.parquet"


def test_rows_that_no_file_holds_are_missing(tmp_path):
    root = split(write_lerobot(tmp_path / "set"))
    (root / SECOND).unlink()
    with pytest.raises(DataError, match="does not hold the episode's rows") as caught:
        read(root)
    assert (caught.value.found, caught.value.fix.partition(";")[0]) == (
        "0 rows",
        "the set was not closed or was edited",
    )
    (root / SECOND).write_text(POINTER)
    with pytest.raises(DataError, match=r"file-001\.parquet is a Git LFS pointer"):
        read(root)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_set_without_tasks_imports(tmp_path, version):
    def forget(lines):
        for line in lines:
            del line["tasks"]

    root = write_lerobot(tmp_path / "set", version=version, columns={"task_index": None}, edit=forget)
    assert [(len(episode), episode.meta.task) for episode in read(root)] == [(4, None), (3, None)]


@pytest.mark.parametrize(
    ("cells", "found"),
    [
        ([[1.0, 2], [1, 2], [1, 2], [1, 2], [1, 2], [1, 2, 3], [1]], "3 numbers in row 5 of the file"),
        ([[1.0, 2], [1, 2], [1, 2], [1, 2], [1, 2], None, [1, 2]], "an empty cell"),
        ([[1.0, 2, 3]] * 7, "3 numbers in row 0 of the file"),
    ],
)
def test_lists_of_another_length_are_told_with_their_row(tmp_path, cells, found):
    root = write_lerobot(tmp_path / "set")
    path = root / FIRST
    table = pq.read_table(path)
    place = table.schema.get_field_index("observation.state")
    pq.write_table(table.set_column(place, "observation.state", pa.array(cells)), path)
    with pytest.raises(DataError, match="rows of another size") as caught:
        read(root)
    assert (caught.value.found, caught.value.where.channel) == (found, "observation.state")
    assert caught.value.where.index == (0 if len(cells[0]) == 3 else 5)


def test_percent_of_range_gets_that_name(tmp_path):
    root = write_lerobot(tmp_path / "set", columns={"observation.state": PERCENT, "action": PERCENT})
    map_path = tmp_path / "map.yaml"
    channels = {"joint_position": "observation.state", "action": "action"}
    for mapping in (None, write_map(map_path, channels=channels)):
        with pytest.raises(DataError, match="the joints' positions are no rad or m") as caught:
            read(root, mapping=mapping)
        assert caught.value.found == (
            "99 in observation.state[thumb]; none beyond 100, as in LeRobot's percent of range (RANGE_M100_100; the "
            "gripper RANGE_0_100), which is no angle without the robot's calibration"
        )
        for word in ("use_degrees", "scales: {joint_position: [...]", "(range_max - range_min) / 200 * 360 / 4095"):
            assert word in caught.value.fix
    notes: list[str] = []
    read(root, mapping=write_map(map_path, channels=channels, units={"joint_position": "deg"}), note=notes.append)
    assert notes == [
        "taken in deg, as the map says: observation.state[thumb], observation.state[index]; but never beyond 100, "
        "as in LeRobot's percent of range (RANGE_M100_100; the gripper RANGE_0_100), which is no angle: if the robot "
        "recorded that, they are wrong without `scales`"
    ]


def test_scales_turn_percent_into_angles(tmp_path):
    root = write_lerobot(tmp_path / "set", columns={"observation.state": PERCENT, "action": PERCENT})
    fields = {"channels": {"joint_position": "observation.state", "action": "action"}}
    fields |= {
        "units": {"joint_position": "deg", "action": "deg"},
        "scales": {"joint_position": [1.5, 0.5], "action": 2},
    }
    notes: list[str] = []
    (first, _) = read(root, mapping=write_map(tmp_path / "map.yaml", **fields), note=notes.append)
    assert first["joint_position"] == pytest.approx(np.radians(PERCENT[:4] * [1.5, 0.5]), rel=1e-6)
    assert first["action"] == pytest.approx(np.radians(PERCENT[:4] * 2), rel=1e-6)
    assert not notes


@pytest.mark.parametrize("scales", [{"joint_position": [1.0]}, {"joint_position": float("nan")}, {"action": 2.0}])
def test_wrong_scales_are_refused(tmp_path, scales):
    fields = {"channels": {"joint_position": "observation.state"}, "scales": scales}
    with pytest.raises(UsageError):
        read(write_lerobot(tmp_path / "set"), mapping=write_map(tmp_path / "map.yaml", **fields))


def test_a_gripper_among_degrees_is_percent_all_the_same(tmp_path):
    names = {"observation.state": feature("float32", 2, ["wrist.pos", "gripper.pos"])}
    root = write_lerobot(tmp_path / "set", names, {"observation.state": np.abs(PERCENT) * [1.5, 1]})
    fields = {"channels": {"joint_position": "observation.state"}, "units": {"joint_position": "deg"}}
    notes: list[str] = []
    read(root, mapping=write_map(tmp_path / "map.yaml", **fields), note=notes.append)
    assert [line for line in notes if "as the map says: observation.state[gripper.pos]; but never" in line]
    fields["channels"] = {"joint_position": "observation.state[0]"}
    notes.clear()
    read(root, mapping=write_map(tmp_path / "map.yaml", **fields), note=notes.append)
    assert not [line for line in notes if "percent" in line]


def test_degrees_beyond_100_are_told_as_degrees(tmp_path):
    root = write_lerobot(tmp_path / "set", columns={"observation.state": PERCENT * 3})
    with pytest.raises(DataError, match="no rad or m") as caught:
        read(root)
    assert caught.value.found == "297 in observation.state[thumb]"
    assert "units: {joint_position: deg, action: deg}" in caught.value.fix


def test_a_column_that_is_taken_twice_is_refused(tmp_path):
    fields = {"channels": {"joint_position": ["observation.state", "observation.state[thumb]"]}}
    with pytest.raises(UsageError, match="joint_position names a column twice") as caught:
        read(write_lerobot(tmp_path / "set"), mapping=write_map(tmp_path / "map.yaml", **fields))
    assert caught.value.found == "observation.state[thumb]"
