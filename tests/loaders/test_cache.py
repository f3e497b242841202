"""The cache is made once, is whole or made again, and never read when damaged."""

from __future__ import annotations

import copy
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from candata.datasets import append, open_dataset
from candata.errors import DataError, SetupError
from candata.loaders import open_cache, windows
from candata.loaders.cache import FACTS, ROWS, VALID, reopen
from candata.schema.manifest import Lineage

WORKER = Path(__file__).with_name("cache_worker.py")


class Count:
    """Progress that remembers how often a cache was made."""

    def __init__(self):
        self.made, self.calls = 0, []

    def __call__(self, done: int, total: int) -> None:
        self.calls.append((done, total))
        self.made += done == total


def test_made_once_and_again_for_another_version_or_set_of_channels(hand, store):
    count = Count()
    dataset = store(hand("a"), hand("b"))
    first = open_cache(dataset, progress=count)
    assert count.calls == [(1, 2), (2, 2)]
    assert open_cache(open_dataset(dataset.path), progress=count).folder == first.folder
    assert count.made == 1
    open_cache(dataset, ["joint_position"], progress=count)
    assert count.made == 2
    append(dataset.path, [hand("c")], Lineage(operation="test"))
    assert len(open_cache(open_dataset(dataset.path), progress=count).rows) == 90
    assert count.made == 3


def test_rows_are_in_the_order_of_the_ids_whatever_the_parts(hand, store):
    store(hand("b", 20, offset=100), hand("a", 10))
    dataset = store(hand("aa", 5, offset=50))
    cache = open_cache(dataset)
    assert cache.file.ids == ("a", "aa", "b")
    expected = np.concatenate([np.arange(10), np.arange(50, 55), np.arange(100, 120)])
    np.testing.assert_array_equal(cache.rows["joint_position"][:, 0], expected)
    np.testing.assert_array_equal(cache.begin, [0, 10, 15])


def flip(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(bytes(data))


DAMAGE = {
    "a flipped bit": lambda folder: flip(folder / ROWS, -200),
    "a flipped bit of the header": lambda folder: flip(folder / ROWS, 12),
    "a truncated file": lambda folder: os.truncate(folder / ROWS, (folder / ROWS).stat().st_size - 8),
    "an empty file": lambda folder: os.truncate(folder / VALID, 0),
    "a missing file": lambda folder: (folder / VALID).unlink(),
    "missing facts": lambda folder: (folder / FACTS).unlink(),
    "half the facts": lambda folder: os.truncate(folder / FACTS, (folder / FACTS).stat().st_size // 2),
    "other facts": lambda folder: alter(folder / FACTS),
    "facts of another shape": lambda folder: (folder / FACTS).write_text("[1]"),
}


def alter(path: Path) -> None:
    facts = json.loads(path.read_text())
    facts["cache"]["rows"] = [29, 31]
    path.write_text(json.dumps(facts))


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_cache_is_made_again(hand, store, damage):
    dataset = store(hand("a"), hand("b", offset=50))
    whole = open_cache(dataset)
    expected, folder = np.array(whole.rows), whole.folder
    damage(folder)
    with pytest.raises(DataError, match="missing or damaged"):
        reopen(folder)
    count = Count()
    again = open_cache(dataset, progress=count)
    assert count.made == 1
    assert again.folder == folder
    assert (np.array(again.rows) == expected).all()
    assert [p.name for p in (folder.parent / "staging").iterdir()] == []


def test_a_cache_that_cannot_be_written_says_so(hand, store, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(SetupError, match="cannot be written") as caught:
        windows(store(hand("a")), 1, 1, stride=1, cache=tmp_path / "file")
    assert "cache=FOLDER" in str(caught.value)


def test_a_dataset_that_cannot_be_written_uses_the_users_folder(hand, store, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    dataset = store(hand("a"))
    cache = open_cache(dataset)
    assert cache.folder.parent == tmp_path / "user" / "candata"
    assert not (dataset.path / "cache").exists()
    assert open_cache(dataset).folder == cache.folder


def test_another_process_maps_the_same_file(hand, store):
    cache = open_cache(store(hand("a")))
    twin = copy.deepcopy(cache)
    assert twin.folder == cache.folder
    np.testing.assert_array_equal(twin.rows["joint_position"], cache.rows["joint_position"])


def test_the_validation_does_not_mind_a_cache(hand, store):
    from candata.checks import check

    dataset = store(hand("a"))
    open_cache(dataset)
    assert check(open_dataset(dataset.path), rules=("hashes", "schema", "finite"), deep=True) == ()


def start(root: Path, held_s: float = 0.0) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, str(WORKER), str(root), str(held_s)], stdout=subprocess.PIPE, text=True)


def test_builders_at_once_and_killed_ones_leave_one_whole_cache(hand, store):
    dataset = store(*(hand(f"e{i}", offset=10 * i) for i in range(40)))
    victims = [start(dataset.path, held_s=60.0) for _ in range(2)]
    for victim in victims:
        assert victim.stdout.readline() == "building\n"
        victim.send_signal(signal.SIGKILL)
        victim.wait()
        victim.stdout.close()
    assert not list((dataset.path / "cache").glob("windows-*")), "a killed builder left a cache"
    workers = [start(dataset.path) for _ in range(3)]
    sums = {worker.communicate(timeout=60)[0].split()[-1] for worker in workers}
    cache = open_cache(dataset)
    assert sums == {str(float(cache.rows["joint_position"][:, 0].sum(dtype=np.float64)))}
    assert len(list((dataset.path / "cache").glob("windows-*"))) == 1


def test_opening_reads_no_part(hand, store):
    dataset = store(hand("a"))
    windows(dataset, 1, 1, stride=1)
    for path in dataset.path.glob("parts/*/steps.parquet"):
        path.write_bytes(b"x" * path.stat().st_size)
    assert len(windows(dataset, 1, 1, stride=1)) == 29
