"""Compaction keeps the content, whoever appends, compacts or is killed meanwhile."""

from __future__ import annotations

import math
import shutil

import pytest

from candata.checks import check
from candata.datasets import append, compact_dataset, content_hash, create_dataset, open_dataset, publish, write_part
from candata.datasets import compact as compacting
from candata.datasets.versions import advance, digest_of, index_of
from candata.errors import DataError, UsageError
from candata.schema.manifest import Lineage
from tests.conftest import WHOLE, make_episode

LINEAGE = Lineage(operation="test")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Ten single-episode parts, every third episode without contact."""
    root = create_dataset(tmp_path_factory.mktemp("made") / "ds")
    append(root, [make_episode(f"e{i}", seed=i, contact=i % 3 > 0) for i in range(10)], LINEAGE, part_size=1)
    return root


@pytest.fixture
def root(made, tmp_path):
    """A copy of it, which the test may change: copying does not wait for the disk."""
    return shutil.copytree(made, tmp_path / "ds")


def exclude(root, *ids):
    def change(base):
        kept = {k: v for k, v in index_of(root, base.parts).items() if k not in ids}
        fields = {"number": base.number + 1, "parent": base.digest, "exclusions": ids, "digest": digest_of(kept)}
        return base.model_copy(update=fields)

    return advance(root, change)


def contents(dataset):
    return {e.meta.id: content_hash(e) for e in dataset}


def test_the_same_episodes_lie_in_few_parts(root):
    before = open_dataset(root)
    done = compact_dataset(root)
    after = open_dataset(root)
    assert (done.before, done.after, done.left_out) == (10, 2, 0)
    assert (after.version, after.digest) == (2, before.digest)
    assert after.file.parent == before.digest
    assert contents(after) == contents(before)
    assert [part.episodes for part in after.file.parts] == [4, 6]
    assert check(after, rules=WHOLE, deep=True) == ()
    assert contents(open_dataset(root, 1)) == contents(after)
    step = after.lineage[-1]
    assert (step.operation, step.parents) == ("compact", (f"ds@{before.digest}",))


def test_the_catalog_follows_the_parts(root):
    before = open_dataset(root).catalog()
    compact_dataset(root)
    after = open_dataset(root).catalog()
    assert after.drop_columns(["part", "row_group"]) == before.drop_columns(["part", "row_group"])
    standing = {entry.id for entry in open_dataset(root).file.parts}
    assert set(after["part"].to_pylist()) == standing
    assert set(open_dataset(root, 1).catalog(["part"])["part"].to_pylist()).isdisjoint(standing)


def test_no_part_is_larger_than_the_limit(root, episode):
    append(root, [episode(f"f{i}", seed=i) for i in range(9)], LINEAGE, part_size=16)
    compact_dataset(root, limit=4)
    parts = open_dataset(root).file.parts
    assert sorted(part.episodes for part in parts) == [3, 4, 4, 4, 4]
    assert len(parts) == math.ceil(4 / 4) + math.ceil(15 / 4)


def test_again_there_is_nothing_to_do_and_full_parts_stay(root, episode):
    compact_dataset(root, limit=3)
    first = open_dataset(root)
    again = compact_dataset(root, limit=3)
    assert (again.version, again.before, again.after) == (first.file, 5 - 1, 5 - 1)
    append(root, [episode("later", seed=77)], LINEAGE)
    compact_dataset(root, limit=3)
    full = {entry.id for entry in first.file.parts if entry.episodes == 3}
    assert full <= {entry.id for entry in open_dataset(root).file.parts}
    assert len(full) == 3


def test_what_is_excluded_is_left_out_for_good(root, episode):
    wanted = exclude(root, "e1", "e3")
    done = compact_dataset(root)
    dataset = open_dataset(root)
    assert (dataset.digest, done.left_out) == (wanted.digest, 2)
    assert dataset.file.exclusions == ()
    held = {name for part in dataset.raw_parts() for name, _ in part.manifest().episodes}
    assert held == set(dataset.ids) == {f"e{i}" for i in range(10)} - {"e1", "e3"}
    append(root, [episode("e1", seed=99)], LINEAGE)  # the name is free again
    assert "e1" in open_dataset(root).ids


def test_all_excluded_leaves_an_empty_version(root):
    exclude(root, *(f"e{i}" for i in range(10)))
    assert compact_dataset(root).version.parts == ()
    assert len(open_dataset(root)) == 0
    assert len(open_dataset(root).catalog()) == 0


def test_an_episode_in_two_parts_is_kept_once(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    a, b, c = (episode(name, seed=i) for i, name in enumerate("abc"))
    publish(root, [write_part(root, pair, {}).id for pair in ([a, b], [b, c])], LINEAGE)
    done = compact_dataset(root)
    assert [part.episodes for part in done.version.parts] == [3]
    assert done.left_out == 1


@pytest.mark.parametrize("other", ["append", "compact", "exclude", "readmit"])
def test_what_others_do_meanwhile_stays(root, episode, monkeypatch, other):
    if other == "readmit":
        exclude(root, "e5")
    written, acted = compacting._write, []

    def slow(data, plan, progress):
        entries = written(data, plan, progress)
        if not acted:
            acted.append(True)
            if other == "append":
                append(root, [episode("new", seed=50)], LINEAGE)
            elif other == "compact":
                compact_dataset(root, limit=2)
            else:
                exclude(root, *(["e2"] if other == "exclude" else []))
        return entries

    monkeypatch.setattr(compacting, "_write", slow)
    compact_dataset(root)
    dataset = open_dataset(root)
    everything = {f"e{i}" for i in range(10)}
    wanted = {"append": everything | {"new"}, "exclude": everything - {"e2"}}.get(other, everything)
    assert set(dataset.ids) == wanted
    assert dataset.digest == digest_of(contents(dataset))
    listed = [name for part in dataset.raw_parts() for name, _ in part.manifest().episodes]
    assert sorted(n for n in listed if n not in dataset.file.exclusions) == sorted(wanted)
    assert len(dataset.file.parts) == (3 if other == "append" else 2)


@pytest.mark.parametrize("stop", ["first part", "published"])
def test_killed_it_has_changed_nothing_and_goes_on(root, monkeypatch, stop):
    before, real = open_dataset(root), compacting.write_part
    calls = []

    def write(*arguments):
        calls.append(arguments)
        if stop == "first part" and len(calls) == 2:
            raise KeyboardInterrupt
        return real(*arguments)

    def no_version(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(compacting, "write_part", write)
        if stop == "published":
            patch.setattr(compacting, "advance", no_version)
        with pytest.raises(KeyboardInterrupt):
            compact_dataset(root)
    assert open_dataset(root).file == before.file
    monkeypatch.setattr(compacting, "write_part", write)
    done, first = len(calls), 1 if stop == "first part" else 2
    compact_dataset(root)
    assert len(calls) - done == 2 - first  # what was finished is not written again
    assert contents(open_dataset(root)) == contents(before)


def test_a_finished_part_that_was_damaged_since_is_not_published(root, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(compacting, "advance", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            compact_dataset(root)
    old = {entry.id for entry in open_dataset(root).file.parts}
    made = next(p for p in (root / "parts").iterdir() if p.name not in old) / "steps.parquet"
    data = made.read_bytes()
    made.write_bytes(data[:200] + bytes([data[200] ^ 0xFF]) + data[201:])
    with pytest.raises(DataError, match=r"steps\.parquet"):
        compact_dataset(root)
    assert open_dataset(root).version == 1


def test_a_version_whose_digest_is_wrong_is_not_made_worse(root):
    path = root / "versions" / "000001.json"
    path.write_text(path.read_text().replace(open_dataset(root).digest, "0" * 64))
    with pytest.raises(DataError, match=r"000001\.json"):
        compact_dataset(root)


def test_damage_stops_it(root):
    next(root.glob("parts/*/steps.parquet")).unlink()
    with pytest.raises(DataError, match=r"steps\.parquet"):
        compact_dataset(root)
    assert open_dataset(root, partial=True).version == 1


def test_no_dataset_and_an_empty_one(tmp_path):
    with pytest.raises(UsageError, match="not a dataset"):
        compact_dataset(tmp_path)
    with pytest.raises(DataError, match="empty"):
        compact_dataset(create_dataset(tmp_path / "ds"))
