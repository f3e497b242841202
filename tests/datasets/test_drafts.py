"""What is made beside its place: whole or absent, and no draft of a killed process stays for ever."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from candata.datasets import drafts
from candata.datasets.drafts import draft_beside, place
from candata.errors import UsageError

LEFT = ".old.candata-" + "a" * 32
KILLED = """
import os, signal, sys
from pathlib import Path
from candata.datasets.drafts import draft_beside
with draft_beside(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_draft_takes_its_place_whole(tmp_path):
    out = tmp_path / "deep" / "out"
    with draft_beside(out) as folder:
        assert not out.exists()
        (folder / "new").mkdir()
        place(folder / "new", out)
    assert names(out.parent) == ["out"]


def test_what_a_killed_process_left_goes_with_the_next_draft(tmp_path):
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "out")], check=False)
    assert done.returncode == -signal.SIGKILL
    assert len(names(tmp_path)) == 1
    with draft_beside(tmp_path / "another"):
        assert [name.split(".candata-")[0] for name in names(tmp_path)] == [".another"]
    assert names(tmp_path) == []


def test_what_a_thread_still_writes_after_a_failure_goes_too(tmp_path, monkeypatch):
    waits = []

    def late(pause_s):
        waits.append(pause_s)
        if len(waits) == 1:
            assert names(tmp_path) == []
            (folder / "deep").mkdir(parents=True)
            (folder / "deep" / "late").write_text("late")

    monkeypatch.setattr(drafts.durable.time, "sleep", late)
    with pytest.raises(OSError, match="full"), draft_beside(tmp_path / "out") as folder:
        raise OSError("full")
    assert names(tmp_path) == []
    assert waits == list(drafts.durable.LATE_S)


def test_a_draft_in_use_and_what_is_no_draft_stay(tmp_path):
    (tmp_path / ".old.mine").mkdir()
    (tmp_path / LEFT).write_text("a file")
    with draft_beside(tmp_path / "out") as first:
        with draft_beside(tmp_path / "out"):
            pass
        assert first.is_dir()
    assert names(tmp_path) == [LEFT, ".old.mine"]


def test_where_folders_cannot_be_locked_no_draft_is_taken_away(tmp_path, monkeypatch):
    def refuse(*_arguments):
        raise OSError(9, os.strerror(9))

    monkeypatch.setattr(drafts.fcntl, "flock", refuse)
    (tmp_path / LEFT).mkdir()
    with draft_beside(tmp_path / "out") as folder:
        assert folder.is_dir()
    assert names(tmp_path) == [LEFT]


def test_a_name_that_was_taken_meanwhile_is_refused(tmp_path):
    out = tmp_path / "out"
    with draft_beside(out) as folder:
        (folder / "new").mkdir()
        (out / "theirs").mkdir(parents=True)
        with pytest.raises(UsageError, match="exists already"):
            place(folder / "new", out)
    assert names(tmp_path) == ["out"]
    assert names(out) == ["theirs"]
