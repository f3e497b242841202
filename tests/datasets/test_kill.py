"""Processes killed at any moment lose nothing that was acknowledged, whatever runs beside them."""

from __future__ import annotations

import json

import pytest

from candata.checks import check
from candata.datasets import append, create_dataset, kill_test, open_dataset, pending_parts
from candata.errors import SetupError
from candata.schema.manifest import Lineage
from tests.conftest import WHOLE

pytestmark = pytest.mark.hard


def test_every_acknowledged_episode_is_found_once_and_intact(tmp_path):
    done = kill_test.kill_test(tmp_path, kills=4)
    assert (done.lost, done.doubled, done.damage) == (0, 0, ())
    assert done.has_passed
    assert done.acknowledged >= 2 * 4
    assert check(open_dataset(tmp_path / "dataset"), rules=WHOLE, deep=True) == ()
    # Written but not published: at most one a killed writer.
    assert len(pending_parts(tmp_path / "dataset")) <= 4 + 3


def soak(folder, kills, seed):
    roles = ("append", "append", "compact", "collect")
    done = kill_test.kill_test(folder, kills=kills, roles=roles, grace_s=3.0, seed=seed)
    assert (done.lost, done.doubled, done.damage) == (0, 0, ())
    dataset = open_dataset(folder / "dataset")
    assert check(dataset, rules=WHOLE, deep=True) == ()
    assert len(dataset.file.parts) < len(dataset)
    assert "compact" in [step.operation for step in dataset.lineage]
    return done


def test_writers_compaction_and_gc_at_once_under_kills(tmp_path):
    soak(tmp_path, kills=3, seed=1)


def short_grace(folder, kills, seed):
    """A second is less than a job may take: that job fails and is done again, and nothing that it told is lost."""
    roles = ("append", "append", "append", "collect")
    done = kill_test.kill_test(folder, kills=kills, roles=roles, grace_s=1.0, seed=seed)
    assert (done.lost, done.doubled, done.damage) == (0, 0, ())
    assert check(open_dataset(folder / "dataset"), rules=WHOLE, deep=True) == ()


def test_gc_with_a_grace_of_a_second_beside_writers(tmp_path):
    short_grace(tmp_path, kills=4, seed=2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_gc_with_a_grace_of_a_second_beside_writers_for_long(tmp_path, seed):
    short_grace(tmp_path, kills=40, seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_soak(tmp_path, seed):
    done = soak(tmp_path, kills=40, seed=seed)
    standing = len(list((tmp_path / "dataset" / "versions").iterdir()))
    assert standing < done.versions  # gc has taken versions that were superseded
    assert done.acknowledged >= 2 * 20


def test_what_is_lost_doubled_or_damaged_is_counted(tmp_path, episode):
    root = create_dataset(tmp_path / "ds")
    append(root, [episode(name, seed=i) for i, name in enumerate("abc")], Lineage(operation="test"), part_size=1)
    hashes = {name: place.content_hash for name, place in open_dataset(root).places.items()}
    whole = kill_test._verdict(root, 1, hashes)
    assert (whole.lost, whole.doubled, whole.damage, whole.has_passed) == (0, 0, (), True)
    assert kill_test._verdict(root, 1, hashes | {"d": "0" * 64}).lost == 1
    assert kill_test._verdict(root, 1, hashes | {"a": "0" * 64}).lost == 1
    assert not kill_test._verdict(root, 1, {}).has_passed
    path = root / "versions" / "000001.json"
    version = json.loads(path.read_text())
    path.write_text(json.dumps(version | {"parts": [*version["parts"], version["parts"][0]]}))
    assert kill_test._verdict(root, 1, hashes).doubled == 1
    (root / "parts" / version["parts"][1]["id"] / "steps.parquet").unlink()
    found = kill_test._verdict(root, 1, hashes)
    assert (found.lost, len(found.damage), found.has_passed) == (1, 1, False)


def test_a_process_that_ends_by_itself_is_named(tmp_path):
    with pytest.raises(SetupError, match=r"\(unheard\) ended by itself") as error:
        kill_test.kill_test(tmp_path, kills=1, roles=("unheard",))
    assert "KeyError: 'unheard'" in str(error.value)
