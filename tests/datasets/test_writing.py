"""Single files that several write at once, or that nobody can write."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from candata.datasets.writing import replacing, write_text
from candata.errors import SetupError

pytestmark = pytest.mark.hard


def test_a_file_that_several_write_at_once_is_always_one_of_theirs(tmp_path):
    path = tmp_path / "deep" / "page.html"
    texts = {letter * 300_000 for letter in "abcdefgh"}
    write_text(path, "a" * 300_000)
    with ThreadPoolExecutor(8) as threads:
        writing = [threads.submit(write_text, path, text) for text in texts for _ in range(10)]
        while not all(one.done() for one in writing):
            assert path.read_text() in texts
    assert [one.result() for one in writing] == [path] * 80
    assert [one.name for one in path.parent.iterdir()] == ["page.html"]


def test_what_fails_leaves_the_old_file_and_no_draft(tmp_path):
    path = write_text(tmp_path / "page.html", "old")

    def fail():
        with replacing(path) as draft:
            draft.write_text("half")
            raise OSError(28, "No space left on device")

    with pytest.raises(SetupError, match="the page cannot be written"):
        fail()
    assert path.read_text() == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]


def test_a_folder_that_is_none_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SetupError, match="the page cannot be written"):
        write_text(tmp_path / "file" / "page.html", "new")


def test_a_file_has_the_rights_of_new_files_whatever_its_writer_gave(tmp_path):
    umask = os.umask(0o027)
    try:
        with replacing(tmp_path / "page.html") as draft:
            draft.touch(0o600)
    finally:
        os.umask(umask)
    assert (tmp_path / "page.html").stat().st_mode & 0o777 == 0o640


def test_ctrl_c_leaves_the_old_file_and_no_draft(tmp_path):
    path = write_text(tmp_path / "page.html", "old")

    def stop():
        with replacing(path) as draft:
            draft.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop()
    assert path.read_text() == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]


def test_a_folder_that_was_moved_away_is_not_made_anew(tmp_path):
    with pytest.raises(SetupError, match="the page cannot be written"), replacing(tmp_path / "a/page", parents=False):
        pass
    assert list(tmp_path.iterdir()) == []
