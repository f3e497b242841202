"""Splits: whole episodes, drawn the same way each time, stored once."""

from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import open_dataset
from candata.errors import DataError, UnknownNameError, UsageError
from candata.loaders import find_split, load_split, make_split, save_split, split_digest, split_names, windows


@pytest.fixture
def twenty(hand, store):
    return store(*(hand(f"e{i:02d}", 12, object=f"o{i % 4}") for i in range(20)))


def test_the_groups_share_nothing_and_miss_nothing(twenty):
    split = make_split(twenty)
    assert [len(split.ids(g)) for g in ("train", "val", "test")] == [16, 2, 2]
    assert sorted(split.train + split.val + split.test) == list(twenty.ids)


def test_the_same_seed_gives_the_same_split_and_another_gives_another(twenty):
    assert make_split(twenty, seed=3) == make_split(open_dataset(twenty.path), seed=3)
    assert split_digest(make_split(twenty, seed=3)) != split_digest(make_split(twenty, seed=4))


def test_objects_stay_together(twenty):
    split = make_split(twenty, {"train": 0.5, "val": 0.25, "test": 0.25}, by="object")
    objects = [{int(i[1:]) % 4 for i in split.ids(g)} for g in ("train", "val", "test")]
    assert [len(o) for o in objects] == [2, 1, 1]
    assert set.union(*objects) == {0, 1, 2, 3}


def test_the_smallest_dataset_that_can_be_split(hand, store):
    split = make_split(store(*(hand(n) for n in "abc")))
    assert [len(split.ids(g)) for g in ("train", "val", "test")] == [1, 1, 1]


def test_too_few_episodes_to_split(hand, store):
    dataset = store(hand("a"), hand("b"))
    with pytest.raises(DataError, match="too few episodes") as caught:
        make_split(dataset)
    assert "at least 3 episodes" in str(caught.value)
    assert make_split(dataset, {"train": 0.5, "test": 0.5}).val == ()


def test_a_field_that_an_episode_does_not_state(hand, store):
    with pytest.raises(DataError, match="does not state its object"):
        make_split(store(hand("a", object="o"), hand("b")), {"train": 1}, by="object")


@pytest.mark.parametrize(
    "fractions", [{"train": 0.5}, {"train": 1.5, "test": -0.5}, {"train": float("nan"), "test": 1.0}]
)
def test_shares_that_make_no_sense(twenty, fractions):
    with pytest.raises(UsageError, match="add up to 1"):
        make_split(twenty, fractions)


def test_an_unknown_group_or_field(twenty):
    with pytest.raises(UnknownNameError, match="'valid'"):
        make_split(twenty, {"train": 0.5, "valid": 0.5})
    with pytest.raises(UnknownNameError, match="'weather'"):
        make_split(twenty, by="weather")


def test_stored_by_name_once(twenty):
    split = make_split(twenty, seed=1)
    path = save_split(twenty, split, "mine")
    assert path == twenty.path / "splits" / "mine.json"
    assert save_split(twenty, split, "mine") == path
    assert load_split(twenty, "mine") == split
    assert split_names(twenty) == ("mine",)
    with pytest.raises(UsageError, match="another split is called mine"):
        save_split(twenty, make_split(twenty, seed=2), "mine")
    with pytest.raises(UnknownNameError, match="mine"):
        load_split(twenty, "yours")
    path.write_text("{")
    with pytest.raises(DataError, match=r"damaged dataset: mine\.json"):
        load_split(twenty, "mine")


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden"])
def test_a_name_is_the_name_of_a_file(twenty, name):
    with pytest.raises(UsageError, match="not a name for a split"):
        save_split(twenty, make_split(twenty), name)


def test_windows_of_a_group_are_those_of_its_episodes(twenty):
    split = make_split(twenty, seed=1)
    for group in ("train", "val", "test"):
        feed = windows(twenty, 2, 2, stride=1, split=group, splits=split)
        assert {feed.episode_ids[e] for e in feed.owner} == set(split.ids(group))
        assert feed.split == split


def test_the_default_is_the_stored_one_if_there_is_one(twenty):
    assert find_split(twenty) == make_split(twenty)
    stored = make_split(twenty, seed=9)
    save_split(twenty, stored)
    assert find_split(twenty) == stored
    assert windows(twenty, 2, 2, stride=1, split="test").split == stored


def test_an_empty_group(twenty):
    split = make_split(twenty, {"train": 0.5, "val": 0.5})
    with pytest.raises(DataError, match="group test of the split is empty") as caught:
        windows(twenty, 2, 2, stride=1, split="test", splits=split)
    assert "train 10, val 10, test 0" in str(caught.value)


def test_a_split_of_another_version(twenty, hand, store):
    grown = store(*(hand(f"x{i}", 12) for i in range(20)))
    later = make_split(grown, seed=1)
    with pytest.raises(DataError, match="another dataset or version") as caught:
        windows(twenty, 2, 2, stride=1, split="train", splits=later)
    assert later.digest[:12] in str(caught.value)
    # The other way round every episode is there.
    assert len(windows(grown, 2, 2, stride=1, split="val", splits=make_split(twenty))) == 2 * 10


def test_the_normaliser_knows_only_the_training_episodes(hand, store):
    dataset = store(*(hand(f"e{i}", 12, offset=1000.0 * i) for i in range(10)))
    split = make_split(dataset)
    value = windows(dataset, 2, 2, stride=1, split="val", splits=split).normaliser
    assert value == windows(dataset, 2, 2, stride=1, split="train", splits=split).normaliser
    rows = np.concatenate([dataset.episode(i)["joint_position"] for i in split.train])
    np.testing.assert_allclose(value.channel("joint_position")[0], np.median(rows, 0), rtol=1e-6)  # float32
    assert value.episodes == 8
    assert value.rows == 96
