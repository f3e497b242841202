"""A remote that claims what is not so, every hash made to agree: refused, and nothing of the folder has changed."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from candata.datasets import open_dataset
from candata.datasets.clouds import cloud_path
from candata.datasets.pull import pull
from candata.datasets.push import push
from candata.datasets.remotes import object_key, open_remote, read_key, version_key
from candata.errors import DataError
from candata.schema.registry import RemoteEntry

from .conftest import s3_entry
from .forging import forge, nudged, rewrite

pytestmark = pytest.mark.hard

NAME = "rich"


@pytest.fixture(scope="module")
def share(rich_once, tmp_path_factory) -> Path:
    """A folder that the dataset was pushed to."""
    folder = tmp_path_factory.mktemp("pushed")
    push(rich_once, open_remote(RemoteEntry(url=str(folder))), NAME)
    return folder


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything under a folder by path; None where there is no folder."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def refused(store, tmp_path, match: str) -> None:
    """Pull into a folder that is missing and into one that holds version 1: both are left as they were."""
    with pytest.raises(DataError, match=match) as error:
        pull(store, NAME, tmp_path / "new")
    assert error.value.where.path.startswith(store.url)
    assert not (tmp_path / "new").exists()
    older = tmp_path / "older"
    pull(store, NAME, older, 1)
    before = contents(older)
    with pytest.raises(DataError, match=match):
        pull(store, NAME, older)
    assert contents(older) == before


def rewrite_record(store, record: dict) -> None:
    data = json.dumps(record).encode()
    store.write(version_key(NAME, 2), [data], len(data))


def rewrite_part(store, change) -> None:
    """Change the manifest of the part that version 2 adds, all hashes agreeing, and what the version says of it."""
    record = json.loads(read_key(store, version_key(NAME, 2)))
    entry = record["version"]["parts"][-1]
    part = json.loads(read_key(store, object_key(NAME, entry["sha256"])))
    change(part, entry)
    data = json.dumps(part).encode()
    entry["sha256"] = hashlib.sha256(data).hexdigest()
    store.write(object_key(NAME, entry["sha256"]), [data], len(data))
    rewrite_record(store, record)


#: What version 2 may claim wrongly of itself, and words of the error.
VERSION = {
    "an exclusion of an unknown episode": (lambda v: v.update(exclusions=["nobody"]), "exclusions of 1 unknown"),
    "an exclusion twice": (lambda v: v.update(exclusions=["a", "a"]), "exclusions of 0 unknown episodes, or one twice"),
    "a part twice": (lambda v: v["parts"].append(v["parts"][0]), "the part [0-9a-f]{32} twice"),
    "a row more": (lambda v: v["parts"][-1].update(rows=v["parts"][-1]["rows"] + 1), "20 rows, 1 episodes; its ver"),
    "an episode less": (lambda v: v["parts"][-1].update(episodes=0), r"its version claims 20, 0"),
    "another digest": (lambda v: v.update(digest="0" * 64), "digest"),
    "another parent": (lambda v: v.update(parent="0" * 64), "parent"),
    "no parent": (lambda v: v.update(parent=None), "parent None of version 2"),
    "a field that is not known": (lambda v: v.update(episodes=5), "not valid"),
}

#: What its own part may claim wrongly, with what the version says of it made to agree.
PART = {
    "rows": (lambda p, e: (p.update(rows=19), e.update(rows=19)), "20 rows in 1; expected 19 rows in 1 row groups"),
    "an episode twice": (lambda p, e: (p["episodes"].append(p["episodes"][0]), e.update(episodes=2)), "episode twice"),
    "another episode": (lambda p, e: p["episodes"][0].__setitem__(0, "other"), "other episodes than those of part"),
    "a hash that is none": (lambda p, e: p["episodes"][0].__setitem__(1, "abc"), "not the sha256 of an episode"),
    "a byte more": (lambda p, e: p["files"][0].update(bytes=p["files"][0]["bytes"] + 1), "bytes, not"),
    "a file that is another": (lambda p, e: p["files"][0].update(sha256="0" * 64), "no such object"),
    "no table": (lambda p, e: p["files"].pop(0), "a part without steps.parquet"),
    "a lone surrogate": (lambda p, e: p["episodes"][0].__setitem__(0, "\ud800"), "no valid JSON"),
}


@pytest.fixture
def pushed(share, tmp_path):
    return open_remote(RemoteEntry(url=str(shutil.copytree(share, tmp_path / "share"))))


@pytest.mark.parametrize("claim", VERSION)
def test_a_version_that_claims_what_is_not_so(pushed, tmp_path, claim):
    change, words = VERSION[claim]
    record = json.loads(read_key(pushed, version_key(NAME, 2)))
    change(record["version"])
    rewrite_record(pushed, record)
    refused(pushed, tmp_path, words)


@pytest.mark.parametrize("claim", PART)
def test_a_part_that_claims_what_is_not_so(pushed, tmp_path, claim):
    change, words = PART[claim]
    rewrite_part(pushed, change)
    refused(pushed, tmp_path, words)


@pytest.mark.parametrize("claimed", [None, "1", 1.0, True, [1], -1, 0, 2, 10**30], ids=str)
def test_a_format_that_is_none_or_another(pushed, tmp_path, claimed):
    head = json.loads(read_key(pushed, f"{NAME}/dataset.json")) | {"format_version": claimed}
    data = json.dumps(head).encode()
    pushed.write(f"{NAME}/dataset.json", [data], len(data))
    with pytest.raises(DataError, match="format"):
        pull(pushed, NAME, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_format_that_is_missing(pushed, tmp_path):
    head = json.loads(read_key(pushed, f"{NAME}/dataset.json"))
    del head["format_version"]
    data = json.dumps(head).encode()
    pushed.write(f"{NAME}/dataset.json", [data], len(data))
    with pytest.raises(DataError, match="no format version"):
        pull(pushed, NAME, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_tag_that_names_another_digest(pushed, tmp_path):
    tag = json.loads(read_key(pushed, f"{NAME}/tags/clean.json")) | {"digest": "0" * 64}
    data = json.dumps(tag).encode()
    pushed.write(f"{NAME}/tags/clean.json", [data], len(data))
    with pytest.raises(DataError, match=r"clean\.json"):
        pull(pushed, NAME, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_cloud_that_is_not_listed(pushed, tmp_path):
    record = json.loads(read_key(pushed, version_key(NAME, 2)))
    rewrite_record(pushed, record | {"clouds": []})
    refused(pushed, tmp_path, "no point cloud")


def other_hash(folder: Path, manifest: dict) -> None:
    """Claim another content hash in the manifest and in the catalog row."""
    manifest["episodes"][0][1] = "1" * 64
    rewrite(folder / "episodes.parquet", "content_hash", lambda old: ["1" * 64, *old[1:]])


def other_order(folder: Path, manifest: dict) -> None:
    manifest["episodes"].reverse()


def row(column: str, *values: object):
    """A change of a column of the catalog that neither content nor manifest knows of."""
    return lambda folder, _: rewrite(folder / "episodes.parquet", column, lambda old: [*values, *old[len(values) :]])


def more_rows(folder: Path, _: dict) -> None:
    table = pq.read_table(folder / "steps.parquet", partitioning=None)
    pq.write_table(pa.concat_tables([table, table]), folder / "steps.parquet", row_group_size=len(table))


def other_cell(folder: Path, _: dict) -> None:
    rewrite(folder / "steps.parquet", "joint_position", nudged)


def deep(folder: Path, _: dict) -> None:
    rewrite(folder / "episodes.parquet", "meta", lambda old: ["[" * 100_000, *old[1:]])


#: Changes of contents after which every hash of a file agrees, and words of the error.
CONTENTS = {
    "a cell": (other_cell, "steps.parquet: content"),
    "the hash of an episode": (other_hash, "steps.parquet: content"),
    "the order": (other_order, "episodes.parquet: 2 episodes that differ"),
    "more rows": (more_rows, "steps.parquet: 80 rows in 2; expected 40 rows in 1 row groups"),
    "counts of rows": (row("rows", 10, 30), "steps.parquet: content"),
    "a count below zero": (row("rows", -10, 50), "steps.parquet"),
    "the name in the catalog": (row("id", "z"), "episodes that differ"),
    "the object": (row("object", "gold"), "episodes.parquet: object 'gold' of a"),
    "the outcome": (row("outcome", "success"), "outcome 'success'"),
    "the duration": (row("duration_s", 5.0), "duration_s 5.0"),
    "the effects": (row("effects", '[{"name": "joint_damping"}]'), "effects"),
    "effects that are none": (row("effects", "{"), "no record of a"),
    "the joints": (row("joint_names", ["c", "d"]), "joint_names"),
    "the row group": (row("row_group", 1), "episodes that differ"),
    "a record that is none": (row("meta", "{}"), "steps.parquet: content"),
    "a record nested deep": (deep, "steps.parquet: content"),
}


@pytest.mark.parametrize("what", CONTENTS)
def test_contents_that_are_not_what_is_claimed(dataset, tmp_path, what):
    change, words = CONTENTS[what]
    root = dataset("rich", "ab")
    forge(root, change)
    (tmp_path / "share").mkdir()
    store = open_remote(RemoteEntry(url=str(tmp_path / "share")))
    push(root, store, NAME)
    with pytest.raises(DataError, match=words) as error:
        pull(store, NAME, tmp_path / "new")
    assert error.value.problem == "the remote is damaged: nothing of this file was kept"
    assert not (tmp_path / "new").exists()


def other_taxels(folder: Path, _: dict) -> None:
    """Put the last shard of bytes in the place of another of the same size."""
    (shard,) = folder.glob("taxels.zarr/c/0/0/0/0")
    shard.write_bytes(shard.read_bytes()[::-1])


def test_taxels_that_are_not_what_is_claimed(rich, tmp_path):
    forge(rich, other_taxels, position=-1)
    (tmp_path / "share").mkdir()
    store = open_remote(RemoteEntry(url=str(tmp_path / "share")))
    push(rich, store, NAME)
    refused(store, tmp_path, "taxels.zarr|steps.parquet: content")


def test_a_cloud_of_other_points(rich, tmp_path):
    sha = open_dataset(rich).episode("t").meta.point_cloud
    points = np.ones((3, 3), np.float32)
    pq.write_table(pa.table({axis: points[:, i] for i, axis in enumerate("xyz")}), cloud_path(rich, sha))
    (tmp_path / "share").mkdir()
    store = open_remote(RemoteEntry(url=str(tmp_path / "share")))
    push(rich, store, NAME)
    refused(store, tmp_path, f"{sha}.parquet: content")


def test_false_claims_on_s3(rich, s3_server, monkeypatch, tmp_path):
    store = open_remote(s3_entry(s3_server, monkeypatch, "false-claims"))
    forge(rich, other_cell, position=-1)
    push(rich, store, NAME)
    refused(store, tmp_path, "steps.parquet: content")
    rewrite_part(store, lambda part, entry: (part.update(rows=19), entry.update(rows=19)))
    refused(store, tmp_path, "expected 19 rows")
    rewrite_part(store, lambda part, entry: part["files"][0].update(bytes=1))
    refused(store, tmp_path, "bytes, not 1")


def test_what_a_killed_pull_left_of_a_false_part_is_not_taken_along(dataset, tmp_path):
    good, root = dataset("rich", "ab"), dataset("other", "ab")
    forge(root, other_cell)
    share = tmp_path / "share"
    share.mkdir()
    store = open_remote(RemoteEntry(url=str(share)))
    push(root, store, NAME)
    (part,) = (root / "parts").iterdir()
    waiting = tmp_path / "new" / "staging" / "pull" / "parts"
    waiting.mkdir(parents=True)
    shutil.copytree(part, waiting / part.name)  # as if a pull had been killed when all had arrived
    with pytest.raises(DataError, match="content"):
        pull(store, NAME, tmp_path / "new")
    shutil.rmtree(share / NAME)
    push(good, store, NAME)
    pull(store, NAME, tmp_path / "new")
    assert open_dataset(tmp_path / "new").digest == open_dataset(good).digest
