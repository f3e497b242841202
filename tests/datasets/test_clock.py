"""Clocks that were wrong when files were written, or are now: nothing that was acknowledged goes."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from candata.checks import check
from candata.datasets import append, durable, open_dataset, pending_parts, publish, put_cloud, write_part
from candata.datasets.gc import collect_garbage
from candata.datasets.parts import hold
from candata.datasets.versions import create_version, newest_version
from candata.errors import DataError
from candata.schema.manifest import Lineage
from tests.conftest import WHOLE

from .conftest import add

pytestmark = pytest.mark.hard

LINEAGE = Lineage(operation="test")
YEAR_S = 365 * 86_400.0


def shift(folder: Path, seconds: float) -> None:
    """Date a folder and all in it as a clock would that goes wrong by so much."""
    for path in [*folder.rglob("*"), folder]:
        state = path.stat()
        os.utime(path, (state.st_atime + seconds, state.st_mtime + seconds))


@pytest.fixture
def root(dataset, episode) -> Path:
    """Two versions, a cloud, a catalog, and a part that is not published."""
    made = dataset("ds")
    add(made, [episode("t", seed=1, point_cloud=put_cloud(made, np.eye(3)))])
    write_part(made, [episode("later", seed=2, point_cloud=put_cloud(made, np.ones((3, 3))))], {})
    open_dataset(made).catalog()
    return made


@pytest.mark.parametrize("seconds", [YEAR_S, 3600.0], ids=["a year", "an hour"])
def test_when_the_clock_was_set_back_nothing_goes_and_the_newest_version_is_the_newest(root, episode, seconds):
    shift(root, seconds)
    add(root, [episode("z", seed=9)])  # an older stamp than that of every version before
    assert newest_version(root).number == 3
    done = collect_garbage(root, grace_s=0, keep=1)
    kinds = {one.kind for one in done.removed}
    assert kinds <= {"version"}
    opened = open_dataset(root)
    assert opened.ids == ("a", "b", "c", "d", "t", "z")
    (part,) = pending_parts(root)
    assert [name for name, _ in part.episodes] == ["later"]
    publish(root, [part.id], LINEAGE)
    assert check(open_dataset(root), rules=WHOLE, deep=True) == ()


def test_what_was_written_by_a_clock_that_stood_at_nought_fails_at_its_end_and_loses_nothing(root, episode):
    shift(root, -50 * YEAR_S)
    (part,) = pending_parts(root)
    before = open_dataset(root)
    done = collect_garbage(root, keep=1)  # to the collector, the part has waited for fifty years
    assert f"parts/{part.id}" in [one.path for one in done.removed]
    with pytest.raises(DataError, match=part.id):
        publish(root, [part.id], LINEAGE)
    after = open_dataset(root)
    assert (after.digest, after.version) == (before.digest, before.version)
    assert check(after, rules=WHOLE, deep=True) == ()
    append(root, [episode("later", seed=2, point_cloud=put_cloud(root, np.ones((3, 3))))], LINEAGE)
    assert check(open_dataset(root), rules=WHOLE, deep=True) == ()


def test_a_part_is_not_collected_while_it_is_published(root):
    shift(root, -50 * YEAR_S)
    (part,) = pending_parts(root)
    done = []
    collector = threading.Thread(target=lambda: done.append(collect_garbage(root, keep=1)))
    with durable.publish_lock(root):
        hold(root, part.id)
        collector.start()
        time.sleep(0.2)  # time enough to take the part away
        assert (root / "parts" / part.id / "part.json").is_file()
        base = newest_version(root)
        assert not done
    collector.join()
    assert (root / "parts" / part.id).is_dir()
    assert f"parts/{part.id}" not in [one.path for one in done[0].removed]
    assert create_version(root, base, []) is False


def test_a_cloud_that_is_asked_for_again_is_not_collected(root):
    shift(root, -50 * YEAR_S)
    sha = put_cloud(root, np.full((2, 3), 7.0))
    shift(root, -50 * YEAR_S)
    assert put_cloud(root, np.full((2, 3), 7.0)) == sha
    collect_garbage(root)
    assert (root / "objects" / f"{sha}.parquet").is_file()
