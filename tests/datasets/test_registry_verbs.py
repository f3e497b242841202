"""Filter, merge, relabel, diff, tags, and the tree that they leave."""

from __future__ import annotations

import os

import numpy as np
import pytest

from candata.checks import check
from candata.datasets import content_hash, history, open_dataset, put_cloud
from candata.datasets.cutting import cut
from candata.datasets.diff import diff
from candata.datasets.filtering import COLUMNS, filter_dataset, matching_ids
from candata.datasets.merging import merge, merge_into
from candata.datasets.relabelling import relabel
from candata.datasets.tagging import delete_tag, set_tag
from candata.datasets.tags import read_tags
from candata.errors import DataError, UnknownNameError, UsageError
from tests.conftest import WHOLE

from .conftest import add

pytest.importorskip("duckdb")


@pytest.fixture
def mixed(dataset, episode):
    """Episodes a to d are cups, e is a can of a real recording that knows its outcome."""
    root = dataset("mixed", object="cup")
    add(root, [episode("e", seed=5, object="can", source="real", outcome="dropped", rows=40)])
    return open_dataset(root)


@pytest.mark.parametrize(
    ("where", "ids"),
    [
        ("object = 'can'", "e"),
        ("rows > 20 or id = 'a'", "ae"),
        ("outcome is not null", "e"),
        ("source = 'sim' and id in ('b', 'e')", "b"),
        ("OBJECT like 'c%' and Rate_Hz = 80", "abcde"),
        ("false", ""),
        ("list_contains(joint_names, 'a') -- a comment", "abcde"),
        ("object = 'it''s'", ""),
    ],
)
def test_an_expression_chooses_episodes(mixed, where, ids):
    assert matching_ids(mixed, where) == tuple(ids)


def test_every_column_may_be_named(mixed):
    assert matching_ids(mixed, " or ".join(f"{name} is not null" for name in COLUMNS)) == mixed.ids


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("objct = 'cup'", "did you mean 'object'"),
        ("object = cup", "single quotes: 'cup'"),
        ("rows >", "syntax error"),
        ("", "no expression"),
        ("true; drop table x", "no expression"),
        ("true) union select 'x' where (true", "no expression"),
        ("true order by rows", "no expression"),
        ("count(*) > 1", "count_star has no place"),
        ("object", "could not convert"),
        ("rows > (select count(*) from read_text('/etc/hostname'))", "(subquery|star|count_star) has no place"),
        ("rows > (select count(*) from '/etc/hostname')", "(subquery|star|count_star) has no place"),
        ("'", "unterminated"),
        ("no_such(rows)", "no_such"),
        ("meta = ''", "unknown column 'meta'"),
        ("\x00", "null|unknown|no expression"),
        ("rows > ?", "parameter has no place"),
        ("exists(from query('select 1'))", "has no place"),
        ("json_serialize_sql('select 1') is not null", "json_serialize_sql has no place"),
        ("sum(rows) over () > 1", "has no place"),
        ("list_filter([1], x -> x > 0) is not null", "has no place"),
        ("length(rpad('a', 20000000, 'b')) > 0", "rpad has no place"),
        ("rows > 1; select 1", "no expression"),
        ("rows > 1 limit 1", "no expression"),
        ("other.rows > 1", "unknown column 'other.rows'"),
        ("case when true then " * 400 + "true" + " end" * 400, "too deep"),
        ("object = '\udcff'", "no expression"),  # bytes of a command line that are no text
        ("true or " * 5_000 + "rows > 1", "too long"),
        ("(" * 3_000, "too deep.*\n.*open brackets"),
    ],
)
def test_what_is_no_expression_is_one_clear_error(mixed, where, words):
    with pytest.raises(UsageError, match=f"(?i){words}") as told:
        matching_ids(mixed, where)
    assert any(text in str(told.value) for text in ("rows", "at most", "columns compared"))


@pytest.mark.parametrize(
    "where",
    [
        "random() < 0.5",
        '"Random"() < 0.5',
        "id = 'ä' or random() < 0.5",
        "uuid()::varchar > id",
        "now() > timestamp '2026-01-01'",
        "current_date > date '2026-01-01'",
        "CURRENT_TIMESTAMP is not null",
        "localtime is not null",
        "age(timestamp '2026-01-01') > interval 1 day",
        "current_setting('threads') = '1'",
        "rows > (select x from range(300) t(x) using sample 1)",
    ],
)
def test_a_filter_that_would_choose_others_another_time_is_refused(mixed, where):
    with pytest.raises(UsageError, match=r"has no place in a filter\n.*the same episodes|unknown column"):
        matching_ids(mixed, where)


def test_words_of_text_and_functions_of_columns_alone_are_no_chance(mixed):
    where = "object <> 'random()' and lower(object) <> $$now()$$ and upper(object) <> 'today()'"
    assert matching_ids(mixed, where + " -- random()") == mixed.ids


def test_a_filtered_dataset_shares_the_parts_and_is_a_whole_dataset(mixed, tmp_path):
    version = filter_dataset(mixed, "id in ('a', 'e')", tmp_path / "out")
    kept = open_dataset(tmp_path / "out")
    assert kept.ids == ("a", "e")
    assert version.exclusions == ("b",)
    assert len(version.parts) == 2
    assert {e.meta.id: content_hash(e) for e in kept} == {i: content_hash(mixed.episode(i)) for i in "ae"}
    for path in (tmp_path / "out/parts").rglob("*.parquet"):
        assert os.path.samefile(path, mixed.path / path.relative_to(tmp_path / "out"))
    assert check(kept, rules=WHOLE, deep=True) == ()
    assert kept.catalog()["id"].to_pylist() == ["a", "e"]


def test_where_there_are_no_links_the_parts_are_copied(mixed, tmp_path, monkeypatch):
    link = os.link

    def only_json(source, target, **rest):
        if not str(source).endswith(".json") or "part" in str(source):
            raise OSError("no links here")
        link(source, target, **rest)

    monkeypatch.setattr(os, "link", only_json)
    filter_dataset(mixed, "id = 'a'", tmp_path / "out")
    (path,) = (tmp_path / "out/parts").glob("*/steps.parquet")
    assert path.stat().st_nlink == 1
    assert check(open_dataset(tmp_path / "out"), rules=WHOLE, deep=True) == ()


def test_the_filtered_outlives_its_parent(mixed, tmp_path):
    import shutil

    filter_dataset(mixed, "object = 'can'", tmp_path / "out")
    shutil.rmtree(mixed.path)
    assert [e.meta.object for e in open_dataset(tmp_path / "out")] == ["can"]


def test_nothing_left_and_an_output_that_stands_are_refused(mixed, tmp_path):
    with pytest.raises(DataError, match="no episode is left"):
        filter_dataset(mixed, "rows > 1000", tmp_path / "out")
    with pytest.raises(UsageError, match="exists already"):
        filter_dataset(mixed, "true", mixed.path)
    assert {p.name for p in tmp_path.iterdir()} == {"mixed"}


def test_a_filter_of_a_damaged_part_leaves_nothing(mixed, tmp_path):
    mixed.catalog()
    next(mixed.path.glob("parts/*/steps.parquet")).write_bytes(b"short")
    with pytest.raises(DataError, match=r"steps\.parquet"):
        filter_dataset(mixed, "true", tmp_path / "out")
    assert {p.name for p in tmp_path.iterdir()} == {"mixed"}


def test_merging_counts_equal_episodes_once(dataset, tmp_path):
    one, two = open_dataset(dataset("one", "abc")), open_dataset(dataset("two", "cd"))
    merge([one, two], tmp_path / "out")
    joined = open_dataset(tmp_path / "out")
    assert joined.ids == ("a", "b", "c", "d")
    assert diff(one, joined).removed == diff(one, joined).changed == ()
    assert check(joined, rules=WHOLE, deep=True) == ()
    assert [e.meta.id for e in joined] == list("abcd")


def test_one_id_for_two_contents_is_refused_and_prefixed_on_request(dataset, tmp_path, episode):
    one, two = open_dataset(dataset("one", "ab")), dataset("two", "b")
    add(two, [episode("a", seed=99)])
    two = open_dataset(two)
    with pytest.raises(DataError, match=r"1 ids: a(.|\n)*--prefix"):
        merge([one, two], tmp_path / "out")
    assert not (tmp_path / "out").exists()
    merge([one, two], tmp_path / "out", prefix=True)
    joined = open_dataset(tmp_path / "out")
    assert joined.ids == ("one-a", "one-b", "two-a", "two-b")
    np.testing.assert_array_equal(joined.episode("two-a")["object_pose"], two.episode("a")["object_pose"])


def test_what_one_leaves_out_stays_out_unless_the_other_has_it(dataset, episode, tmp_path):
    whole = open_dataset(dataset("whole", "abcd", part_size=4))
    filter_dataset(whole, "id <> 'b' and id <> 'c'", tmp_path / "some")
    other = dataset("other", "b")
    add(other, [episode("c", seed=77)])  # another content than the one that was left out
    merge([open_dataset(tmp_path / "some"), open_dataset(other)], tmp_path / "out")
    joined = open_dataset(tmp_path / "out")
    assert joined.ids == ("a", "b", "c", "d")
    assert content_hash(joined.episode("c")) == content_hash(episode("c", seed=77))
    assert content_hash(joined.episode("b")) == content_hash(whole.episode("b"))
    merge([open_dataset(tmp_path / "some"), open_dataset(dataset("last", "x"))], tmp_path / "again")
    assert open_dataset(tmp_path / "again").ids == ("a", "d", "x")


def test_merging_into_a_dataset_makes_its_next_version(dataset, tmp_path):
    root, more = dataset("root", "ab"), open_dataset(dataset("more", "bcd", part_size=3))
    filter_dataset(more, "id <> 'd'", tmp_path / "less")
    version = merge_into([open_dataset(tmp_path / "less")], root)
    assert (version.number, open_dataset(root).ids) == (2, ("a", "b", "c"))
    assert merge_into([open_dataset(tmp_path / "less")], root).number == 2
    assert [step.operation for step in version.lineage] == ["test", "merge"]


def test_merging_brings_back_what_was_left_out(dataset, episode, tmp_path):
    whole = open_dataset(dataset("whole", "abc", part_size=3))
    filter_dataset(whole, "id = 'a'", tmp_path / "some")
    version = merge_into([whole], tmp_path / "some")
    assert (version.number, version.exclusions) == (2, ())
    assert open_dataset(tmp_path / "some").digest == whole.digest
    filter_dataset(whole, "id = 'a'", tmp_path / "other")
    changed = dataset("changed", "x")
    add(changed, [episode("b", seed=77)])
    with pytest.raises(DataError, match="1 ids: b"):
        merge_into([open_dataset(changed)], tmp_path / "other")


def test_point_clouds_come_along(dataset, episode, tmp_path):
    root = dataset("ds")
    add(root, [episode("t", seed=1, point_cloud=put_cloud(root, np.eye(3)))])
    data = open_dataset(root)
    filter_dataset(data, "id = 't'", tmp_path / "one")
    merge([data, open_dataset(tmp_path / "one")], tmp_path / "two")
    relabel(data, {"task": "x"}, None, tmp_path / "three")
    for name in ("one", "two", "three"):
        assert check(open_dataset(tmp_path / name), rules=WHOLE, deep=True) == ()
        assert len(list((tmp_path / name / "objects").iterdir())) == 1


def test_relabelling_changes_words_alone(mixed, tmp_path):
    version = relabel(mixed, {"task": "pick", "object": None}, "object = 'can'", tmp_path / "out")
    named = open_dataset(tmp_path / "out")
    found = diff(mixed, named)
    assert (found.added, found.removed, found.changed, found.same) == ((), (), ("e",), 4)
    was, now = mixed.episode("e"), named.episode("e")
    assert (now.meta.task, now.meta.object, now.meta.outcome) == ("pick", None, "dropped")
    assert all(np.array_equal(was[name], now[name]) for name in was.arrays)
    assert version.lineage[-1].details["set"] == {"task": "pick", "object": None}
    with pytest.raises(UnknownNameError, match="label"):
        relabel(mixed, {"seed": "3"}, None, tmp_path / "x")
    with pytest.raises(DataError, match="no episode"):
        relabel(mixed, {"task": "x"}, "rows > 999", tmp_path / "x")


def test_relabelling_what_leaves_some_out(mixed, tmp_path):
    filter_dataset(mixed, "id <> 'a' and id <> 'd'", tmp_path / "some")
    relabel(open_dataset(tmp_path / "some"), {"task": "x"}, "id = 'b'", tmp_path / "out")
    assert [(e.meta.id, e.meta.task) for e in open_dataset(tmp_path / "out")] == [("b", "x"), ("c", None), ("e", None)]


def test_long_episodes_are_cut_into_motions_of_their_own(mixed, tmp_path):
    long = mixed.episode("e")
    length_s = 15 / long.meta.rate_hz
    version = cut(mixed, length_s, tmp_path / "out")
    pieces = list(open_dataset(tmp_path / "out").episodes(["e-0", "e-1"]))
    assert [len(p) for p in pieces] == [15, 15]  # 10 of 40 rows are too few for a piece
    assert [p.meta.task for p in pieces] == ["-0", "-1"]
    assert all(p["time_ns"][0] == 0 for p in pieces)
    for name in set(long.arrays) - {"time_ns"}:
        np.testing.assert_array_equal(np.concatenate([p[name] for p in pieces]), long[name][:30])
    assert version.lineage[-1].details == {"length_s": length_s}
    with pytest.raises(DataError, match="shorter than a piece"):
        cut(mixed, 60.0, tmp_path / "x")
    with pytest.raises(UsageError, match="no length"):
        cut(mixed, 0.0, tmp_path / "x")


def test_diff_of_versions_and_of_datasets(mixed):
    first = open_dataset(mixed.path, 1)
    assert diff(first, mixed).added == ("e",)
    assert diff(mixed, first).removed == ("e",)
    assert diff(mixed, mixed).is_equal
    assert not diff(first, mixed).is_equal


def test_the_lineage_is_a_tree_that_outlives_the_parents(mixed, dataset, tmp_path):
    import shutil

    other = open_dataset(dataset("other", "xy"))
    filter_dataset(mixed, "object = 'cup'", tmp_path / "cups")
    cups = open_dataset(tmp_path / "cups")
    merge([cups, other, mixed], tmp_path / "all")
    relabel(open_dataset(tmp_path / "all"), {"task": "t"}, None, tmp_path / "end")
    for name in ("mixed", "cups", "other", "all"):
        shutil.rmtree(tmp_path / name)
    data = open_dataset(tmp_path / "end")
    text = list(history.lines(history.tree(data)))
    assert [line.split(";")[0] for line in text] == [
        f"end@{data.digest[:12]}",
        "└─ relabel",
        f"   └─ from all@{data.lineage[0].parents[0][4:16]}",
        "      └─ merge",
        f"         ├─ from cups@{cups.digest[:12]}",
        "         │  └─ filter",
        f"         │     └─ from mixed@{mixed.digest[:12]}",
        "         │        └─ test",
        f"         ├─ from other@{other.digest[:12]}",
        "         │  └─ test",
        f"         └─ from mixed@{mixed.digest[:12]}  (told elsewhere in this tree, or not recorded)",
    ]
    assert "where object = 'cup'" in text[5]
    assert "scene table; seeds 7" in text[7]
    tree = history.as_json(history.tree(data))
    assert tree["steps"][0]["parents"][0]["steps"][0]["operation"] == "merge"


def test_a_tree_does_not_double_with_every_merge(dataset, tmp_path):
    data = open_dataset(dataset("ds"))
    sizes = []
    for number in range(6):
        filter_dataset(data, "true", tmp_path / f"f{number}")
        merge([data, open_dataset(tmp_path / f"f{number}")], tmp_path / f"m{number}")
        data = open_dataset(tmp_path / f"m{number}")
        sizes.append((data.path / "versions/000001.json").stat().st_size)
    steps = np.diff(sizes)
    assert steps.max() < 2 * steps.min()  # a constant addition each; doubling would give a ratio of 16
    assert any("told elsewhere" in line for line in history.lines(history.tree(data)))


def test_tags_are_given_moved_and_taken_away(mixed):
    root = mixed.path
    assert set_tag(root, "clean", 1).version == 1
    assert set_tag(root, "clean", 1).version == 1
    with pytest.raises(UsageError, match="--move"):
        set_tag(root, "clean")
    assert set_tag(root, "clean", move=True).version == 2
    assert open_dataset(root, "clean").digest == mixed.digest
    with pytest.raises(UnknownNameError, match="did you mean 'clean'"):
        delete_tag(root, "claen")
    delete_tag(root, "clean")
    assert read_tags(root) == {}


@pytest.mark.parametrize("name", ["3", "000001", "deadbeef", "../x", "a/b", "", "con"])
def test_a_tag_that_reads_as_something_else_is_refused(mixed, name):
    with pytest.raises(UsageError, match="tag"):
        set_tag(mixed.path, name)
    assert not (mixed.path / "tags").exists()
