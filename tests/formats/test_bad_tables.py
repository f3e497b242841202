"""Every wrong map and table is refused with one message: what, expected, found, where, what to do."""

import os
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import yaml

from candata.errors import DataError, UnknownNameError, UsageError
from candata.formats.table import digest, read

POSE = ["px", "py", "pz", "qw", "qx", "qy", "qz"]
FORCES = ["f0_x", "f0_y", "f0_z", "f1_x", "f1_y", "f1_z"]


def refusal(path, kind=UsageError, **options) -> str:
    with pytest.raises(kind) as caught:
        list(read(path, **options))
    assert caught.value.exit_code == 2
    assert str(path.parent) in str(caught.value)
    return str(caught.value).replace(f"{path.parent}/", "")


def test_a_missing_column_names_the_nearest(columns, write):
    columns["pos_x"] = columns.pop("px")
    columns["Q_index1"] = columns.pop("q_index1")
    text = refusal(write({k: columns[k] for k in sorted(columns)}, "csv"), DataError)
    assert text.splitlines()[0] == "the table has no column px, q_index1"
    assert text.splitlines()[2].startswith("  found: columns Q_index1, a_index1,")
    assert text.splitlines()[-1].startswith("  do: did you mean ")
    assert "q_index1 -> Q_index1" in text


def test_a_missing_time_or_episode_column(columns, write):
    assert "no column T\n" in refusal(write(columns, time_s="T"), DataError)
    assert "no column run\n" in refusal(write(columns, episode="run"), DataError)


def test_wrong_counts_of_joints_and_fingertips(columns, write):
    channels = {"joint_position": ["px", "py"], "joint_velocity": ["pz"]}
    assert refusal(write(columns, channels=channels), DataError) == (
        "joint_velocity has the wrong count of joints\n  expected: 2 as in joint_position\n  found: 1\n"
        "  where: map.yaml, channel joint_velocity\n"
        "  do: give a map that picks the columns of both channels in the same order"
    )
    channels = {"object_pose": POSE, "fingertip_force": [["px", "py", "pz"]], "fingertip_contact": ["qw", "qx"]}
    assert "wrong count of fingertips" in refusal(write(columns, channels=channels), DataError)


@pytest.mark.parametrize(
    ("channels", "text"),
    [
        ({"object_pose": POSE[:6]}, "number of columns\n  expected: 7 columns\n  found: 6: px, py, pz, qw, qx, qy"),
        ({"object_pose": [POSE]}, "columns\n  expected: a list of columns\n  found: lists of 7"),
        ({"joint_position": []}, "columns\n  expected: a list of columns\n  found: an empty list"),
        ({"joint_position": [["px"]]}, "columns\n  expected: a list of columns\n  found: lists of 1"),
        (
            {"object_pose": POSE, "contact": ["px", "py"]},
            "number of columns\n  expected: 1 columns\n  found: 2: px, py",
        ),
        (
            {"object_pose": POSE, "fingertip_force": FORCES[:2]},
            "number of columns\n  expected: 3 columns a fingertip\n  found: 2: f0_x, f0_y",
        ),
        (
            {"object_pose": POSE, "fingertip_force": [FORCES[:2], FORCES[2:]]},
            "columns\n  expected: a list of lists of 3 columns\n  found: lists of 2, 4",
        ),
        (
            {"object_pose": POSE, "fingertip_force": [FORCES[:3], *FORCES[3:]]},
            "columns\n  expected: a list of lists of 3 columns\n  found: lists of 3 beside f1_x, f1_y, f1_z",
        ),
    ],
)
def test_wrong_columns_of_a_channel(columns, write, channels, text):
    assert f"has the wrong {text}\n" in refusal(write(columns, channels=channels))


def test_a_column_named_twice(columns, write):
    text = refusal(write(columns, channels={"joint_position": ["px", "px"]}))
    assert text == "joint_position names a column twice\n  found: px\n  where: map.yaml, channel joint_position"


def test_an_unknown_channel_names_the_nearest(columns, write):
    text = refusal(write(columns, channels={"object_poses": POSE}), UnknownNameError)
    assert text.splitlines()[0] == "unknown channel 'object_poses'"
    assert "time_ns" not in text
    assert text.endswith("do: did you mean 'object_pose'?")


def test_a_map_without_a_state(columns, write):
    text = refusal(write(columns, channels={"action": ["a_index1"]}))
    assert text.splitlines()[0] == "the map needs one of object_pose, joint_position"


def test_units(columns, write):
    assert "unknown unit 'inch'" in refusal(write(columns, units={"object_pose": "inch"}), UnknownNameError)
    text = refusal(write(columns, units={"object_pos": "mm"}), UnknownNameError)
    assert "unknown channel or column in units 'object_pos'" in text
    assert text.endswith("did you mean 'object_pose'?")
    text = refusal(write(columns, units={"object_pose": "deg"}))
    assert text.startswith("object_pose cannot be in deg\n  expected: one of cm, m, mm\n")
    assert "px cannot be in N" in refusal(write(columns, units={"px": "N"}))
    assert "t cannot be in mm\n  expected: one of ms, ns, s, us" in refusal(write(columns, units={"t": "mm"}))


def test_a_map_that_is_missing_or_no_yaml(tmp_path):
    assert refusal(tmp_path / "map.yaml") == (
        "the map cannot be read\n  expected: a YAML file\n  found: No such file or directory\n  where: map.yaml"
    )
    (tmp_path / "map.yaml").write_text("file: [")
    assert refusal(tmp_path / "map.yaml").startswith("the map is no YAML\n")
    (tmp_path / "map.yaml").write_text("- 1")
    assert refusal(tmp_path / "map.yaml").startswith("map.yaml is not valid: (whole file): ")


def test_time_going_backwards(columns, write):
    columns["t"][4:] = [0.02, 0.01]
    assert refusal(write(columns), DataError) == (
        "time does not increase\n  expected: more than 20000000 ns\n  found: 10000000 ns\n"
        "  where: run.parquet, episode run-2, channel time_ns, index 2\n"
        "  do: sort the rows by time and drop repeated stamps"
    )


def test_time_missing_or_in_another_unit(columns, write):
    columns["t"][3] = np.nan
    assert refusal(write(columns), DataError).startswith("time is missing\n")
    columns["t"] = np.tile([0.0, 10.0, 20.0], 2)
    text = refusal(write(columns), DataError)
    assert text.startswith(
        "time does not fit the rate\n  expected: steps near 0.01 s (rate_hz: 100)\n  found: steps of 10 s\n"
    )
    assert "units: {t: ms}" in text


@pytest.mark.parametrize(
    "stamps",
    [
        np.full(6, 1e300),
        np.full(6, 2**62),
        np.full(6, 2**64 - 1, np.uint64),
        np.full(6, 2**40, "datetime64[s]"),
    ],
)
def test_time_beyond_what_ns_can_say(columns, write, stamps):
    columns["t"] = stamps
    text = refusal(write(columns, "npz"), DataError)
    assert text.startswith("time lies further away than ns can say\n  expected: within 292 years of zero\n")


def test_quaternions_that_are_not_unit(columns, write):
    columns["qw"][4] = 0.5
    assert refusal(write(columns), DataError) == (
        "object_pose holds a quaternion that is not unit\n  expected: norm 1 +- 0.001\n"
        "  found: norm 0.5000 (1 rows)\n"
        "  where: run.parquet, episode run-2, channel object_pose, index 1\n"
        "  do: check the order (w x y z) and the columns of the quaternion"
    )


def test_flags_that_are_no_flags(columns, write):
    columns["c"] = np.array([0.0, 1.0, 0.4] * 2)
    text = refusal(write(columns, channels={"object_pose": POSE, "contact": ["c"]}), DataError)
    assert text.startswith("contact is no flag\n  expected: 0 or 1\n  found: 0.4\n")


@pytest.mark.parametrize("kind", ["parquet", "csv", "npz"])
def test_words_where_numbers_belong(columns, write, kind):
    columns["px"] = np.array(["1", "2", "x", "4", "5", "6"])
    text = refusal(write(columns, kind), DataError)
    assert text.startswith("column px does not hold numbers\n  expected: numbers\n  found: ")
    assert "'x'" in text


def test_an_episode_without_a_name(columns, write):
    columns["episode"] = np.array([1.0, 1, 1, 2, np.nan, 2])
    text = refusal(write(columns, "csv"), DataError)
    assert text.splitlines()[0] == "column episode does not name an episode"
    assert text.splitlines()[-1] == "  where: run.csv, index 4"


@pytest.mark.parametrize("kind", ["parquet", "csv", "npz"])
def test_an_empty_table(columns, write, kind):
    text = refusal(write({k: v[:0] for k, v in columns.items()}, kind), DataError)
    assert text == f"the table is empty\n  expected: at least 1 row\n  where: run.{kind}"


@pytest.mark.parametrize(
    ("label", "text"),
    [
        ([1, 2], "holds lists\n  expected: one value in each row\n  found: 2 values\n"),
        ([], "holds lists\n  expected: one value in each row\n"),
        ({"a": 1}, "does not name an episode\n  expected: numbers or texts\n"),
    ],
)
def test_an_episode_that_is_no_name(columns, write, label, text):
    path = write(columns)
    table = pa.table(columns | {"episode": pa.array([label] * 6)})
    pa.parquet.write_table(table, path.parent / "run.parquet")
    assert refusal(path, DataError).startswith(f"column episode {text}")


@pytest.mark.parametrize("broken", [2.5, np.inf])
def test_an_episode_named_by_a_broken_number_is_told_with_its_row(columns, write, broken):
    columns["episode"] = np.array([1.0, 1, 1, 2, broken, 2])
    assert refusal(write(columns), DataError) == (
        f"column episode does not name an episode\n  expected: whole numbers or texts\n  found: {broken}\n"
        "  where: run.parquet, index 4\n"
        "  do: give the column that numbers the episodes, or leave `episode` out for one episode"
    )


def test_an_npz_whose_columns_are_damaged(columns, write):
    path = write(columns, "npz")
    file = path.parent / "run.npz"
    np.savez_compressed(file, **columns)
    with zipfile.ZipFile(file) as packed:
        start = packed.getinfo("px.npy").header_offset + 30 + len("px.npy") + 20
    raw = bytearray(file.read_bytes())
    raw[start : start + 8] = b"\xff" * 8
    file.write_bytes(raw)
    assert refusal(path, DataError).startswith("the table cannot be read\n")


def test_columns_of_different_length(columns, write):
    columns["px"] = columns["px"][:4]
    text = refusal(write(columns, "npz"), DataError)
    assert text.startswith("the columns differ in length\n  expected: one length\n  found: px: 4 rows, ")


def test_an_array_that_is_no_column(columns, write):
    columns["px"] = np.zeros((6, 2))
    text = refusal(write(columns, "npz"))
    assert "expected: 7 columns\n  found: 8: px[0], px[1], py, pz, qw, qx, qy, qz\n" in text
    columns["px"] = np.array(0.5)
    assert refusal(write(columns, "npz"), DataError).startswith("array px is no column\n")


@pytest.mark.parametrize("kind", ["parquet", "npz"])
@pytest.mark.parametrize("keep", [0, 40, 400])
def test_a_file_that_is_cut_or_garbage(columns, write, kind, keep):
    path = write(columns, kind)
    file = path.parent / f"run.{kind}"
    file.write_bytes(file.read_bytes()[:keep])
    text = refusal(path, DataError)
    assert text.startswith(f"the table cannot be read\n  expected: a {kind} file\n  found: ")


def test_a_csv_with_a_name_twice(columns, write):
    path = write(columns, "csv")
    file = path.parent / "run.csv"
    file.write_text(file.read_text().replace('"py"', '"px"', 1).replace(",py,", ",px,", 1))
    assert refusal(path, DataError).startswith("the table has several columns px\n")


def test_a_csv_with_a_short_line(columns, write):
    path = write(columns, "csv")
    file = path.parent / "run.csv"
    file.write_text(file.read_text() + "1,2\n")
    assert refusal(path, DataError).startswith("the table cannot be read\n")
    for nothing in ("", "\n\n", "# a comment\n"):
        file.write_text(nothing)
        assert refusal(path, DataError).startswith("the table is empty\n  expected: a first line with the names")


def test_a_single_array_is_no_npz(columns, write):
    path = write(columns, "npz")
    with (path.parent / "run.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    assert "found: one array without a name" in refusal(path, DataError)


@pytest.mark.parametrize("kind", ["c16", "M8", "i4,f8"])
@pytest.mark.parametrize("name", ["px", "t", "episode"])
def test_an_array_of_what_is_no_value(columns, write, name, kind):
    columns[name] = np.zeros(6, kind)
    text = refusal(write(columns, "npz"), DataError)
    assert text.startswith(f"array {name} is no column\n  expected: numbers, texts, or times with their unit\n")


def test_an_npz_with_objects_is_not_unpickled(columns, write):
    columns["px"] = np.array([object()] * 6)
    text = refusal(write(columns, "npz"), DataError)
    assert "found: Python objects in the array px, which are not unpickled: they could run anything\n" in text


def test_a_file_that_is_not_there_or_of_another_kind(columns, write):
    path = write(columns, file="other.parquet")
    assert refusal(path, DataError).startswith("the table does not exist\n")
    with pytest.raises(DataError, match="the table does not exist"):
        digest(path)
    text = refusal(write(columns, file="run.xlsx"))
    assert text.startswith("unknown kind of table\n  expected: a file that ends in .parquet, .csv, .npz\n")


def test_a_name_too_long_and_a_map_that_is_no_file(columns, write):
    assert refusal(write(columns, file="x" * 5000 + ".csv"), DataError).startswith("the table does not exist\n")
    pipe = write(columns).parent / "pipe.yaml"
    os.mkfifo(pipe)
    assert refusal(pipe).startswith("the map cannot be read\n  expected: a YAML file\n  found: no regular file\n")


@pytest.mark.parametrize("rate_hz", [1e-300, 1e12, float("inf")])
def test_a_rate_that_no_device_has(columns, write, rate_hz):
    assert refusal(write(columns, rate_hz=rate_hz)).startswith("map.yaml is not valid: rate_hz: ")


def test_a_rate_too_long_to_be_shown(columns, write):
    path = write(columns)
    path.write_text(path.read_text().replace("rate_hz: 100", "rate_hz: 0x" + "f" * 10_000))
    assert "  expected: at most 400\n  found: a number of 10,002 digits\n" in refusal(path)


def test_a_map_with_numbers_for_columns_of_a_table_with_names(columns, write):
    path = write(columns)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"time_s": 1}))
    assert refusal(path, DataError).startswith("the table has no column 1\n")
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"time_s": True}))
    assert refusal(path).startswith("map.yaml is not valid: time_s: ")


def test_a_map_that_is_no_text_says_what_is_expected(tmp_path):
    (tmp_path / "map.yaml").write_bytes(b"PAR1\xe8")
    assert "  expected: text in UTF-8\n  found: the byte 0xe8" in refusal(tmp_path / "map.yaml")
