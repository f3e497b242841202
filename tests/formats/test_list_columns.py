"""Columns that hold a list in each row, as pandas, LeRobot and numpy write them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import yaml

from candata.errors import CandataError
from candata.formats.table import read
from candata.schema.contact import fingertip_contact

ROWS = 5
STATE = np.arange(ROWS * 4, dtype=float).reshape(ROWS, 4) / 10
FORCE = np.arange(ROWS * 6, dtype=float).reshape(ROWS, 2, 3)
TIME = np.arange(ROWS) * 0.02


def write(folder, columns, channels, **fields):
    """Write a Parquet file, or an npz where all are arrays of numbers, and its map; return the map's path."""
    packed = all(isinstance(values, np.ndarray) for values in columns.values())
    file = folder / ("run.npz" if packed else "run.parquet")
    if packed:
        np.savez(file, t=TIME, **columns)
    else:
        pa.parquet.write_table(pa.table({"t": TIME} | columns), file)
    mapping = {"file": file.name, "time_s": "t", "rate_hz": 50, "channels": channels} | fields
    (folder / "map.yaml").write_text(yaml.safe_dump(mapping))
    return folder / "map.yaml"


def refusal(path, **options) -> str:
    with pytest.raises(CandataError) as caught:
        list(read(path, **options))
    return str(caught.value).replace(f"{path.parent}/", "")


KINDS = {
    "lists": pa.array(STATE.tolist()),
    "large": pa.array(STATE.tolist(), pa.large_list(pa.float32())),
    "fixed": pa.FixedSizeListArray.from_arrays(pa.array(STATE.ravel()), 4),
    "nested": pa.array(STATE.reshape(ROWS, 2, 2).tolist()),
    "npz": STATE,
    "npz axes": STATE.reshape(ROWS, 2, 2),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_list_is_taken_whole_or_by_its_numbers(tmp_path, kind):
    channels = {"joint_position": "state[0:2]", "joint_velocity": ["state[3, 2]"], "action": "state"}
    (episode,) = read(write(tmp_path, {"state": KINDS[kind]}, channels))
    np.testing.assert_array_equal(episode["joint_position"], STATE[:, :2].astype(np.float32))
    np.testing.assert_array_equal(episode["joint_velocity"], STATE[:, [3, 2]].astype(np.float32))
    np.testing.assert_array_equal(episode["action"], STATE.astype(np.float32))
    assert episode.meta.joint_names == ()


@pytest.mark.parametrize(
    "entry", ["force", ["left", "right"], [["left"], ["right"]], [["left"], ["right[0]", "right[1:]"]]]
)
def test_forces_are_three_numbers_a_fingertip(tmp_path, entry):
    columns = {"state": pa.array(STATE.tolist()), "force": pa.array(FORCE.tolist())}
    columns |= {name: pa.array(FORCE[:, i].tolist()) for i, name in enumerate(("left", "right"))}
    channels = {"joint_position": "state", "fingertip_force": entry}
    (episode,) = read(write(tmp_path, columns, channels, fingertip_names=["thumb", "index"]))
    np.testing.assert_array_equal(episode["fingertip_force"], FORCE.astype(np.float32))
    assert episode.meta.fingertip_names == ("thumb", "index")
    np.testing.assert_array_equal(episode["fingertip_contact"], fingertip_contact(FORCE, 0.3))


def test_a_map_names_the_elements_of_a_list(tmp_path):
    channels = {"joint_position": "state[0:2]", "joint_velocity": "state[2:4]", "action": "state[0:2]"}
    names = {"joint_names": ["hip", "knee"], "actuator_names": ["m1", "m2"]}
    (episode,) = read(write(tmp_path, {"state": pa.array(STATE.tolist())}, channels, **names))
    assert (episode.meta.joint_names, episode.meta.actuator_names) == (("hip", "knee"), ("m1", "m2"))
    names["joint_names"] = ["hip"]
    text = refusal(write(tmp_path, {"state": pa.array(STATE.tolist())}, channels, **names))
    assert text.startswith("joint_position has the wrong number of names\n  expected: 2\n  found: 1\n")


def test_units_of_a_channel_a_list_an_entry_or_one_number(tmp_path):
    state = {"state": pa.array(STATE.tolist())}
    channels = {"joint_position": "state[0:2]", "action": "state[2:4]"}
    factors = {"joint_position": [1, 1], "state": [1, 1], "state[0:2]": [1, 1], "state[1]": [0, 1]}
    for name, scaled in factors.items():
        (episode,) = read(write(tmp_path, state, channels, units={name: "deg"}))
        wanted = STATE[:, :2] * np.where(scaled, np.pi / 180, 1)
        np.testing.assert_allclose(episode["joint_position"], wanted, rtol=1e-6)  # float32 rounding
    text = refusal(write(tmp_path, state, channels, units={"state[4]": "deg"}))
    assert text.startswith("unknown channel or column in units 'state[4]'")
    assert "state[1] cannot be in N" in refusal(
        write(tmp_path, state, channels | {"action": "state[1]"}, units={"state[1]": "N"})
    )


def test_a_quaternion_may_have_its_real_part_last(tmp_path):
    pose = np.tile([0.1, 0.2, 0.3, 0.6, 0.0, 0.0, 0.8], (ROWS, 1))
    columns = {"pose": pa.array(pose.tolist())}
    (episode,) = read(write(tmp_path, columns, {"object_pose": "pose"}, quaternion="xyzw"))
    np.testing.assert_allclose(episode["object_pose"][0], [0.1, 0.2, 0.3, 0.8, 0.6, 0, 0], rtol=1e-6)


@pytest.mark.parametrize("words", [["True", "False", "true", "FALSE", "True"], [True, False, True, False, True]])
def test_flags_may_be_words(tmp_path, words):
    columns = {"state": pa.array(STATE.tolist()), "touch": pa.array(words)}
    (episode,) = read(write(tmp_path, columns, {"joint_position": "state", "contact": "touch"}))
    assert episode["contact"].tolist() == [True, False, True, False, True]


def test_words_are_flags_and_no_positions(tmp_path):
    columns = {"state": pa.array([["True", "False"]] * ROWS), "touch": pa.array(["True", "no", None, "True", "True"])}
    text = refusal(write(tmp_path, columns, {"joint_position": "state"}))
    assert text.startswith("column state does not hold numbers\n  expected: numbers\n  found: 'True' ")
    text = refusal(write(tmp_path, columns, {"joint_position": "t", "contact": "touch"}))
    assert text.startswith("column touch does not hold numbers\n  expected: numbers\n  found: 'True' ")


def test_a_list_of_another_length_is_told_with_its_row(tmp_path):
    state = STATE.tolist()
    state[3] = state[3][:2]
    path = write(tmp_path, {"state": pa.array(state)}, {"joint_position": "state[0:2]"})
    assert refusal(path) == (
        "column state holds lists of several lengths\n  expected: 4 values, as in most rows\n  found: 2 values\n"
        "  where: run.parquet, index 3"
    )
    nested = STATE.reshape(ROWS, 2, 2).tolist()
    nested[2] = [[1.0], [2.0]]
    path = write(tmp_path, {"state": pa.array(nested)}, {"joint_position": "state"})
    assert refusal(path).endswith(
        "expected: 2 values, as in most rows\n  found: 1 values\n  where: run.parquet, index 2"
    )


def test_a_row_without_a_list_or_a_number_is_a_gap(tmp_path):
    state = STATE.tolist()
    state[1], state[2][0] = None, None
    path = write(tmp_path, {"state": pa.array(state)}, {"joint_position": "state[0:2]"})
    assert "a gap in column state[0], row 1 of the file" in refusal(path)
    (episode,) = read(path, allow_gaps=True)
    assert episode["joint_position_valid"].tolist() == [True, False, False, True, True]


def test_a_name_with_brackets_is_a_column_of_its_own(tmp_path):
    columns = {"state[0:2]": pa.array(STATE[:, 3]), "state": pa.array(STATE.tolist())}
    (episode,) = read(write(tmp_path, columns, {"joint_position": ["state[0:2]"], "action": "state[1]"}))
    np.testing.assert_array_equal(episode["joint_position"], STATE[:, 3:].astype(np.float32))


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ("state[0:5]", "state has no columns 0:5\n  expected: numbers from 0 to 3"),
        ("state[4]", "state has no columns 4\n"),
        ("state[2:1]", "state has no columns 2:1\n"),
        ("state[a]", "unknown column of state 'a'"),
        ("state[]", "unknown column of state ''"),
        ("states[0]", "the table has no column states\n"),
        (["state[0]", "state[0:2]"], "joint_position names a column twice\n  found: state[0]\n"),
        ([], "joint_position has the wrong columns\n  expected: a list of columns\n  found: an empty list\n"),
    ],
)
def test_what_a_list_does_not_have(tmp_path, entry, text):
    assert text in refusal(write(tmp_path, {"state": pa.array(STATE.tolist())}, {"joint_position": entry}))


def test_nothing_but_what_is_asked_for_is_read(tmp_path):
    """A picture column that is damaged does not matter, nor a list of uneven length."""
    path = write(
        tmp_path,
        {"picture": pa.array([b"\x01" * 4000] * ROWS), "uneven": pa.array([[1.0]] * 4 + [[]]), "q": pa.array(TIME)},
        {"joint_position": ["q"]},
    )
    file = path.parent / "run.parquet"
    column = next(
        c for i in range(4) if (c := pa.parquet.read_metadata(file).row_group(0).column(i)).path_in_schema == "picture"
    )
    raw = bytearray(file.read_bytes())
    start = column.dictionary_page_offset or column.data_page_offset
    raw[start : start + 40] = b"\xff" * 40
    file.write_bytes(raw)
    (episode,) = read(path)
    assert len(episode) == ROWS
