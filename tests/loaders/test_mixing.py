"""Mixtures: shares as asked, fixed by (seed, step, rank), reported as they are; sources that do not fit are refused."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.datasets import put_cloud
from candata.errors import DataError, UnknownNameError, UsageError
from candata.loaders import (
    Mixture,
    Sampler,
    batches,
    common_channels,
    mix,
    normalise_batch,
    parse_mixture,
    share_report,
    windows,
)
from candata.loaders.sampling import pattern


@pytest.fixture
def two(hand, store):
    """Two sources: rows below 1000 are simulated ones, the others real."""
    sim = store(hand("a", 40), hand("b", 50, offset=100), name="sim")
    real = store(hand("a", 20, offset=1000, source="real"), name="real")
    return {"sim": windows(sim, 3, 2, stride=1), "real": windows(real, 3, 2, stride=1)}


def test_a_mixture_is_read_from_text():
    found = parse_mixture("sim:0.7, real:0.3")
    assert found == Mixture(names=("sim", "real"), parts=(7, 3))
    assert found.shares == {"sim": 0.7, "real": 0.3}
    assert str(found) == "sim:0.7,real:0.3"
    assert str(parse_mixture("a:1/3,b:2/3")) == "a:1/3,b:2/3"
    assert parse_mixture("out/sim:1").names == ("out/sim",)
    assert parse_mixture("a:.25,b:0.25,c:1/2").parts == (1, 1, 2)


@given(st.lists(st.integers(1, 100), min_size=1, max_size=4))
def test_the_text_of_a_mixture_tells_it_again(parts):
    text = ",".join(f"n{i}:{part}/{sum(parts)}" for i, part in enumerate(parts))
    found = parse_mixture(text)
    assert parse_mixture(str(found)) == found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not a mixture"),
        ("sim", "not a mixture"),
        ("sim:0.7,,real:0.3", "not a mixture"),
        ("sim=0.7,real=0.3", "not a mixture"),
        ("sim:0.5,sim:0.5", "names a source twice"),
        ("sim:0.7,real:0.2", "add up to 1"),
        ("sim:1.2,real:-0.2", "share of real is not a number above 0"),
        ("sim:1,real:0", "share of real is not a number above 0"),
        ("sim:1,real:0/3", "share of real is not a number above 0"),
        ("sim:0.5,real:1/0", "share of real is not a number above 0"),
        ("sim:nan,real:0.3", "share of sim is not a number above 0"),
        ("sim:70%,real:30%", "share of sim is not a number above 0"),
        ("sim:1e99999999999,real:0.3", "share of sim is not a number above 0"),
        ("sim:0.70001,real:0.29999", "too fine"),
        ("sim:0.333,real:0.333,more:0.333", "add up to 1"),
    ],
)
def test_a_text_that_tells_no_mixture(text, words):
    with pytest.raises(UsageError, match=words) as caught:
        parse_mixture(text)
    assert "found:" in str(caught.value)


@given(st.lists(st.integers(1, 60), min_size=1, max_size=5).map(tuple))
def test_every_stretch_of_a_period_holds_the_shares_nearly(parts):
    source, nth = pattern(parts)
    counts = np.stack([np.cumsum(source == i) for i in range(len(parts))])
    assert tuple(counts[:, -1]) == parts
    wanted = np.arange(1, len(source) + 1) * np.array(parts)[:, None] / sum(parts)
    # Serving the one furthest behind: never a whole turn of the sources away.
    assert np.abs(counts - wanted).max() < len(parts)
    np.testing.assert_array_equal(nth, counts[source, np.arange(len(source))] - 1)


@given(
    st.lists(st.tuples(st.integers(1, 40), st.integers(1, 9)), min_size=1, max_size=3),
    st.integers(1, 12),
    st.integers(1, 3),
    st.integers(0, 2**64 - 1),
)
def test_each_source_is_met_whole_before_any_of_it_comes_again(sources, batch_size, world, seed):
    counts, parts = (tuple(column) for column in zip(*sources, strict=True))
    samplers = [Sampler(counts, batch_size, seed, rank, world, parts) for rank in range(world)]
    steps = 12
    line = np.concatenate([sampler.indices(step) for step in range(steps) for sampler in samplers])
    ends = np.cumsum(counts)
    for number, (first, behind) in enumerate(zip(ends - counts, ends, strict=True)):
        own = line[(line >= first) & (line < behind)]
        assert len(own) == samplers[0].draw_counts(steps)[number]
        times = np.bincount(own - first, minlength=behind - first)
        assert times.max() - times.min() <= 1


def test_windows_of_a_mixture_are_those_of_its_sources(two):
    mixed = mix(two, "real:0.25,sim:0.75")
    assert mixed.names == ("real", "sim")
    rng = np.random.default_rng(0)
    numbers = rng.permutation(len(mixed))[:64]
    batch = mixed.batch(numbers)
    np.testing.assert_array_equal(batch["domain"], (numbers >= len(two["real"])).astype(int))
    for i, number in enumerate(numbers):
        name, own = ("real", number) if number < len(two["real"]) else ("sim", number - len(two["real"]))
        alone = two[name][own]
        for key in set(alone) - {"episode"}:
            np.testing.assert_array_equal(batch[key][i], alone[key])
        assert mixed.episode_ids[batch["episode"][i]] == f"{name}/{two[name].episode_ids[alone['episode']]}"
        np.testing.assert_array_equal(mixed[int(number)]["history/action"], alone["history/action"])


def test_shares_are_what_was_asked_for_and_reported(two):
    mixed = mix(two, "sim:0.7,real:0.3")
    sampler = mixed.sampler(32, seed=3)
    domains = np.concatenate([batch["domain"] for batch in itertools.islice(batches(mixed, sampler), 10)])
    sim, real = mixed.effective(sampler, 10)
    assert [(domains == 0).sum(), (domains == 1).sum()] == [sim.drawn, real.drawn] == [224, 96]
    assert (sim.drawn_share, real.drawn_share) == (0.7, 0.3)
    assert (real.windows, real.unique, real.rows) == (18, 18, 20)
    assert real.epochs == pytest.approx(96 / 18)
    assert real.windows_share == pytest.approx(18 / (18 + 86))
    assert sim.unique == 86
    assert "real: asked 30.0%, drew 96 windows (30.0%), 18 of 18 distinct" in share_report((sim, real))
    with_three = mix(two, "sim:2/3,real:1/3")
    # 320 places are no whole number of periods of three.
    assert [one.drawn for one in with_three.effective(with_three.sampler(32), 10)] == [213, 107]


def test_invalid_rows_and_breaks_of_one_source_are_flagged_in_the_mixture(hand, store):
    valid = np.arange(30) != 12
    time_ns = np.arange(30) * 12_500_000 + np.where(np.arange(30) < 20, 0, 500_000_000)
    first = windows(store(hand("a", 30), name="one"), 3, 2, stride=1)
    arrays = {"object_pose_valid": valid, "time_ns": time_ns}
    second = windows(store(hand("a", 30, arrays=arrays), name="two"), 3, 2, stride=1)
    mixed = mix({"one": first, "two": second}, "one:1/2,two:1/2")
    batch = mixed.batch(np.arange(len(mixed)))
    for name in ("history_pad", "future_pad"):
        alone = [feed.batch(np.arange(len(feed)))[name] for feed in (first, second)]
        np.testing.assert_array_equal(batch[name], np.concatenate(alone))


def test_a_run_goes_on_at_any_step_and_ranks_share_a_step(two):
    mixed = mix(two, "sim:0.7,real:0.3")
    whole = list(itertools.islice(batches(mixed, mixed.sampler(8, seed=5)), 30))
    late = next(batches(mixed, mixed.sampler(8, seed=5), first_step=29))
    for name, values in late.items():
        np.testing.assert_array_equal(values, whole[29][name])
    ranks = [mixed.sampler(4, seed=5, rank=rank, world=2).indices(29) for rank in (0, 1)]
    np.testing.assert_array_equal(np.concatenate(ranks), mixed.sampler(8, seed=5).indices(29))


def test_clouds_of_all_sources_are_at_hand(hand, store, rng):
    clouds = [rng.normal(size=(count, 3)).astype(np.float32) for count in (30, 20)]
    feeds = {}
    for name, cloud in zip(("sim", "real"), clouds, strict=True):
        dataset = store(hand("none"), name=name)
        dataset = store(hand("some", point_cloud=put_cloud(dataset.path, cloud)), name=name)
        feeds[name] = windows(dataset, 1, 1, stride=1)
    mixed = mix(feeds, "sim:1/2,real:1/2")
    assert mixed.clouds.shape == (2, 20, 3)
    assert mixed.sizes()["points"] == 20
    batch = mixed.batch(np.arange(len(mixed)))
    named = [mixed.episode_ids[e] for e in batch["episode"]]
    expected = {"sim/none": -1, "real/none": -1, "sim/some": 0, "real/some": 1}
    assert batch["cloud"].tolist() == [expected[name] for name in named]
    np.testing.assert_array_equal(mixed.clouds[1], clouds[1])


def test_shared_statistics_are_of_what_is_drawn(hand, store):
    """Two kinds of rows, 0 and 10: a mixture of three to one has mean 2.5, whatever the numbers of rows."""
    feeds = {}
    for name, rows, value in (("sim", 200, 0.0), ("real", 40, 10.0)):
        arrays = {"joint_position": np.full((rows, 2), value)}
        feeds[name] = windows(store(hand("a", rows, arrays=arrays), name=name), 1, 2, stride=1, method="std")
    mixed = mix(feeds, "sim:0.75,real:0.25")
    centre, scale = mixed.normaliser.channel("joint_position")
    np.testing.assert_allclose(centre, 2.5, atol=1e-6)  # 180 and 60 rows exactly; float32
    np.testing.assert_allclose(scale, np.sqrt(0.75 * 0.25) * 10, rtol=1e-6)
    assert mixed.normaliser.dataset == "sim:0.75,real:0.25"
    assert {name: one.channel("joint_position")[0][0] for name, one in mixed.normalisers.items()} == {
        "sim": 0,
        "real": 10,
    }
    batch = mixed.batch([0, len(mixed) - 1])
    apart = normalise_batch(batch, list(mixed.normalisers.values()))["history/joint_position"]
    np.testing.assert_array_equal(apart, 0)
    together = normalise_batch(batch, mixed.normaliser)["history/joint_position"][:, 0, 0]
    np.testing.assert_allclose(together, (np.array([0, 10]) - 2.5) / scale[0], rtol=1e-6)
    with pytest.raises(UsageError, match="names no domain"):
        normalise_batch(feeds["sim"].batch([0]), list(mixed.normalisers.values()))


def test_a_copy_in_another_process_gives_the_same(two):
    mixed = mix(two, "sim:0.7,real:0.3")
    mixed.batch([0])
    twin = copy.deepcopy(mixed)
    assert "gather" not in vars(twin)
    for name, values in twin.batch([5, 90]).items():
        np.testing.assert_array_equal(values, mixed.batch([5, 90])[name])


def test_names_that_do_not_meet(two):
    with pytest.raises(UnknownNameError, match="did you mean 'real'"):
        mix(two, "sim:0.7,reel:0.3")
    with pytest.raises(UsageError, match="the source real has no share"):
        mix(two, "sim:1")


def test_fingertips_of_other_names_mix_where_no_channel_of_theirs_is_read(hand, store):
    names = {"one": ("tip",), "other": ("end",)}
    stored = [store(hand("a", 30, fingertip_names=tips), name=name) for name, tips in names.items()]
    read = dict(history=3, horizon=2, stride=1)
    channels = ("object_pose", "joint_position", "action")
    feeds = dict(zip(names, (windows(one, channels=channels, **read) for one in stored), strict=True))
    assert len(mix(feeds, "one:1/2,other:1/2").sources) == 2
    feeds = dict(zip(names, (windows(one, **read) for one in stored), strict=True))
    with pytest.raises(DataError, match="differ in their fingertip names"):
        mix(feeds, "one:1/2,other:1/2")


def test_sources_of_another_kind_are_refused(hand, store, two):
    sim = two["sim"]

    def refuse(error, words, **other):
        with pytest.raises(error, match=words) as caught:
            mix({"sim": sim, "other": windows(**other)}, "sim:1/2,other:1/2")
        return str(caught.value)

    real = two["real"].dataset
    refuse(UsageError, "differ in horizon", dataset=real, history=3, horizon=4, stride=1)
    refuse(UsageError, "differ in rate_hz", dataset=real, history=3, horizon=2, stride=2)
    refuse(UsageError, "differ in method", dataset=real, history=3, horizon=2, stride=1, method="std")
    bare = store(hand("a", 30, arrays={"contact": None, "fingertip_force": None}), name="bare")
    said = refuse(DataError, "hold different channels", dataset=bare, history=3, horizon=2, stride=1)
    assert "channels=['object_pose', 'joint_position', 'action']" in said
    turned = store(hand("a", 30, joint_names=("b", "a")), name="turned")
    said = refuse(
        DataError, "differ in their joint names: another order", dataset=turned, history=3, horizon=2, stride=1
    )
    assert "sim: a, b" in said
    assert "other: b, a" in said
    wide = store(hand("a", 30, arrays={"action": np.zeros((30, 3))}), name="wide")
    refuse(DataError, "differ in the shape of action", dataset=wide, history=3, horizon=2, stride=1)


def test_channels_are_intersected_when_asked(hand, store, two):
    bare = store(hand("a", 30, arrays={"contact": None, "action": np.zeros((30, 3))}), name="bare")
    common = common_channels(two["sim"].dataset, bare)
    assert common == ("object_pose", "joint_position", "fingertip_force")
    feeds = {
        name: windows(dataset, 3, 2, stride=1, channels=common)
        for name, dataset in (("sim", two["sim"].dataset), ("bare", bare))
    }
    assert mix(feeds, "sim:1/2,bare:1/2").channels == common
    lonely = store(
        hand("a", 30, arrays=dict.fromkeys(("object_pose", "contact", "action", "fingertip_force"))), name="lonely"
    )
    other = store(
        hand("a", 30, arrays=dict.fromkeys(("joint_position", "action", "fingertip_force", "contact"))), name="other"
    )
    with pytest.raises(DataError, match="no channel in common"):
        common_channels(lonely, other)
