"""What a folder cannot do is found, said and nothing of it stays behind."""

from __future__ import annotations

import errno
import os
import shutil

import pytest

from candata.datasets import kill_test, probe
from candata.errors import SetupError, UsageError


def probes(path, **options):
    return {one.name: one for one in probe.probe_folder(path, **{"kills": 0} | options)}


def test_a_local_folder_does_what_is_needed(tmp_path):
    found = probes(tmp_path)
    assert [name for name, one in found.items() if one.ok is not True] == ["kill test"]
    assert found["kill test"].ok is None
    assert list(tmp_path.iterdir()) == []


def test_the_kill_test_runs_and_leaves_nothing(tmp_path, monkeypatch):
    heard = []

    def test(folder, *, kills):  # the real one has its own tests
        (folder / "dataset").mkdir()
        return kill_test.KillResult(kills, 5, 0, 0, (), 5)

    monkeypatch.setattr(probe, "kill_test", test)
    found = probes(tmp_path, kills=1, progress=heard.append)["kill test"]
    assert found.ok is True
    assert found.found == ("1 kills, 3 writers at once: 5 episodes acknowledged, 0 lost, 0 doubled, 0 files damaged")
    assert heard[-1] == "kill test"
    assert list(tmp_path.iterdir()) == []


def no_links(*_):
    raise OSError(errno.EPERM, "Operation not permitted")


def link_that_replaces(source, target):
    shutil.copy(source, target)


def no_sync(_):
    raise OSError(errno.EINVAL, "Invalid argument")


def rename_that_replaces(source, target):
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target)
    shutil.rmtree(source)


@pytest.mark.parametrize(
    ("place", "name", "stand_in", "failed", "words"),
    [
        (os, "link", no_links, "exclusive creation", "no hard links"),
        (os, "link", link_that_replaces, "exclusive creation", "8 got it"),
        (os, "rename", rename_that_replaces, "rename of folders", "replaced"),
        (os, "fsync", no_sync, "fsync", "refused: Invalid argument"),
        (probe.time, "time", lambda: 4e9, "clock", "behind this host"),
    ],
)
def test_what_a_share_lacks_is_named(tmp_path, monkeypatch, place, name, stand_in, failed, words):
    monkeypatch.setattr(place, name, stand_in)
    monkeypatch.setattr(probe, "kill_test", lambda *_, **__: pytest.fail("it cannot work there"))
    found = probes(tmp_path, kills=0 if failed in ("fsync", "clock") else 3)
    assert [one.name for one in found.values() if one.ok is False] == [failed]
    assert words in found[failed].found
    assert found[failed].fix
    if failed not in ("fsync", "clock"):
        assert found["kill test"].found == "left out: the folder lacks what it needs"
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_finds_no_file_is_told(tmp_path, monkeypatch):
    real = probe.Path.replace

    def slow(self, target):
        if self.name == "draft":
            target.unlink(missing_ok=True)
            probe.time.sleep(0.002)
        return real(self, target)

    monkeypatch.setattr(probe.Path, "replace", slow)
    assert probes(tmp_path)["rename of files"].ok is False


def test_a_full_disk_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(probe, "LEAST_FREE_BYTES", 10**18)
    assert probes(tmp_path)["space"].ok is False


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    def refuse(self, *_, **__):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(probe.Path, "mkdir", refuse)
    found = probes(tmp_path)
    assert (found["write"].ok, found["write"].found) == (False, "Permission denied")
    assert list(found) == ["space", "write"]


def test_a_kill_test_that_fails_is_a_finding(tmp_path, monkeypatch):
    lost = kill_test.KillResult(1, 5, 2, 0, (), 1)
    monkeypatch.setattr(probe, "kill_test", lambda *_, **__: lost)
    assert probes(tmp_path, kills=1)["kill test"].ok is False

    def ends(*_, **__):
        raise SetupError("a process of the kill test (append) ended by itself")

    monkeypatch.setattr(probe, "kill_test", ends)
    assert "ended by itself" in probes(tmp_path, kills=1)["kill test"].found
    assert list(tmp_path.iterdir()) == []


def test_no_folder_is_a_wrong_argument(tmp_path):
    with pytest.raises(UsageError, match="not a folder"):
        probe.probe_folder(tmp_path / "none")
