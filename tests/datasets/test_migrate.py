"""A dataset of a format version that was released stays readable for good: `frozen/` holds one of each."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from candata.checks import check
from candata.datasets import append, compact_dataset, content_hash, create_dataset, get_cloud, open_dataset
from candata.datasets.migrate import STEPS, migrate_dataset
from candata.datasets.versions import format_of
from candata.errors import DataError, SetupError, UsageError
from candata.schema.manifest import FORMAT_VERSION, Lineage
from tests.conftest import WHOLE, make_episode

FROZEN = Path(__file__).parent / "frozen"

#: Version to (digest of its newest version, content hash of each episode), as written when it was frozen.
PROMISED = {
    1: (
        "5f5751b6d855c37a012dd3f5699b550535d82d1b8f3011a3051bef2e1df196fe",
        {
            "a": "8b1b3fb258cb8dcd3ca38f1c291165002f82b210ab54697639ee7af2f547d8fe",
            "b": "695e72da3ff32d8ccc3172943a79c6a9f2865c6ec53e5a468d39a7d515b2d116",
            "c": "e4febc67f60470cd31a72ba85f8aff93dda249f030d42c7e41e9963dfcc4358f",
        },
    )
}


@pytest.fixture
def old(tmp_path):
    return shutil.copytree(FROZEN / "v1", tmp_path / "old")


def say(root, version):
    """Let `dataset.json` say another format version."""
    path = root / "dataset.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format_version": version}))


def tree(root):
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def test_the_present_format_is_frozen():
    assert FORMAT_VERSION in PROMISED
    assert set(STEPS) == set(range(1, FORMAT_VERSION))
    for version in PROMISED:
        assert format_of(FROZEN / f"v{version}") == version


def test_the_frozen_dataset_opens_bit_for_bit(old):
    digest, hashes = PROMISED[1]
    dataset = open_dataset(old)
    assert (dataset.name, dataset.digest) == ("frozen", digest)
    assert {e.meta.id: content_hash(e) for e in dataset} == hashes
    assert check(dataset, rules=WHOLE, deep=True) == ()
    assert open_dataset(old, 1).ids == ("a", "b")
    assert [step.operation for step in dataset.lineage] == ["frozen", "more"]
    assert dataset.episode("a").meta.effects[0].parameters == {"damping_Nms_rad": 0.1}
    assert dataset.episode("c")["taxels"].dtype == np.int16
    assert get_cloud(old, dataset.episode("a").meta.point_cloud).shape == (4, 3)


def test_it_takes_new_episodes_and_a_compaction(old):
    digest, hashes = PROMISED[1]
    assert compact_dataset(old).version.digest == digest
    append(old, [make_episode("d")], Lineage(operation="test"))
    found = {e.meta.id: content_hash(e) for e in open_dataset(old)}
    assert {name: found[name] for name in hashes} == hashes
    assert check(open_dataset(old), rules=WHOLE, deep=True) == ()


def test_of_the_present_format_nothing_is_to_do(old, tmp_path):
    done = migrate_dataset(old, tmp_path / "new")
    assert (done.old, done.new, done.done) == (1, 1, False)
    assert not (tmp_path / "new").exists()


def test_steps_lead_from_format_to_format(old, tmp_path):
    say(old, -1)
    (old / "cache").mkdir()
    (old / "cache" / "x").write_text("made again")
    (old / "splits").mkdir()
    (old / "splits" / "mine.json").write_text("who trained")
    before, taken = tree(old), []

    def step(to):
        def change(root):
            taken.append(to)
            say(root, to)

        return change

    done = migrate_dataset(old, tmp_path / "deep" / "new", steps={-1: step(0), 0: step(1)})
    assert (done.old, done.new, done.done, taken) == (-1, 1, True, [0, 1])
    assert tree(old) == before
    new = open_dataset(tmp_path / "deep" / "new")
    assert {e.meta.id: content_hash(e) for e in new} == PROMISED[1][1]
    assert not (new.path / "cache").exists()
    assert (new.path / "splits" / "mine.json").read_text() == "who trained"
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["new"]


def test_an_older_format_says_what_to_do(old, tmp_path):
    say(old, 0)
    with pytest.raises(DataError, match="candata migrate"):
        open_dataset(old)
    with pytest.raises(DataError, match="no migration leads on"):
        migrate_dataset(old, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def breaks(root):
    say(root, 1)
    next(root.glob("parts/*/steps.parquet")).unlink()


def stops(root):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("step", "error"), [(breaks, DataError), (lambda root: None, DataError), (stops, KeyboardInterrupt)]
)
def test_a_step_that_fails_leaves_nothing(old, tmp_path, step, error):
    say(old, 0)
    with pytest.raises(error):
        migrate_dataset(old, tmp_path / "new", steps={0: step})
    assert [p.name for p in tmp_path.iterdir()] == ["old"]


def test_wrong_use_is_one_clear_error(old, tmp_path, monkeypatch):
    steps = {0: lambda root: say(root, 1)}
    with pytest.raises(UsageError, match="not a dataset"):
        migrate_dataset(tmp_path, tmp_path / "new")
    say(old, 9)
    with pytest.raises(DataError, match="newer format"):
        migrate_dataset(old, tmp_path / "new")
    say(old, 0)
    with pytest.raises(UsageError, match="exists already"):
        migrate_dataset(old, old, steps=steps)
    with pytest.raises(UsageError, match="inside the old one"):
        migrate_dataset(old, old / "new", steps=steps)
    (old / "objects" / "link").symlink_to(tmp_path)
    with pytest.raises(DataError, match="a link"):
        migrate_dataset(old, tmp_path / "new", steps=steps)
    (old / "objects" / "link").unlink()
    (tmp_path / "file").write_text("")
    with pytest.raises(SetupError, match="cannot be written"):
        migrate_dataset(old, tmp_path / "file" / "new", steps=steps)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "old"]


def test_an_empty_dataset_migrates_too(tmp_path):
    root = create_dataset(tmp_path / "ds")
    say(root, 0)
    assert migrate_dataset(root, tmp_path / "new", steps={0: lambda draft: say(draft, 1)}).done
    assert format_of(tmp_path / "new") == 1


def test_splits_and_tags_come_along(rich, tmp_path):
    say(rich, 0)
    migrate_dataset(rich, tmp_path / "new", steps={0: lambda draft: say(draft, 1)})
    for name in ("splits", "tags"):
        assert tree(tmp_path / "new" / name) == tree(rich / name) != {}
