"""Hashes agree with git and sha256sum; a download is whole or absent."""

import hashlib

import pytest

from candata.errors import DataError, SetupError
from candata.fetch._files import download, git_tree_hash, require_sha256


def test_the_tree_hash_is_git_s():
    # The first from `git mktree </dev/null`; the second: `a.txt` holding "a\n" beside `b` holding nothing.
    assert git_tree_hash({}) == "4b825dc642cb6eb9a060e54bf8d69288fbee4904"
    assert git_tree_hash({"b": b"", "a.txt": b"a\n"}) == TREE_OF_TWO


TREE_OF_TWO = "6bff7482577a841597f007fc40d8051273aec83c"


def test_a_file_with_the_hash_passes(tmp_path):
    file = tmp_path / "f"
    file.write_bytes(b"x")
    require_sha256(file, hashlib.sha256(b"x").hexdigest(), "get it again")


def test_another_file_or_none_is_refused(tmp_path):
    with pytest.raises(DataError, match="f is missing") as caught:
        require_sha256(tmp_path / "f", "0", "get it again")
    assert caught.value.fix == "get it again"
    (tmp_path / "f").write_bytes(b"x")
    with pytest.raises(DataError, match="f is not the published file") as caught:
        require_sha256(tmp_path / "f", "0", "get it again")
    assert caught.value.found == f"sha256 {hashlib.sha256(b'x').hexdigest()}"


def test_a_download_is_the_file(tmp_path):
    source, said = tmp_path / "source", []
    source.write_bytes(b"12" * 1_500_000)
    target = download(source.as_uri(), tmp_path / "cache" / "target", said.append)
    assert target.read_bytes() == source.read_bytes()
    assert said == [f"downloading {source.as_uri()}", "  1.0 MB", "  2.1 MB"]
    assert [path.name for path in target.parent.iterdir()] == ["target"]


def test_a_download_that_fails_leaves_nothing_and_names_the_way_out(tmp_path):
    with pytest.raises(SetupError, match="the download failed") as caught:
        download((tmp_path / "absent").as_uri(), tmp_path / "cache" / "target", lambda _line: None)
    assert caught.value.exit_code == 3
    assert "--from FOLDER" in caught.value.fix
    assert list((tmp_path / "cache").iterdir()) == []
