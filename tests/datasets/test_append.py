from __future__ import annotations

import pytest

from candata.datasets import (
    append,
    content_hash,
    create_dataset,
    open_dataset,
    pending_parts,
    publish,
    write_part,
)
from candata.datasets.versions import advance, digest_of, members_of
from candata.errors import DataError, UnknownNameError, UsageError
from candata.schema.manifest import Lineage

LINEAGE = Lineage(operation="test")


def test_what_is_appended_is_read_back_in_the_order_of_the_ids(tmp_path, episode):
    written = [episode(f"e{i}", seed=i, contact=i % 3 > 0) for i in (4, 2, 0, 1, 3)]
    append(create_dataset(tmp_path / "ds"), iter(written), LINEAGE, part_size=2)
    dataset = open_dataset(tmp_path / "ds")
    assert dataset.ids == ("e0", "e1", "e2", "e3", "e4")
    assert [e.meta.id for e in dataset.episodes()] == list(dataset.ids)
    assert {e.meta.id: content_hash(e) for e in dataset} == {e.meta.id: content_hash(e) for e in written}
    assert [e.meta for e in dataset.episodes(["e3", "e0"])] == [written[4].meta, written[2].meta]


def test_the_digest_does_not_depend_on_parts_or_order(tmp_path, episode):
    episodes = [episode(f"e{i}", seed=i) for i in range(5)]
    one = append(create_dataset(tmp_path / "a"), episodes, LINEAGE)
    two = append(create_dataset(tmp_path / "b"), episodes[::-1], Lineage(operation="other"), part_size=1)
    assert one.digest == two.digest
    assert len(one.parts) == 1
    assert len(two.parts) == 5


def test_appending_the_same_twice_adds_nothing(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    first = append(root, [episode("a"), episode("b", seed=1)], LINEAGE)
    assert append(root, [episode("b", seed=1), episode("a")], LINEAGE) == first
    assert append(root, [], LINEAGE) == first
    assert len(list((root / "parts").iterdir())) == 1


def test_one_new_among_old_makes_a_version_with_the_parents_parts(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    first = append(root, [episode("a")], LINEAGE)
    second = append(root, [episode("a"), episode("c", seed=2)], Lineage(operation="more"))
    assert (second.number, second.parent) == (2, first.digest)
    assert second.parts[:1] == first.parts
    assert [step.operation for step in second.lineage] == ["test", "more"]
    assert open_dataset(root, 1).ids == ("a",)
    assert open_dataset(root, second.digest[:8]).ids == ("a", "c")


@pytest.mark.parametrize("change", [{"seed": 9}, {"source": "real"}], ids=["values", "meta"])
def test_the_same_id_with_another_content_is_refused(tmp_path, episode, change):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("a")], LINEAGE)
    with pytest.raises(DataError, match="episode a"):
        append(root, [episode("b"), episode("a", **change)], LINEAGE)
    assert open_dataset(root).ids == ("a",)


def test_the_same_id_twice_in_one_append(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("a"), episode("a")], LINEAGE)
    assert open_dataset(root).ids == ("a",)
    with pytest.raises(DataError, match="another content"):
        append(root, [episode("b"), episode("b", seed=1)], LINEAGE)


def test_a_source_that_fails_half_way_publishes_nothing_and_leaves_no_staging(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")

    def broken():
        yield from (episode(f"e{i}", seed=i) for i in range(3))
        raise ValueError("source")

    with pytest.raises(ValueError, match="source"):
        append(root, broken(), LINEAGE, part_size=2)
    assert list((root / "staging").iterdir()) == []
    assert not (root / "versions").exists()
    (pending,) = pending_parts(root)
    assert [name for name, _ in pending.episodes] == ["e0", "e1"]
    assert publish(root, [pending.id], LINEAGE).number == 1
    assert pending_parts(root) == ()


def test_a_part_written_again_is_the_part_that_stands(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    first = write_part(root, [episode("a")], {"operation": "x"})
    assert write_part(root, [episode("a")], {"operation": "x"}) == first


def test_two_parts_with_the_same_episode_count_it_once(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    parts = [
        write_part(root, [episode("a"), episode("b", seed=1)], {}).id,
        write_part(root, [episode("b", seed=1), episode("c", seed=2)], {}).id,
    ]
    publish(root, parts, LINEAGE)
    dataset = open_dataset(root)
    assert [e.meta.id for e in dataset] == ["a", "b", "c"]
    assert dataset.catalog()["id"].to_pylist() == ["a", "b", "c"]


def test_more_episodes_than_a_row_group(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    written = [episode(f"e{i:02d}", seed=i, rows=3 + i) for i in range(19)]
    append(root, written, LINEAGE, part_size=32)
    assert [len(e) for e in open_dataset(root)] == [3 + i for i in range(19)]


def test_the_catalog_says_who_what_when(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("a", seed=1, object="cup"), episode("b", rows=7)], LINEAGE)
    for _ in range(2):  # built, then read from its file
        rows = open_dataset(root).catalog().to_pylist()
        assert [(r["id"], r["object"], r["rows"], r["joint_names"]) for r in rows] == [
            ("a", "cup", 20, ["a", "b"]),
            ("b", None, 7, ["a", "b"]),
        ]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda root, make: write_part(root, [], {}), "no episodes"),
        (lambda root, make: write_part(root, [make("a"), make("a")], {}), "twice"),
        (lambda root, make: write_part(root, [make("a"), make("b", contact=False)], {}), "differ"),
        (lambda root, make: append(root, [], LINEAGE), "nothing to publish"),
        (lambda root, make: append(root, [], LINEAGE, part_size=0), "part_size"),
        (lambda root, make: publish(root, ["f" * 32], LINEAGE), "part.json"),
        (lambda root, make: publish(root.parent, [], LINEAGE), "not a dataset"),
        (lambda root, make: open_dataset(root), "empty dataset"),
        (lambda root, make: open_dataset(root / "none"), "not a dataset"),
    ],
)
def test_wrong_use_is_one_clear_error(tmp_path, episode, call, words):
    root = create_dataset(tmp_path / "ds")
    with pytest.raises((DataError, UsageError), match=words):
        call(root, episode)
    assert not (root / "parts").exists() or list((root / "parts").iterdir()) == []


@pytest.mark.parametrize("version", [2, "abc", "0" * 8])
def test_an_unknown_version_is_named(tmp_path, episode, version):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("a")], LINEAGE)
    with pytest.raises(UsageError, match=f"no version {version}"):
        open_dataset(root, version)


def test_an_unknown_episode_names_the_nearest(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("toss-12")], LINEAGE)
    with pytest.raises(UnknownNameError, match="did you mean 'toss-12'"):
        open_dataset(root).episode("toss-21")


def without(root, *ids):
    """Publish the newest version without some episodes, as a filter does."""

    def change(base):
        kept = {k: v for k, v in members_of(root, base).items() if k not in ids}
        fields = {"number": base.number + 1, "parent": base.digest, "exclusions": ids, "digest": digest_of(kept)}
        return base.model_copy(update=fields)

    return advance(root, change)


def test_what_a_version_leaves_out_stays_out_of_the_next(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    first = append(root, [episode("a"), episode("b", seed=1)], LINEAGE)
    second = without(root, "b")
    third = append(root, [episode("b", seed=1), episode("c", seed=2)], LINEAGE)
    assert open_dataset(root, 2).ids == ("a",)
    assert open_dataset(root).ids == ("a", "c")
    assert open_dataset(root).catalog()["id"].to_pylist() == ["a", "c"]
    assert len({first.digest, second.digest, third.digest}) == 3
    alone = append(create_dataset(tmp_path / "alone"), [episode("a"), episode("c", seed=2)], LINEAGE)
    assert third.digest == alone.digest


def test_a_change_is_asked_again_when_another_came_first(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode("a"), episode("b", seed=1)], LINEAGE)
    asked = []

    def change(base):
        asked.append(base.number)
        if len(asked) == 1:
            append(root, [episode("c", seed=2)], LINEAGE)
        return base.model_copy(update={"number": base.number + 1, "parent": base.digest})

    assert advance(root, change).number == 3
    assert asked == [1, 2]
    assert open_dataset(root).ids == ("a", "b", "c")
