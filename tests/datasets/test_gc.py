"""What nothing reaches goes once it is old; what anything reaches, or somebody may be about to publish, stays."""

from __future__ import annotations

import json
import os
import shutil
import time

import numpy as np
import pytest

from candata.checks import check
from candata.datasets import (
    append,
    collect_garbage,
    compact_dataset,
    create_dataset,
    durable,
    gc,
    open_dataset,
    publish,
    put_cloud,
    write_part,
)
from candata.datasets.tags import tag_path
from candata.errors import DataError, SetupError, UsageError
from candata.schema.manifest import Lineage, TagFile
from tests.conftest import WHOLE, make_episode

LINEAGE = Lineage(operation="test")
DAY_S = 86_400.0
CLOUD = np.arange(12.0).reshape(4, 3)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Version 1: two parts, one of which names a cloud; version 2: compacted; 3: one more."""
    root = create_dataset(tmp_path_factory.mktemp("made") / "ds")
    cloud = put_cloud(root, CLOUD)
    append(root, [make_episode("a", point_cloud=cloud), make_episode("b", seed=1)], LINEAGE, part_size=1)
    compact_dataset(root)
    append(root, [make_episode("c", seed=2)], LINEAGE)
    for number in (1, 2, 3):
        open_dataset(root, number).catalog()
    return root


@pytest.fixture
def root(made, tmp_path):
    """A copy whose every file is 30 days old."""
    root = shutil.copytree(made, tmp_path / "ds")
    age(root)
    return root


def age(path, days=30.0):
    for one in [path, *path.rglob("*")]:
        os.utime(one, (time.time() - days * DAY_S,) * 2)


def listing(root):
    return {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}


def kinds(garbage):
    return sorted(one.kind for one in garbage)


def test_every_version_stays_unless_it_is_said_how_many(root):
    before = listing(root)
    done = collect_garbage(root)
    assert (done.removed, done.waiting, done.bytes) == ((), (), 0)
    assert listing(root) == before


def test_what_the_kept_versions_do_not_reach_goes(root):
    size = sum(p.stat().st_size for p in root.rglob("*") if p.is_file())
    done = collect_garbage(root, keep=1)
    assert kinds(done.removed) == ["catalog", "part", "part", "version", "version"]
    assert size - sum(p.stat().st_size for p in root.rglob("*") if p.is_file()) == done.bytes > 0
    dataset = open_dataset(root)
    assert dataset.ids == ("a", "b", "c")
    assert check(dataset, rules=WHOLE, deep=True) == ()
    assert len(list((root / "parts").iterdir())) == len(dataset.file.parts) == 2
    assert [p.name for p in (root / "versions").iterdir()] == ["000003.json"]
    assert append(root, [make_episode("d", seed=3)], LINEAGE).number == 4
    assert collect_garbage(root, keep=1, grace_s=3600).removed == ()  # 3 was the newest a moment ago


def test_files_that_another_dataset_shares_free_nothing(root, tmp_path):
    part = write_part(root, [make_episode("pending", seed=8)], {})
    shutil.copytree(root / "parts" / part.id, tmp_path / "shared", copy_function=os.link)
    age(root)
    done = collect_garbage(root)
    assert (kinds(done.removed), done.bytes) == (["part"], 0)
    assert (tmp_path / "shared" / "steps.parquet").stat().st_size > 0


def test_a_tag_keeps_its_version(root):
    first = open_dataset(root, 1)
    durable.ensure_folder(root / "tags")
    tag = TagFile(name="paper", version=1, digest=first.digest)
    tag_path(root, "paper").write_bytes(durable.encode_record(tag))
    done = collect_garbage(root, keep=1)
    assert kinds(done.removed) == ["version"]
    assert [e.meta.id for e in open_dataset(root, "paper")] == ["a", "b"]


def test_a_dry_run_says_the_same_and_removes_nothing(root):
    (root / "staging" / ("ab" * 16)).mkdir(parents=True)
    age(root)
    before = listing(root)
    told = collect_garbage(root, keep=2, dry_run=True)
    assert listing(root) == before
    assert collect_garbage(root, keep=2).removed == told.removed
    assert kinds(told.removed) == ["part", "part", "staging", "version"]


def test_what_is_young_waits(root):
    part = write_part(root, [make_episode("pending", seed=8)], {})
    (root / "staging" / ("ab" * 16)).mkdir()
    done = collect_garbage(root)
    assert done.removed == ()
    assert kinds(done.waiting) == ["part", "staging"]
    assert publish(root, [part.id], LINEAGE).number == 4


def test_what_is_old_and_was_never_published_goes(root):
    cloud = put_cloud(root, CLOUD + 1)
    write_part(root, [make_episode("pending", seed=8, point_cloud=cloud)], {})
    litter = root / "staging" / ("ab" * 16) / "taxels.zarr"
    litter.mkdir(parents=True)
    (litter / "zarr.json").write_text("{}")
    age(root)
    done = collect_garbage(root)
    assert kinds(done.removed) == ["cloud", "part", "staging"]
    assert [p.stem for p in (root / "objects").iterdir()] == [open_dataset(root).episode("a").meta.point_cloud]


def test_a_staging_folder_with_one_young_file_is_in_use(root):
    folder = root / "staging" / ("ab" * 16)
    folder.mkdir(parents=True)
    age(root)
    (folder / "steps.parquet").write_text("")
    os.utime(folder, (0, 0))
    assert collect_garbage(root).removed == ()


def test_caches_of_no_version_go(root):
    for name, digest in (("kept", open_dataset(root).digest), ("gone", "0" * 64)):
        (root / "cache" / f"windows-{name}").mkdir(parents=True)
        (root / "cache" / f"windows-{name}" / "cache.json").write_text(json.dumps({"cache": {"digest": digest}}))
    (root / "cache" / "windows-damaged").mkdir()
    age(root)
    done = collect_garbage(root)
    assert [one.path for one in done.removed] == ["cache/windows-damaged", "cache/windows-gone"]


def test_a_part_that_is_published_while_it_is_judged_stays(root, monkeypatch):
    part = write_part(root, [make_episode("pending", seed=8)], {})
    age(root)
    real = gc._collect

    def late(*arguments):
        publish(root, [part.id], LINEAGE)
        return real(*arguments)

    monkeypatch.setattr(gc, "_collect", late)
    assert kinds(collect_garbage(root).removed) == []
    assert check(open_dataset(root), rules=WHOLE, deep=True) == ()
    assert "pending" in open_dataset(root).ids


def test_a_part_touched_in_the_last_moment_is_put_back(root, monkeypatch):
    part = write_part(root, [make_episode("pending", seed=8)], {})
    age(root)
    folder, rename = root / "parts" / part.id, os.rename

    def late(source, target):
        if source == folder:
            os.utime(folder)
        rename(source, target)

    monkeypatch.setattr(gc.os, "rename", late)
    assert collect_garbage(root).removed == ()
    assert publish(root, [part.id], LINEAGE).number == 4


def test_a_part_taken_away_before_it_is_published_is_an_error(root):
    part = write_part(root, [make_episode("pending", seed=8)], {})
    age(root)
    collect_garbage(root)
    with pytest.raises(DataError, match=r"part\.json"):
        publish(root, [part.id], LINEAGE)
    assert open_dataset(root).version == 3


def test_what_candata_did_not_write_is_left_alone(root, tmp_path):
    outside = tmp_path / "outside"
    (outside / ("cd" * 16)).mkdir(parents=True)
    (outside / ("cd" * 16) / "letter.txt").write_text("dear")
    (root / "parts" / ("ef" * 16)).symlink_to(outside / ("cd" * 16))
    for name in ("parts/notes", "catalog/notes.txt", "objects/mesh.stl", "cache/other", "letter.txt"):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text("mine")
    age(root)
    assert collect_garbage(root).removed == ()
    assert (outside / ("cd" * 16) / "letter.txt").read_text() == "dear"


def test_clouds_stay_while_a_part_cannot_be_read(root):
    put_cloud(root, CLOUD + 1)
    next((root / "parts").glob("*/episodes.parquet")).write_bytes(b"PAR1")
    age(root)
    done = collect_garbage(root)
    assert done.removed == ()
    assert "episodes.parquet" in done.notes[0]


@pytest.mark.parametrize("name", ["versions/000001.json", "tags/paper.json"])
def test_a_damaged_version_or_tag_stops_it(root, name):
    (root / name).parent.mkdir(exist_ok=True)
    (root / name).write_text("{")
    before = listing(root)
    with pytest.raises(DataError, match=name.split("/")[1].replace(".", r"\.")):
        collect_garbage(root, keep=1)
    assert listing(root) == before


@pytest.mark.parametrize("options", [{"grace_s": -1}, {"keep": 0}])
def test_numbers_out_of_range(root, options):
    with pytest.raises(UsageError, match="out of range"):
        collect_garbage(root, **options)


def test_a_folder_that_cannot_be_written(root, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied", "parts")

    monkeypatch.setattr(gc.os, "rename", refuse)
    with pytest.raises(SetupError, match="Permission denied"):
        collect_garbage(root, keep=1)
    with pytest.raises(UsageError, match="not a dataset"):
        collect_garbage(root / "parts")


def test_what_a_stopped_pull_left_goes_once_it_is_old(root):
    (root / "staging" / "pull").mkdir(parents=True)
    (root / "staging" / "pull" / "half").write_text("half")
    assert collect_garbage(root).removed == ()
    age(root)
    assert [one.path for one in collect_garbage(root).removed] == ["staging/pull"]
