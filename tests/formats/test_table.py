"""What a map promises is what the episodes hold."""

import hashlib
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from candata.errors import DataError
from candata.formats.table import FORMAT, digest, map_digest, read
from candata.schema.contact import fingertip_contact
from candata.schema.scene import TableMap
from tests.formats.conftest import CHANNELS

FORCES = [f"f{i}_{axis}" for i in (0, 1) for axis in "xyz"]


def one(path, **options):
    return next(read(path, **options))


@pytest.mark.parametrize("kind", ["parquet", "csv", "npz"])
def test_every_kind_of_table_gives_the_same_episodes(columns, write, kind):
    episodes = list(read(write(columns, kind)))
    assert [e.meta.id for e in episodes] == ["run-4", "run-2"]
    np.testing.assert_array_equal(episodes[1]["time_ns"], [0, 10_000_000, 20_000_000])
    wanted = np.stack([columns["q_thumb_bend"], columns["q_index1"]], axis=1)[3:]
    np.testing.assert_array_equal(episodes[1]["joint_position"], wanted.astype(np.float32))
    force = np.stack([columns[name] for name in FORCES], axis=1).reshape(-1, 2, 3)
    np.testing.assert_array_equal(episodes[0]["fingertip_force"], force[:3].astype(np.float32))


def test_names_come_from_the_columns(columns, write):
    meta = one(write(columns)).meta
    assert meta.joint_names == meta.actuator_names == ("thumb_bend", "index1")
    assert meta.fingertip_names == ("f0", "f1")


@pytest.mark.parametrize("names", [None, ["bend", "index"]])
def test_one_column_of_the_supply_serves_all_actuators(columns, write, names):
    columns = columns | {"v": np.linspace(12, 11, 6)}
    path = write(columns, channels=CHANNELS | {"supply_voltage": ["v"]}, actuator_names=names)
    np.testing.assert_array_equal(one(path)["supply_voltage"], np.float32(columns["v"][:3, None].repeat(2, axis=1)))


def test_the_map_s_words_are_kept(columns, write):
    words = {
        "source": "sim",
        "scene": "s",
        "object": "o",
        "task": "k",
        "force": "instant",
        "action": "previous",
    }
    meta = one(write(columns, **words)).meta
    assert {name: getattr(meta, name) for name in words} == words
    assert meta.rate_hz == 100.0


def test_without_an_episode_column_all_rows_are_one(columns, write):
    columns["t"] = np.arange(6) * 0.01
    (episode,) = read(write(columns, episode=None))
    assert (episode.meta.id, len(episode)) == ("run", 6)


def test_rows_of_episodes_may_be_interleaved(columns, write):
    together = list(read(write(columns)))
    shuffled = {name: values[[0, 3, 1, 4, 2, 5]] for name, values in columns.items()}
    for a, b in zip(together, read(write(shuffled)), strict=True):
        assert a.meta == b.meta
        assert all((a[name] == b[name]).all() for name in a.arrays)


@pytest.mark.parametrize(
    ("labels", "ids"),
    [
        (np.repeat(["b", "a"], 3), ["run-b", "run-a"]),
        (np.repeat([3.0, 1.0], 3), ["run-3", "run-1"]),
    ],
)
def test_episodes_may_be_named_by_words_and_numbers(columns, write, labels, ids):
    columns["episode"] = labels
    assert [e.meta.id for e in read(write(columns))] == ids


def test_a_channel_s_unit_leaves_the_quaternion_alone(columns, write):
    plain = one(write(columns))["object_pose"]
    scaled = one(write(columns, units={"object_pose": "mm"}))["object_pose"]
    np.testing.assert_allclose(scaled[:, :3], plain[:, :3] * 1e-3, rtol=1e-6)  # float32 rounding
    np.testing.assert_array_equal(scaled[:, 3:], plain[:, 3:])


def test_a_column_s_unit_comes_before_its_channel_s(columns, write):
    plain = one(write(columns))["joint_position"]
    scaled = one(write(columns, units={"joint_position": "deg", "q_index1": "mm"}))["joint_position"]
    np.testing.assert_allclose(scaled, plain * [np.pi / 180, 1e-3], rtol=1e-6)  # float32 rounding


def test_velocity_units_apply_to_the_half_they_fit(columns, write):
    names = ["px", "py", "pz", "f0_x", "f0_y", "f0_z"]
    channels = {"object_pose": ["px", "py", "pz", "qw", "qx", "qy", "qz"], "object_velocity": names}
    plain = one(write(columns, channels=channels))["object_velocity"]
    scaled = one(write(columns, channels=channels, units={"object_velocity": "deg/s"}))["object_velocity"]
    np.testing.assert_array_equal(scaled[:, :3], plain[:, :3])
    np.testing.assert_allclose(scaled[:, 3:], plain[:, 3:] * np.pi / 180, rtol=1e-6)  # float32 rounding


def test_whole_nanoseconds_stay_exact(columns, write):
    stamps = 1_700_000_000_000_000_001 + np.arange(3) * 10_000_000
    columns["t"] = np.tile(stamps, 2)
    np.testing.assert_array_equal(one(write(columns, units={"t": "ns"}))["time_ns"], stamps)


def test_calendar_stamps_are_time(columns, write):
    stamps = np.array([0, 10_000, 20_000]).astype("datetime64[us]")
    columns["t"] = np.tile(stamps, 2)
    np.testing.assert_array_equal(one(write(columns))["time_ns"], [0, 10_000_000, 20_000_000])


def test_true_stamps_are_kept(columns, write):
    columns["t"] = np.tile([0.0, 0.0101, 0.0193], 2)
    np.testing.assert_array_equal(one(write(columns))["time_ns"], [0, 10_100_000, 19_300_000])


def test_contact_is_derived_and_its_rule_kept(columns, write):
    episode = one(write(columns))
    force = np.stack([columns[name][:3] for name in FORCES], axis=1).reshape(-1, 2, 3)
    np.testing.assert_array_equal(episode["fingertip_contact"], fingertip_contact(force))
    np.testing.assert_array_equal(episode["contact"], fingertip_contact(force).any(1))
    assert episode.meta.contact_rule.threshold_n == 0.3


def test_contact_that_is_recorded_is_kept(columns, write):
    columns |= {"c0": np.array([1, 0, 1] * 2), "c1": np.array([False, False, True] * 2)}
    path = write(columns, channels={"object_pose": list(columns)[2:9], "fingertip_contact": ["c0", "c1"]})
    episode = one(path)
    assert episode["fingertip_contact"].tolist() == [[True, False], [False, False], [True, True]]
    assert episode["contact"].tolist() == [True, False, True]
    assert episode.meta.contact_rule is None


@pytest.mark.parametrize("kind", ["parquet", "csv", "npz"])
@pytest.mark.parametrize("value", [np.nan, -np.inf, np.finfo(float).max])
def test_gaps_are_marked_counted_and_not_filled(columns, write, kind, value):
    columns["q_index1"][1], columns["f1_y"][2] = value, value
    episode = one(write(columns, kind), allow_gaps=True)
    assert episode.valid("joint_position").tolist() == [True, False, True]
    assert np.isnan(episode["joint_position"][1, 1])
    assert episode["joint_position"][1, 0] == np.float32(columns["q_thumb_bend"][1])
    assert episode.valid("action").all()
    assert episode.valid("contact").tolist() == episode.valid("fingertip_contact").tolist() == [True, True, False]
    counts = {"joint_position": 1, "fingertip_force": 1, "fingertip_contact": 1, "contact": 1}
    assert episode.meta.invalid_counts == counts


def test_nothing_is_marked_where_nothing_is_missing(columns, write):
    assert not [name for name in one(write(columns), allow_gaps=True).arrays if name.endswith("_valid")]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(arrays(float, (6,), elements=st.one_of(st.just(float("nan")), st.floats(-1e3, 1e3))))
def test_a_row_is_valid_where_all_its_values_are_finite(columns, write, values):
    columns["a_index1"] = values
    episodes = list(read(write(columns, "npz"), allow_gaps=True))
    valid = np.concatenate([e.valid("action") for e in episodes])
    np.testing.assert_array_equal(valid, np.isfinite(values))


def test_the_first_gap_is_named_where_gaps_are_not_allowed(columns, write):
    columns["f1_y"][4] = np.nan
    path = write(columns)
    with pytest.raises(DataError) as caught:
        list(read(path))
    assert str(caught.value) == (
        "fingertip_force is not finite\n  expected: finite numbers\n"
        "  found: a gap in column f1_y, row 4 of the file (1 such rows in the episode)\n"
        f"  where: {path.parent / 'run.parquet'}, episode run-2, channel fingertip_force, index 1\n"
        "  do: import with --allow-gaps: such rows are kept and marked invalid"
    )


def test_the_digest_follows_map_and_data_and_nothing_else(columns, write):
    path = write(columns)
    first = digest(path)
    path.write_text("# a remark\n" + path.read_text())
    os.utime(path.parent / "run.parquet", (0, 0))
    assert digest(path) == first
    assert len(first) == len(hashlib.sha256().hexdigest())
    assert digest(write(columns, rate_hz=99)) != first
    columns["px"][0] += 1.0
    assert digest(write(columns)) != first


def test_the_folder_registers_the_format():
    assert FORMAT.name == "table"


def test_a_map_without_later_fields_keeps_the_digest_it_always_had():
    """So a source that was imported before they existed is known again."""
    mapping = TableMap(file="a.csv", time_s="t", rate_hz=80, channels={"joint_position": ["q"]})
    assert map_digest(mapping, "0") == "22694d5ce1c933c1658ea915fb6fcdd81d4ab8aac95c9bb86645f554809c41ee"
    assert map_digest(mapping.model_copy(update={"quaternion": "xyzw"}), "0") != map_digest(mapping, "0")
