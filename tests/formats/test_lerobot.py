"""LeRobot sets of others: names, maps, clocks, what is left out, and what is refused."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from candata.errors import DataError, UnknownNameError, UsageError
from candata.fetch import g1_inspire_pick
from candata.formats import Reading, Writing
from candata.formats.lerobot import FORMAT
from tests.conftest import make_episode
from tests.formats.made_sets import JOINTS, feature, write_lerobot


@pytest.fixture
def made(tmp_path):
    """Writes a v2.1 or v3.0 set of two episodes as others do: `made(features, columns, version=...)`."""
    return lambda *given, **told: write_lerobot(tmp_path / "set", *given, **told)


@pytest.fixture
def mapped(tmp_path):
    """Writes a map file."""

    def write(**fields) -> Path:
        path = tmp_path / "features.yaml"
        path.write_text(yaml.safe_dump(fields, sort_keys=False))
        return path

    return write


def read(root, **told):
    return list(FORMAT.read(root, Reading(**told)))


@pytest.mark.parametrize("version", ["v2.0", "v2.1", "v3.0"])
def test_names_decide(made, version):
    notes = []
    columns = {"observation.state": np.arange(14.0).reshape(7, 2) / 10}
    first, second = read(made(columns=columns, version=version), note=notes.append)
    assert (first.meta.id, second.meta.id) == ("set-0", "set-1")
    assert first.meta.joint_names == first.meta.actuator_names == ("thumb", "index")
    assert (first.meta.task, first.meta.rate_hz, first.meta.source) == ("grasp it", 50.0, "real")
    assert first["time_ns"].tolist() == [0, 20_000_000, 40_000_000, 60_000_000]
    assert second["joint_position"] == pytest.approx(np.array([[0.8, 0.9], [1.0, 1.1], [1.2, 1.3]]))
    assert "by their names: action from action, joint_position from observation.state" in notes[0]


def test_columns_of_the_state_are_sorted_by_their_endings(made):
    names = ["a.pos", "a.vel", "b.pos", "b.vel"]
    state = {"observation.state": feature("float32", 4, names)}
    (first, _) = read(made(state, {"observation.state": np.tile([1.0, 2.0, 3.0, 4.0], (7, 1))}))
    assert first.meta.joint_names == ("a", "b")
    assert first["joint_position"][0].tolist() == [1, 3]
    assert first["joint_velocity"][0].tolist() == [2, 4]


def test_what_has_no_place_is_named(made):
    notes = []
    extra = {
        "observation.gripper": feature("float32", 1),
        "observation.images.top": feature("video", 3),
        "note": feature("string", 1),
    }
    read(made(extra), note=notes.append)
    assert "left out, videos and images: observation.images.top" in notes
    assert "left out, features without a channel: observation.gripper" in notes
    assert "left out, texts: note" in notes


@pytest.mark.parametrize("names", [JOINTS, [JOINTS], {"motors": JOINTS}, {"index": 1, "thumb": 0}, None])
def test_all_ways_of_naming_columns(made, names):
    both = {key: feature("float32", 2, names) for key in ("observation.state", "action")}
    (first, _) = read(made(both))
    assert first.meta.joint_names == (tuple(JOINTS) if names else ())


def test_a_state_unlike_the_action_needs_a_map(made, mapped):
    root = made({"observation.state": feature("float32", 9)})
    with pytest.raises(UsageError, match="does not look like action") as caught:
        read(root)
    assert "--map FILE" in str(caught.value)
    path = mapped(
        channels={
            "joint_position": "observation.state[0:2]",
            "object_pose": "observation.state[2:9]",
            "action": ["action[thumb, index]"],
        },
        units={"joint_position": ["deg", "rad"], "object_pose": "mm"},
        quaternion="xyzw",
        names={"joint_position": ["x", "y"]},
        scene="table",
        action="previous",
    )
    state = np.tile([90.0, 0.5, 100.0, 200.0, 300.0, 0.0, 0.6, 0.0, 0.8], (7, 1))
    (first, _) = read(made({"observation.state": feature("float32", 9)}, {"observation.state": state}), mapping=path)
    assert first["joint_position"][0] == pytest.approx([np.pi / 2, 0.5])
    # Positions from mm to m, the quaternion from x y z w to w x y z.
    assert first["object_pose"][0] == pytest.approx([0.1, 0.2, 0.3, 0.8, 0.0, 0.6, 0.0])
    assert first.meta.joint_names == ("x", "y")
    assert (first.meta.scene, first.meta.action) == ("table", "previous")


@pytest.mark.parametrize(
    ("fields", "error", "text"),
    [
        ({"channels": {"joint_position": "observation.stat"}}, UnknownNameError, "did you mean 'observation.state'"),
        ({"channels": {"joint_positon": "action"}}, UnknownNameError, "did you mean 'joint_position'"),
        ({"channels": {"joint_position": "action[5]"}}, UsageError, "action has no columns 5"),
        ({"channels": {"joint_position": "action[thum]"}}, UnknownNameError, "did you mean 'thumb'"),
        ({"channels": {"object_pose": "action"}}, UsageError, "expected: 7 columns"),
        ({"channels": {"action": "action"}}, UsageError, "needs one of object_pose, joint_position"),
        ({"channels": {"joint_position": "action"}, "units": {"joint_position": "N"}}, UsageError, "cannot be in N"),
        ({"channels": {"joint_position": "action"}, "units": {"joint_position": "inch"}}, UnknownNameError, "'inch'"),
        ({"channels": {"joint_position": "action"}, "units": {"action": "deg"}}, UsageError, "speaks of action"),
        ({"channels": {"joint_position": "action"}, "rate": 5}, UsageError, "rate"),
        ({"channels": {"joint_position": "action[0]", "joint_velocity": "action"}}, DataError, "wrong count of joints"),
    ],
)
def test_a_wrong_map_is_refused(made, mapped, fields, error, text):
    with pytest.raises(error, match=text.replace("[", r"\[")):
        read(made(), mapping=mapped(**fields))


def test_degrees_by_name_alone_are_refused_and_taken_with_a_unit(made, mapped):
    state = {"observation.state": np.full((7, 2), 90.0)}
    with pytest.raises(DataError, match="no rad or m") as caught:
        read(made(columns=state))
    assert "units: {joint_position: deg, action: deg}" in str(caught.value)
    path = mapped(channels={"joint_position": "observation.state"}, units={"joint_position": "deg"})
    assert read(made(columns=state), mapping=path)[0]["joint_position"][0, 0] == pytest.approx(np.pi / 2)


def test_uneven_stamps_are_kept(made):
    notes = []
    root = made()
    path = root / "data/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    stamps = table["timestamp"].to_numpy().astype(np.float64)
    stamps[1] += 0.005
    column = table.schema.get_field_index("timestamp")
    pq.write_table(table.set_column(column, "timestamp", pa.array(stamps)), path)
    first, second = read(root, note=notes.append)
    # The others are float32 of the file: 4 ns of rounding at 60 ms.
    assert first["time_ns"] == pytest.approx(np.array([0, 25_000_000, 40_000_000, 60_000_000]), abs=4)
    assert second["time_ns"].tolist() == [0, 20_000_000, 40_000_000]
    assert notes[-1] == "1 episodes have stamps off the beat of fps: their stamps were kept"


def test_gaps_are_refused_or_marked(made):
    values = np.ones((7, 2))
    values[2, 1] = np.nan
    root = made(columns={"observation.state": values})
    with pytest.raises(DataError, match="joint_position is not finite") as caught:
        read(root)
    assert "observation.state[index], row 2" in str(caught.value)
    first, second = read(root, allow_gaps=True)
    assert first.valid("joint_position").tolist() == [True, True, False, True]
    assert first.meta.invalid_counts == {"joint_position": 1}
    assert second.meta.invalid_counts == {}


def test_contact_is_derived_from_forces(made):
    force = {"observation.fingertip_force": feature("float32", 6, [f"f{k}.{a}" for k in "01" for a in "xyz"])}
    values = np.zeros((7, 6))
    values[3, 2] = 1.0
    (first, _) = read(made(force, {"observation.fingertip_force": values}))
    assert first["fingertip_contact"][3].tolist() == [True, False]
    assert first["contact"].tolist() == [False, False, False, True]
    assert first.meta.contact_rule.threshold_n == 0.3
    assert first.meta.fingertip_names == ("f0", "f1")


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"codebase_version": "v3.1"}, "unknown LeRobot codebase_version"),
        ({"codebase_version": "v1.6"}, "expected: one of v2.0, v2.1, v3.0"),
        ({"codebase_version": None}, "found: None"),
        ({"fps": 0}, "fps"),
        ({"fps": "fast"}, "fps"),
        ({"features": []}, "features"),
        ({"total_episodes": 3}, "total_episodes does not agree"),
        ({"total_frames": 8}, "total_frames does not agree"),
        ({"data_path": "../{chunk_index}.parquet"}, "inside the folder"),
        ({"data_path": "/etc/{chunk_index}.parquet"}, "inside the folder"),
        ({"data_path": "data/{episode}.parquet"}, "unknown place"),
        ({"data_path": "data/{0.__class__}.parquet"}, "is missing"),
    ],
)
def test_a_wrong_info_is_refused(made, changed, text):
    with pytest.raises((DataError, UsageError), match=text):
        read(made(info=changed))


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_every_missing_file_is_named(made, version):
    root = made(version=version)
    files = sorted(p for p in root.rglob("*") if p.is_file())
    assert len(files) == (3 if version == "v3.0" else 4)
    for path in files:
        content = path.read_bytes()
        path.unlink()
        with pytest.raises(DataError, match=f"{path.name} is missing"):
            read(root)
        path.write_bytes(content)
    assert len(read(root)) == 2


def test_ragged_rows_are_refused(made):
    root = made(version="v2.1")
    path = root / "data/chunk-000/episode_000001.parquet"
    table = pq.read_table(path)
    pq.write_table(table.slice(0, 2), path)
    with pytest.raises(DataError, match="does not hold the episode's rows") as caught:
        read(root)
    assert "episode_000001.parquet" in str(caught.value)
    rows = table.to_pydict() | {"observation.state": [[1.0, 2.0], [1.0], [1.0, 2.0, 3.0]]}
    pq.write_table(pa.table(rows), path)
    with pytest.raises(DataError, match="rows of another size"):
        read(root)
    pq.write_table(table.drop_columns(["action"]), path)
    with pytest.raises(DataError, match="the table lacks action"):
        read(root)
    frames = pa.array([0, 2, 3])
    pq.write_table(table.set_column(table.schema.get_field_index("frame_index"), "frame_index", frames), path)
    with pytest.raises(DataError, match="frames are missing"):
        read(root)


def test_a_file_or_a_missing_folder_is_no_set(tmp_path):
    for path in (tmp_path, tmp_path / "none", __file__):
        with pytest.raises(DataError, match=r"info\.json"):
            read(path)


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """An export whose sidecar is gone, so that names decide."""
    root = tmp_path_factory.mktemp("names") / "set"
    root.mkdir()
    FORMAT.write([make_episode(f"e{k}", seed=k) for k in range(2)], root, Writing("set", "d" * 64))
    (root / "meta/candata.json").unlink()
    return root


def test_an_export_without_its_sidecar_is_read_by_names(exported):
    first, _ = read(exported)
    wanted = make_episode("e0")
    for channel in wanted.arrays:
        assert np.array_equal(first[channel], wanted[channel])
    assert first.meta.joint_names == ("a", "b")


def test_an_export_whose_numbers_are_called_texts_is_refused(tmp_path):
    FORMAT.write([make_episode("e0")], tmp_path, Writing("set", "d" * 64))
    path = tmp_path / "meta/info.json"
    info = json.loads(path.read_text())
    info["features"]["time_ns"]["dtype"] = "string"
    path.write_text(json.dumps(info))
    with pytest.raises(DataError, match="the data are not what was exported"):
        read(tmp_path)


def test_a_task_of_half_characters_is_refused(made):
    root = made(version="v2.1")
    path = root / "meta/episodes.jsonl"
    path.write_text(path.read_text().replace("grasp it", "\\ud800"))
    with pytest.raises(DataError, match="the file is no JSON"):
        read(root)


def test_a_path_too_long_and_an_info_that_is_no_file(made):
    root = made(info={"data_path": "a" * 5000 + ".parquet"})
    with pytest.raises(DataError, match="is missing"):
        read(root)
    (root / "meta/info.json").unlink()
    os.mkfifo(root / "meta/info.json")
    with pytest.raises(DataError, match=r"info\.json is missing"):
        read(root)


def test_the_real_picks(shared):
    folder = shared / "realdata" / "g1_inspire_pick"
    episodes = read(folder)
    assert [episode.meta.id for episode in episodes[:2]] == ["g1_inspire_pick-0", "g1_inspire_pick-1"]
    assert episodes[0].meta.task == "Pick up the yellow bottle on the table."
    for own, fetched in zip(episodes, g1_inspire_pick.from_folder(folder).episodes, strict=True):
        assert tuple(name.removeprefix("k") for name in own.meta.joint_names) == fetched.meta.joint_names
        for channel in ("time_ns", "joint_position", "action"):
            assert np.array_equal(own[channel], fetched[channel])
