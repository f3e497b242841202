"""Windows are the rows of their episodes, at the model's rate, padded and flagged where there is nothing."""

from __future__ import annotations

import shlex

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from candata.datasets import Dataset, append, create_dataset, open_dataset, put_cloud
from candata.errors import DataError, UnknownNameError, UsageError
from candata.loaders import Windows, windows
from candata.schema.manifest import Lineage
from candata_cli.main import build

CHANNELS = ("object_pose", "joint_position", "action", "fingertip_force", "contact")


def check_against_episodes(feed: Windows, dataset: Dataset, strides: dict[str, int]) -> None:
    """Compare every window with a loop over the rows of its episode."""
    batch = feed.batch(np.arange(len(feed)))
    episodes = {episode.meta.id: episode for episode in dataset}
    for i in range(len(feed)):
        episode = episodes[feed.episode_ids[batch["episode"][i]]]
        stride, last = strides[episode.meta.id], len(episode) - 1
        wanted = [int(batch["row"][i]) + k * stride for k in range(1 - feed.history, feed.horizon + 1)]
        rows = [min(max(row, 0), last) for row in wanted]
        for name in feed.channels:
            both = np.concatenate([batch[f"history/{name}"][i], batch[f"future/{name}"][i]])
            np.testing.assert_array_equal(both, episode[name][rows])
        flags = np.concatenate([batch["history_pad"][i], batch["future_pad"][i]])
        np.testing.assert_array_equal(flags, np.array(rows) != wanted)
        commands = episode["action"][rows]
        np.testing.assert_array_equal(batch["planned/action"][i], commands[feed.history - 1 : -1])


def test_windows_are_the_rows_of_their_episodes(hand, store):
    dataset = store(hand("a", 30), hand("b", 41, offset=100), hand("c", 3, offset=900))
    for pad in ("history", "both", "none"):
        feed = windows(dataset, history=3, horizon=2, stride=4, pad=pad)
        check_against_episodes(feed, dataset, dict.fromkeys("abc", 4))
    assert feed.channels == CHANNELS
    assert feed.rate_hz == 20


@pytest.fixture(scope="module")
def uneven(hand, tmp_path_factory) -> Dataset:
    """Two episodes of unequal length, shared by the examples of a property."""
    root = create_dataset(tmp_path_factory.mktemp("uneven") / "ds")
    append(root, [hand("a", 45), hand("b", 62, offset=100)], Lineage(operation="test"))
    return open_dataset(root)


@given(st.integers(1, 5), st.integers(1, 4), st.sampled_from([1, 2, 5]), st.sampled_from(["history", "both", "none"]))
def test_any_size_of_window(uneven, history, horizon, stride, pad):
    feed = windows(uneven, history, horizon, stride=stride, pad=pad, step=3)
    check_against_episodes(feed, uneven, dict.fromkeys(uneven.ids, stride))


def test_which_rows_are_present_rows(hand, store):
    dataset = store(hand("a", 30))
    rows = {
        pad: windows(dataset, 3, 2, stride=4, pad=pad).batch(np.arange(30 - k))["row"]
        for pad, k in (("history", 8), ("both", 4), ("none", 16))
    }
    np.testing.assert_array_equal(rows["history"], np.arange(0, 22))
    np.testing.assert_array_equal(rows["both"], np.arange(0, 26))
    np.testing.assert_array_equal(rows["none"], np.arange(8, 22))
    assert len(windows(dataset, 3, 2, stride=4, step=5)) == 5


def test_ten_hertz_is_every_eighth_row(hand, store):
    batch = windows(store(hand("a", 200)), history=2, horizon=2).batch([100])
    np.testing.assert_array_equal(batch["history/joint_position"][0, :, 0], [92, 100])
    np.testing.assert_array_equal(batch["future/joint_position"][0, :, 0], [108, 116])
    np.testing.assert_array_equal(batch["planned/action"][0, :, 0], [100.5, 108.5])


def test_the_rate_that_is_advised_is_taken(hand, store):
    dataset = store(hand("a", 60, rate_hz=83.0))
    with pytest.raises(DataError, match=r"take rate_hz = 10\.375, every 8 rows") as caught:
        windows(dataset, 2, 2)
    advised = float(str(caught.value).split("rate_hz = ")[-1].split(",")[0])
    assert windows(dataset, 2, 2, rate_hz=advised).stride.tolist() == [8]


def test_each_episode_has_the_stride_of_its_own_rate(hand, store):
    dataset = store(hand("fast", 60, rate_hz=80.0), hand("slow", 60, rate_hz=20.0))
    feed = windows(dataset, 2, 2, rate_hz=10)
    check_against_episodes(feed, dataset, {"fast": 8, "slow": 2})
    with pytest.raises(UsageError, match="a stride needs one rate") as caught:
        windows(dataset, 2, 2, stride=8)
    assert "20 Hz, 80 Hz" in str(caught.value)


def test_rows_beyond_a_break_of_the_clock_are_flagged(hand, store):
    """Rows 0 to 14, then half a second without any, then 15 to 29: no step leads over it."""
    time_ns = np.arange(30) * 12_500_000 + np.where(np.arange(30) < 15, 0, 500_000_000)
    feed = windows(store(hand("a", 30, arrays={"time_ns": time_ns}), hand("b", 30)), 3, 2, stride=2)
    batch = feed.batch(np.arange(len(feed)))
    rows = batch["row"][:, None] + 2 * np.arange(-2, 3)
    broken = (batch["episode"] == 0)[:, None] & ((rows < 15) != (batch["row"] < 15)[:, None])
    flags = np.concatenate([batch["history_pad"], batch["future_pad"]], axis=1)
    np.testing.assert_array_equal(flags, broken | (rows < 0))
    assert broken.any()


def test_gaps_are_flagged_and_never_begin_a_window(hand, store):
    gap = np.isin(np.arange(30), [0, 10, 11])
    pose = np.array(hand("x", 30)["object_pose"])
    pose[gap] = np.nan
    feed = windows(store(hand("a", 30, arrays={"object_pose": pose, "object_pose_valid": ~gap})), 3, 2, stride=1)
    batch = feed.batch(np.arange(len(feed)))
    assert not set(batch["row"].tolist()) & {0, 10, 11}
    at = int(np.flatnonzero(batch["row"] == 9)[0])
    np.testing.assert_array_equal(batch["future_pad"][at], [True, True])
    np.testing.assert_array_equal(batch["history_pad"][at], [False, False, False])
    assert all(np.isfinite(values).all() for values in batch.values())
    # The last valid value stands in the gap, the first one before the first.
    np.testing.assert_array_equal(batch["future/object_pose"][at], pose[[9, 9]].astype(np.float32))
    one = int(np.flatnonzero(batch["row"] == 1)[0])
    np.testing.assert_array_equal(batch["history/object_pose"][one, 1], pose[1].astype(np.float32))
    np.testing.assert_array_equal(batch["history_pad"][one], [True, True, False])


def test_a_pose_that_is_never_valid_stays_finite(hand, store):
    arrays = {"object_pose": np.full((30, 7), np.nan), "object_pose_valid": np.zeros(30, bool)}
    dataset = store(hand("a", 30), hand("b", 30, arrays=arrays))
    feed = windows(dataset, 3, 2, stride=1)
    assert set(feed.owner.tolist()) == {0}
    np.testing.assert_array_equal(feed.cache.rows["object_pose"][30:], np.tile([0, 0, 0, 1, 0, 0, 0], (30, 1)))
    with pytest.raises(DataError, match="no window begins at a valid row"):
        windows(store(hand("b", 30, arrays=arrays), name="other"), 3, 2, stride=1)


def test_a_command_that_was_stored_after_its_step_is_put_before_it(hand, store):
    after = windows(store(hand("a", 30, action="previous")), 1, 2, stride=1).batch([4])
    np.testing.assert_array_equal(after["planned/action"][0, :, 0], [5.5, 6.5])


def test_clouds_of_unequal_size_are_thinned(hand, store, rng):
    dataset = store(hand("none", 30))
    many, few = rng.normal(size=(40, 3)).astype(np.float32), rng.normal(size=(25, 3)).astype(np.float32)
    names = [put_cloud(dataset.path, cloud) for cloud in (many, few)]
    dataset = store(hand("many", 31, point_cloud=names[0]), hand("few", 32, point_cloud=names[1]))
    feed = windows(dataset, 1, 1, stride=1)
    assert feed.clouds.shape == (2, 25, 3)
    assert feed.sizes() == {"history": 1, "horizon": 1, "joints": 2, "actuators": 2, "fingertips": 1, "points": 25}
    batch = feed.batch(np.arange(len(feed)))
    ids = [feed.episode_ids[e] for e in batch["episode"]]
    expected = {"none": -1, "many": feed.cloud_names.index(names[0]), "few": feed.cloud_names.index(names[1])}
    assert [expected[name] for name in ids] == batch["cloud"].tolist()
    np.testing.assert_array_equal(feed.clouds[expected["few"]], few)
    assert {tuple(p) for p in feed.clouds[expected["many"]].tolist()} <= {tuple(p) for p in many.tolist()}
    with pytest.raises(DataError, match="lacks point clouds") as caught:
        windows(dataset, 1, 1, stride=1, channels=["joint_position", "point_cloud"])
    assert caught.value.where.episode == "none"


def test_a_window_alone_is_a_batch_without_its_first_axis(hand, store):
    feed = windows(store(hand("a", 30)), 3, 2, stride=1)
    batch = feed.batch([0, 5])
    assert {name: values.tolist() for name, values in feed[5].items()} == {n: v[1].tolist() for n, v in batch.items()}
    with pytest.raises(IndexError):
        feed[len(feed)]


def test_writing_to_a_batch_changes_no_other(hand, store):
    feed = windows(store(hand("a", 30)), 3, 2, stride=1)
    feed.batch([4])["history/joint_position"][:] = 99
    assert feed.batch([4])["history/joint_position"].max() < 99


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"horizon": 400}, DataError, ["no episode is long enough", "3201 rows", "2 episodes of 30 to 50 rows"]),
        (
            {"rate_hz": 30.0},
            DataError,
            ["no whole multiple", "rate_hz = 30", "80 Hz", "take rate_hz = 26.66666667, every 3 rows"],
        ),
        ({"rate_hz": 160.0}, DataError, ["no whole multiple", "80 Hz"]),
        ({"rate_hz": 0.0}, UsageError, ["rate_hz must be positive"]),
        ({"rate_hz": float("nan")}, UsageError, ["rate_hz must be positive"]),
        ({"stride": 0}, UsageError, ["stride is too small"]),
        ({"history": 0}, UsageError, ["history is too small"]),
        ({"horizon": -1}, UsageError, ["horizon is too small"]),
        ({"step": 0}, UsageError, ["step is too small"]),
        ({"pad": "left"}, UnknownNameError, ["padding 'left'"]),
        ({"channels": ["contact", "joint_velocity"]}, DataError, ["lacks the channel joint_velocity", "2 without it"]),
        ({"channels": ["joint_positon"]}, UnknownNameError, ["did you mean 'joint_position'"]),
        ({"split": "training"}, UnknownNameError, ["'training'"]),
    ],
)
def test_what_cannot_be_is_refused_with_the_facts(hand, store, arguments, error, words):
    dataset = store(hand("a", 30), hand("b", 50), hand("c", 50), hand("d", 50), hand("e", 50))
    if "split" not in arguments:
        dataset = store(hand("a", 30), hand("b", 50), name="two")
    with pytest.raises(error) as caught:
        windows(dataset, **{"history": 2, "horizon": 2} | arguments)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_dataset_without_contact_says_what_to_do(hand, store):
    dataset = store(hand("a", 30), hand("b", 30, arrays={"contact": None}))
    assert "contact" not in windows(dataset, 2, 2, stride=1).channels
    with pytest.raises(DataError, match="lacks the channel contact") as caught:
        windows(dataset, 2, 2, stride=1, channels=["contact"])
    assert caught.value.where.episode == "b"
    assert "model without contact" in str(caught.value)


def test_two_hands_in_one_dataset_are_refused(hand, store):
    wider = {"joint_position": np.zeros((30, 3))}
    dataset = store(hand("a", 30), hand("b", 30, arrays=wider, joint_names=("a", "b", "c")))
    with pytest.raises(DataError, match="differ in the shape of joint_position"):
        windows(dataset, 2, 2, stride=1)
    dataset = store(hand("a", 30), hand("b", 30, joint_names=("b", "a")), name="turned")
    with pytest.raises(DataError, match="differ in their joint names"):
        windows(dataset, 2, 2, stride=1)
    assert len(windows(dataset, 2, 2, stride=1, channels=["object_pose"]))


@pytest.mark.parametrize(
    ("labels", "where"),
    [
        ({"source": "real"}, "source in ('sim')"),
        ({"object": "a $5 'cup'"}, "object in ('box')"),
        ({}, "id not in ('r1', 'r2')"),
    ],
)
def test_episodes_that_lack_a_channel_are_named_with_a_filter_that_leaves_them_out(
    hand, store, tmp_path, monkeypatch, labels, where
):
    pytest.importorskip("duckdb")
    with_pose = [hand(name, 12, offset=n, object="box", task=None if n else "lift") for n, name in enumerate("abc")]
    without = [hand(f"r{n}", 12, arrays={"object_pose": None}, **{"object": "box"} | labels) for n in (1, 2)]
    data = store(*with_pose, *without)
    with pytest.raises(DataError) as caught:
        windows(data, channels=["object_pose"])
    assert "2 without it (r1, r2)" in str(caught.value)
    command = str(caught.value).partition("candata ")[2].partition("; or import")[0]
    assert where in command
    monkeypatch.setenv("CANDATA_REGISTRY", str(tmp_path / "registry.json"))
    words = shlex.split(command.replace("NEW", str(tmp_path / "new")))
    assert CliRunner().invoke(build(), words).exit_code == 0
    assert open_dataset(tmp_path / "new").ids == ("a", "b", "c")
    assert len(windows(tmp_path / "new", channels=["object_pose"], history=2, horizon=2, rate_hz=80)) > 0
