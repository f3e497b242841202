"""Splits of datasets that are made of others: who was where stays where it was, or a line says why not."""

from __future__ import annotations

import pytest

from candata.datasets import open_dataset
from candata.datasets.filtering import filter_dataset
from candata.datasets.merging import merge
from candata.datasets.relabelling import relabel
from candata.errors import DataError
from candata.loaders import carry_splits, load_split, make_split, save_split, split_names
from candata.loaders.splits import GROUPS


@pytest.fixture
def ten(hand, store):
    """Ten episodes of two objects, split in two ways."""
    data = store(*(hand(f"e{i}", 12, offset=i, object=f"o{i // 5}") for i in range(10)), name="ten")
    save_split(data, make_split(data, seed=3), "mine")
    save_split(data, make_split(data, {"train": 0.5, "test": 0.5}, by="object"), "apart")
    return data


@pytest.fixture
def more(hand, store):
    """Five others, which store a split of the same name."""
    data = store(*(hand(f"m{i}", 12, offset=20 + i, source="real", object="o2") for i in range(5)), name="more")
    save_split(data, make_split(data, seed=3), "mine")
    return data


def test_a_filter_keeps_who_is_left_where_it_was_and_tells_what_is_empty(ten, tmp_path):
    pytest.importorskip("duckdb")
    notes, old = [], load_split(ten, "mine")
    gone = old.val[0]
    filter_dataset(
        ten, f"id <> '{gone}' and id <> '{old.train[0]}'", tmp_path / "some", carry_splits([ten], notes.append)
    )
    new = load_split(open_dataset(tmp_path / "some"), "mine")
    assert new == old.model_copy(update={"val": (), "train": old.train[1:]})
    assert notes[1] == "the split mine is carried: train 7, val 0, test 1; empty now: val"
    assert split_names(open_dataset(tmp_path / "some")) == ("apart", "mine")


def test_a_split_of_none_that_is_left_is_not_carried(ten, hand, store, tmp_path):
    pytest.importorskip("duckdb")
    data, notes = store(hand("late", 12, offset=50), name="ten"), []
    filter_dataset(data, "id = 'late'", tmp_path / "late", carry_splits([data], notes.append))
    assert split_names(open_dataset(tmp_path / "late")) == ()
    assert "mine is not carried: 1 of 1 episodes are in none of its groups, such as late" in notes[1]


@pytest.mark.parametrize("prefix", [False, True])
def test_merged_splits_of_one_name_are_one(ten, more, prefix, tmp_path):
    notes = []
    merge([ten, more], tmp_path / "both", prefix, carry_splits([ten, more], notes.append, prefix))
    both = open_dataset(tmp_path / "both")
    new = load_split(both, "mine")
    for group in GROUPS:
        parents = [(data, load_split(data, "mine").ids(group)) for data in (ten, more)]
        assert new.ids(group) == tuple(sorted(f"{data.name}-" * prefix + i for data, ids in parents for i in ids))
    assert (new.dataset, new.seed, sum(map(len, map(new.ids, GROUPS)))) == ("ten+more", 3, 15)
    assert split_names(both) == ("mine",)
    assert "apart is not carried: more has none of that name" in notes[0]
    assert notes[1] == "the split mine is carried: train 11, val 2, test 2"


def test_equal_episodes_in_other_groups_contradict(ten, hand, store, tmp_path):
    notes, old = [], load_split(ten, "mine")
    again = store(*(hand(f"e{i}", 12, offset=i, object=f"o{i // 5}") for i in range(10)), name="again")
    save_split(again, old.model_copy(update={"test": old.train[:1], "train": (*old.train[1:], *old.test)}), "mine")
    merge([ten, again], tmp_path / "both", finish=carry_splits([ten, again], notes.append))
    assert split_names(open_dataset(tmp_path / "both")) == ()
    assert "the split mine is not carried: e" in notes[1]
    assert " of one and in " in notes[1]


def test_an_episode_in_no_split_keeps_a_merged_one_from_being_made(ten, more, hand, store, tmp_path):
    more, notes = store(hand("late", 12, offset=50), name="more"), []
    merge([ten, more], tmp_path / "both", finish=carry_splits([ten, more], notes.append))
    assert split_names(open_dataset(tmp_path / "both")) == ()
    assert "1 of 16 episodes are in none of its groups, such as late" in notes[1]


def test_what_was_kept_together_stays_together_or_the_split_goes(ten, hand, store, tmp_path):
    other = store(hand("x", 12, offset=60, object="o0"), hand("y", 12, offset=61, object="o1"), name="other")
    old, notes = load_split(ten, "apart"), []
    there = {"o0": "train" if "e0" in old.train else "test"}
    there["o1"] = "test" if there["o0"] == "train" else "train"
    ids = {"o0": "x", "o1": "y"}
    turned = {there["o0"]: (ids["o1"],), there["o1"]: (ids["o0"],)}
    save_split(other, old.model_copy(update=turned), "apart")
    merge([ten, other], tmp_path / "both", finish=carry_splits([ten, other], notes.append))
    assert split_names(open_dataset(tmp_path / "both")) == ()
    assert "the split apart is not carried: object o" in notes[0]
    assert "two of its groups" in notes[0]


def test_other_labels_leave_a_split_unless_they_tear_it(ten, tmp_path):
    notes = []
    relabel(ten, {"task": "push"}, None, tmp_path / "named", carry_splits([ten], notes.append))
    named = open_dataset(tmp_path / "named")
    assert [load_split(named, name) for name in ("apart", "mine")] == [load_split(ten, n) for n in ("apart", "mine")]
    relabel(ten, {"object": "same"}, None, tmp_path / "same", carry_splits([ten], notes.append))
    assert split_names(open_dataset(tmp_path / "same")) == ("mine",)


def test_a_damaged_split_leaves_nothing(ten, tmp_path):
    pytest.importorskip("duckdb")
    (ten.path / "splits/mine.json").write_text("{")
    with pytest.raises(DataError, match="mine"):
        filter_dataset(ten, "true", tmp_path / "some", carry_splits([ten], print))
    assert not (tmp_path / "some").exists()
