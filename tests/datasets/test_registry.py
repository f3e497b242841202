"""Names for datasets and remotes, in one file that no process and no damage may lose."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from candata.datasets import open_dataset
from candata.datasets.registry import (
    add_dataset,
    add_remote,
    read_registry,
    registry_path,
    remove_dataset,
    remove_remote,
    resolve,
)
from candata.errors import DataError, SetupError, UnknownNameError, UsageError
from candata.schema.registry import RemoteEntry


@pytest.fixture(autouse=True)
def own_registry(tmp_path, monkeypatch):
    monkeypatch.setenv("CANDATA_REGISTRY", str(tmp_path / "home/registry.json"))


def test_the_file_lies_in_the_users_data_folder(monkeypatch, tmp_path):
    monkeypatch.delenv("CANDATA_REGISTRY")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert registry_path() == tmp_path / "candata/registry.json"


def test_a_name_stands_for_a_folder_wherever_one_is(dataset, tmp_path, monkeypatch):
    root = dataset("ds")
    add_dataset("mine", root)
    monkeypatch.chdir(tmp_path / "home")
    digest = open_dataset(root).digest
    assert resolve("mine") == (root, None)
    assert resolve("mine@1") == (root, 1)
    assert resolve(f"mine@{digest[:8]}") == (root, digest[:8])
    assert resolve(f"{root}@clean") == (root, "clean")
    assert open_dataset(*resolve(f"mine@{digest[:8]}")).digest == digest


def test_a_folder_comes_before_a_name(dataset, tmp_path, monkeypatch):
    add_dataset("two", dataset("one"))
    dataset("two")
    monkeypatch.chdir(tmp_path)
    assert resolve("two")[0].resolve() == tmp_path / "two"


def test_a_folder_whose_name_holds_an_at_is_a_folder(dataset, tmp_path):
    root = dataset("a@1")
    assert resolve(str(root)) == (root, None)
    assert resolve(f"{root}@2") == (root, 2)


def test_what_is_neither_lists_the_names_and_the_nearest(dataset):
    add_dataset("recordings", dataset("ds"))
    with pytest.raises(UnknownNameError, match="did you mean 'recordings'"):
        resolve("recordngs@3")


def test_the_same_twice_is_no_change_and_another_is_refused(dataset):
    one = dataset("one")
    add_dataset("a", one)
    add_dataset("a", one)
    assert read_registry().datasets == {"a": str(one)}
    with pytest.raises(UsageError, match="is taken"):
        add_dataset("a", dataset("two"))
    remove_dataset("a")
    assert read_registry().datasets == {}
    with pytest.raises(UnknownNameError, match="dataset"):
        remove_dataset("b")


@pytest.mark.parametrize("name", ["", "a/b", "..", ".hidden", "a b", "x" * 101, "con", "a@b", "nul.txt", "ü"])
def test_a_name_that_could_be_a_path_is_refused(dataset, name):
    with pytest.raises(UsageError, match="not a name"):
        add_dataset(name, dataset("ds"))


def test_a_folder_without_a_dataset_is_refused(tmp_path):
    with pytest.raises(UsageError, match="not a dataset"):
        add_dataset("a", tmp_path)
    assert not registry_path().exists()


def test_remotes_are_kept_beside_and_hold_no_credential(monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "hush")
    entry = RemoteEntry(url="s3://bucket/x", endpoint="http://localhost:9000", allow_http=True)
    add_remote("own", entry)
    add_remote("own", entry)
    assert read_registry().remotes == {"own": entry}
    assert "hush" not in registry_path().read_text()
    with pytest.raises(UsageError, match="stands already"):
        add_remote("own", RemoteEntry(url="/elsewhere"))
    remove_remote("own")
    with pytest.raises(UnknownNameError, match="remote"):
        remove_remote("own")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "no valid JSON"),
        ("[]", "not valid"),
        ('{"registry_version": 99, "shelves": {}}', "newer"),
        ('{"datasets": {"a": 3}}', "not valid"),
        ("[" * 100_000, "no valid JSON"),
    ],
)
def test_a_damaged_registry_is_named_and_never_overwritten(dataset, text, words):
    registry_path().parent.mkdir()
    registry_path().write_text(text)
    with pytest.raises(DataError, match=words):
        add_dataset("a", dataset("ds"))
    with pytest.raises(DataError, match=words):
        resolve("a")
    assert registry_path().read_text() == text
    assert resolve(str(dataset("paths-still-work")))[1] is None


def test_a_folder_that_cannot_be_written_is_named(dataset, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("CANDATA_REGISTRY", str(tmp_path / "file/registry.json"))
    with pytest.raises((SetupError, DataError), match="registry cannot be"):
        add_dataset("a", dataset("ds"))


def test_processes_that_change_it_at_once_lose_nothing(tmp_path):
    code = (
        "import sys\n"
        "from candata.datasets.registry import add_remote\n"
        "from candata.schema.registry import RemoteEntry\n"
        "for i in range(20): add_remote(f'{sys.argv[1]}{i}', RemoteEntry(url='/x'))\n"
    )
    running = [subprocess.Popen([sys.executable, "-c", code, name]) for name in "abc"]
    assert [process.wait() for process in running] == [0, 0, 0]
    assert sorted(read_registry().remotes) == sorted(f"{name}{i}" for name in "abc" for i in range(20))
    assert json.loads(registry_path().read_text())["registry_version"] == 1
    assert [p.name for p in registry_path().parent.iterdir() if p.name.startswith(".")] == []


def test_ctrl_c_leaves_no_draft_of_the_registry(dataset, tmp_path, monkeypatch):
    root, file = dataset("ds"), tmp_path / "names" / "registry.json"
    monkeypatch.setenv("CANDATA_REGISTRY", str(file))
    add_dataset("first", root)
    before = file.read_bytes()

    def stopped(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as during:
        during.setattr(os, "replace", stopped)
        with pytest.raises(KeyboardInterrupt):
            add_dataset("second", root)
    assert file.read_bytes() == before
    assert {path.name for path in file.parent.iterdir()} == {"registry.json", "registry.json.lock"}
