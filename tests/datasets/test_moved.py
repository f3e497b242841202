"""A dataset that is renamed, made read-only or reached by a link while somebody writes to it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from candata.checks import check
from candata.datasets import append, compact_dataset, create_dataset, open_dataset, put_cloud, write_part
from candata.datasets.gc import collect_garbage
from candata.datasets.merging import merge_into
from candata.datasets.pull import pull
from candata.datasets.push import push
from candata.datasets.remotes import open_remote
from candata.datasets.tagging import set_tag
from candata.errors import CandataError, SetupError, UsageError
from candata.schema.manifest import Lineage
from candata.schema.registry import RemoteEntry
from candata.simulate.generate import generate
from tests.conftest import WHOLE

from .conftest import add

pytestmark = pytest.mark.hard

LINEAGE = Lineage(operation="test")
#: Eight chunks, one after another.
SET = ("--scene", "cube_toss", "--episodes", "128", "--seed", "7", "--duration-s", "0.4", "--jobs", "1")


@contextmanager
def generating(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Give a process that makes a set, once its first part stands."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "candata_cli.main", "generate-sim", *SET, "--out", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env) as run:
        until = time.monotonic() + 60
        while not list(folder.glob("parts/*/part.json")):
            assert run.poll() is None
            assert time.monotonic() < until
            time.sleep(0.002)
        yield run


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> str:
    """The digest of that set, left in peace."""
    return generate(tmp_path_factory.mktemp("whole") / "set", "cube_toss", 128, 7, duration_s=0.4, workers=1).digest


def test_a_dataset_that_is_renamed_in_mid_run_is_not_made_anew(tmp_path, reference):
    with generating(tmp_path / "set") as run:
        (tmp_path / "set").rename(tmp_path / "away")
        said = run.communicate(timeout=120)[1]
    assert run.returncode == 3
    assert f"the folder of the dataset has gone\n  where: {tmp_path / 'set'}\n  do: bring it back" in said
    assert "Traceback" not in said
    assert not (tmp_path / "set").exists()
    assert 0 < len(list(tmp_path.glob("away/parts/*/part.json"))) < 8
    assert generate(tmp_path / "away", "cube_toss", 128, 7, duration_s=0.4, workers=1).digest == reference


@pytest.mark.parametrize("verb", ["append", "part", "cloud", "tag", "compact", "merge", "gc"])
def test_no_verb_makes_a_dataset_anew_that_has_gone(dataset, episode, tmp_path, verb):
    root, other = dataset("ds"), open_dataset(dataset("other", "xy"))

    def goes():
        root.rename(tmp_path / "away")
        yield episode("z", seed=5)

    moved = {
        "append": lambda: append(root, goes(), LINEAGE),
        "part": lambda: write_part(root, goes(), {}),
        "cloud": lambda: (next(goes()), put_cloud(root, np.eye(3))),
        "tag": lambda: (next(goes()), set_tag(root, "x")),
        "compact": lambda: (next(goes()), compact_dataset(root)),
        "merge": lambda: (next(goes()), merge_into([other], root)),
        "gc": lambda: (next(goes()), collect_garbage(root)),
    }
    with pytest.raises(CandataError, match=r"the folder of the dataset has gone|not a dataset"):
        moved[verb]()
    assert not root.exists()
    assert open_dataset(tmp_path / "away").ids == ("a", "b", "c", "d")


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Let nothing be made or renamed in a folder; root, whom no mode stops, needs the attribute of the file system."""
    if os.geteuid() != 0:
        before = folder.stat().st_mode
        folder.chmod(0o555)
        yield
        folder.chmod(before)
        return
    if subprocess.run(["chattr", "+i", folder], capture_output=True, check=False).returncode != 0:
        pytest.skip("root may write everywhere here: the file system knows no immutable folders")
    try:
        yield
    finally:
        subprocess.run(["chattr", "-i", folder], check=True)


@pytest.mark.parametrize("folder", ["parts", "staging", "."])
def test_a_dataset_that_is_made_read_only_in_mid_run_says_so_and_goes_on_later(tmp_path, reference, folder):
    root = tmp_path / "set"
    with generating(root) as run, read_only(root / folder):
        said = run.communicate(timeout=120)[1]
    assert run.returncode == 3
    assert "Operation not permitted" in said or "Permission denied" in said
    assert str(root) in said
    assert "Traceback" not in said
    assert all((path / "part.json").is_file() for path in root.glob("parts/*"))
    assert generate(root, "cube_toss", 128, 7, duration_s=0.4, workers=1).digest == reference


def test_a_file_in_the_place_of_a_folder_is_said(dataset, episode):
    root = dataset("ds")
    shutil.rmtree(root / "staging")
    (root / "staging").write_text("")
    with pytest.raises(OSError, match="staging"):
        add(root, [episode("z", seed=5)])
    assert open_dataset(root).ids == ("a", "b", "c", "d")


def test_all_goes_through_a_link_to_a_dataset(dataset, episode, tmp_path):
    root = dataset("ds")
    link = tmp_path / "link"
    link.symlink_to(root)
    add(link, [episode("z", seed=5)])
    set_tag(link, "x")
    compact_dataset(link)
    collect_garbage(link, grace_s=0, keep=1)
    share = tmp_path / "share"
    share.mkdir()
    (tmp_path / "mounted").symlink_to(share)
    store = open_remote(RemoteEntry(url=str(tmp_path / "mounted")))
    push(link, store, "ds")
    (tmp_path / "empty").mkdir()
    (tmp_path / "target").symlink_to(tmp_path / "empty")
    pull(store, "ds", tmp_path / "target")
    assert link.is_symlink()
    for place in (root, link, tmp_path / "empty"):
        opened = open_dataset(place)
        assert opened.ids == ("a", "b", "c", "d", "z")
        assert check(opened, rules=WHOLE, deep=True) == ()


def test_parts_behind_a_link_are_read_and_never_collected(dataset, episode, tmp_path):
    root = dataset("ds")
    add(root, [episode("t", seed=1, point_cloud=put_cloud(root, np.eye(3)))])
    write_part(root, [episode("later", seed=2, point_cloud=put_cloud(root, np.ones((3, 3))))], {})
    (root / "parts").rename(tmp_path / "disk")
    (root / "parts").symlink_to(tmp_path / "disk")
    before = sorted(path.name for path in (*(tmp_path / "disk").iterdir(), *(root / "objects").iterdir()))
    done = collect_garbage(root, grace_s=0)
    assert sorted(path.name for path in (*(tmp_path / "disk").iterdir(), *(root / "objects").iterdir())) == before
    assert any("is a link, which is not followed" in note for note in done.notes)
    assert check(open_dataset(root), rules=WHOLE, deep=True) == ()
    compact_dataset(root)
    assert open_dataset(root).ids == ("a", "b", "c", "d", "t")


def test_parts_on_another_disk_are_refused_in_one_message(dataset, episode, tmp_path):
    other = Path("/dev/shm")
    root = dataset("ds")
    if not other.is_dir() or not os.access(other, os.W_OK) or other.stat().st_dev == root.stat().st_dev:
        pytest.skip("no second file system")
    disk = other / f"candata-{os.getpid()}"
    shutil.copytree(root / "parts", disk)
    try:
        shutil.rmtree(root / "parts")
        (root / "parts").symlink_to(disk)
        assert len(list(open_dataset(root))) == 4
        with pytest.raises((OSError, SetupError)) as error:
            add(root, [episode("z", seed=5)])
        assert "Traceback" not in str(error.value)
        assert open_dataset(root).ids == ("a", "b", "c", "d")
        assert list((root / "staging").iterdir()) == []
    finally:
        shutil.rmtree(disk)


def test_a_link_that_leads_nowhere_is_said(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "unmounted")
    with pytest.raises(UsageError, match="a link that leads nowhere"):
        create_dataset(tmp_path / "link")
    assert not (tmp_path / "unmounted").exists()
