"""Whatever names a remote holds, a pull writes nothing outside its folder and says what is wrong."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.datasets.names import require_files
from candata.datasets.pull import pull
from candata.datasets.push import push
from candata.datasets.remotes import object_key, open_remote, read_key, version_key
from candata.errors import CandataError, DataError, SetupError, UsageError
from candata.schema.registry import RemoteEntry

from .conftest import s3_entry

pytestmark = pytest.mark.hard

NAME = "rich"


@pytest.fixture(scope="module")
def share(rich_once, tmp_path_factory) -> Path:
    """A folder that the dataset was pushed to."""
    folder = tmp_path_factory.mktemp("pushed")
    push(rich_once, open_remote(RemoteEntry(url=str(folder))), NAME)
    return folder


@pytest.fixture
def pushed(share, tmp_path):
    """A copy of it: names are checked before a store is asked for anything, and one test below asks S3 too."""
    return open_remote(RemoteEntry(url=str(shutil.copytree(share, tmp_path / "share"))))


def snapshot(folder: Path) -> set[str]:
    """Everything under a folder, the folder of the remote left out."""
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if "share" not in p.relative_to(folder).parts}


def write(store, key: str, value: object) -> bytes:
    data = json.dumps(value).encode()
    store.write(key, [data], len(data))
    return data


def change_version(store, change: Callable[[dict], None]) -> None:
    """Change version 2 of the remote."""
    record = json.loads(read_key(store, version_key(NAME, 2)))
    change(record)
    write(store, version_key(NAME, 2), record)


def change_part(store, change: Callable[[dict], None]) -> None:
    """Change a part's manifest and make all hashes agree with it."""

    def rewrite(record: dict) -> None:
        entry = record["version"]["parts"][0]
        part = json.loads(read_key(store, object_key(NAME, entry["sha256"])))
        change(part)
        data = json.dumps(part).encode()
        entry["sha256"] = hashlib.sha256(data).hexdigest()
        store.write(object_key(NAME, entry["sha256"]), [data], len(data))

    change_version(store, rewrite)


PATHS = [
    "../../evil",
    "/tmp/evil",
    "..",
    "a/../../evil",
    "a\\..\\evil",
    "C:\\evil",
    "a\x00b",
    "nul",
    "com1.txt",
    "STEPS.parquet",
    "part.json",
    "",
    "a//b",
    "./a",
    "a/",
    "~/evil",
    "a.",
    "x" * 200,
    "/".join("abcdefghij"),
    "steps.parquet/inside",
    "-rf",
    "a\nb",
    "ａ",
]


@pytest.mark.parametrize("path", PATHS)
def test_a_file_of_a_part_with_a_hostile_name(pushed, tmp_path, path):
    change_part(pushed, lambda part: part["files"].append({**part["files"][0], "path": path}))
    before = snapshot(tmp_path)
    with pytest.raises(DataError, match=r"name|folder"):
        pull(pushed, NAME, tmp_path / "out")
    assert snapshot(tmp_path) == before


def test_hostile_names_on_s3(rich, s3_server, monkeypatch, tmp_path):
    store = open_remote(s3_entry(s3_server, monkeypatch, "hostile"))
    push(rich, store, NAME)
    change_part(store, lambda part: part["files"].append({**part["files"][0], "path": "../../evil"}))
    before = snapshot(tmp_path)
    with pytest.raises(DataError, match="name that cannot be kept"):
        pull(store, NAME, tmp_path / "out")
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("bad", ["../" * 5 + "evil", "/abs", "", "0" * 31, "G" * 32, "A" * 32])
def test_a_part_with_a_hostile_id(pushed, tmp_path, bad):
    change_version(pushed, lambda record: record["version"]["parts"][0].update(id=bad))
    with pytest.raises(DataError, match="not the id of a part"):
        pull(pushed, NAME, tmp_path / "out")
    assert not (tmp_path / "out").exists()


CLOUDS = ["../objects/x.parquet", "objects/../../evil.parquet", "/e.parquet", "objects/evil.txt"]


@pytest.mark.parametrize("bad", CLOUDS)
def test_a_cloud_with_a_hostile_name(pushed, tmp_path, bad):
    change_version(pushed, lambda record: record["clouds"][0].update(path=bad))
    with pytest.raises(DataError):
        pull(pushed, NAME, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("field", ["sha256", "bytes"])
@pytest.mark.parametrize("value", ["../x", -1, "0" * 63, None, 10**40])
def test_a_hash_or_size_that_is_none(pushed, tmp_path, field, value):
    change_part(pushed, lambda part: part["files"][0].update({field: value}))
    with pytest.raises((DataError, SetupError)):
        pull(pushed, NAME, tmp_path / "out")
    assert not (tmp_path / "out" / "versions").exists()


def test_a_size_beyond_the_disk_is_said_before_anything_is_fetched(pushed, tmp_path):
    size = shutil.disk_usage(tmp_path).free
    files: list[dict] = []
    change_part(pushed, lambda part: (part["files"][0].update(bytes=size), files.extend(part["files"])))
    os.truncate(tmp_path / "share" / object_key(NAME, files[0]["sha256"]), size)  # a hole: it takes no room
    with pytest.raises(SetupError, match="no room"):
        pull(pushed, NAME, tmp_path / "out")


def test_a_version_whose_digest_is_another(pushed, tmp_path):
    change_version(pushed, lambda record: record["version"].update(exclusions=["a"]))
    with pytest.raises(DataError, match="digest"):
        pull(pushed, NAME, tmp_path / "out")


def test_a_version_under_another_number(pushed, tmp_path):
    change_version(pushed, lambda record: record["version"].update(number=7))
    with pytest.raises(DataError, match="version 7"):
        pull(pushed, NAME, tmp_path / "out")


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b"null"], ids=range(6))
@pytest.mark.parametrize("key", ["versions/000002.json", "dataset.json", "tags/clean.json", "splits/default.json"])
def test_a_file_that_holds_something_else(pushed, tmp_path, key, data):
    pushed.write(f"{NAME}/{key}", [data], len(data))
    with pytest.raises(DataError, match=key.replace(".", r"\.")):
        pull(pushed, NAME, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_newer_format_is_said(pushed, tmp_path):
    write(pushed, f"{NAME}/dataset.json", {"format_version": 99, "new": 1})
    with pytest.raises(DataError, match="newer format"):
        pull(pushed, NAME, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["con.json", "Default.json"])
def test_a_split_with_a_hostile_name(pushed, tmp_path, name):
    entry = json.loads(read_key(pushed, f"{NAME}/splits/default.json"))
    write(pushed, f"{NAME}/splits/{name}", entry)
    with pytest.raises((DataError, UsageError), match="name"):
        pull(pushed, NAME, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["../rich", "/etc", "", "a/b", "rich\x00"])
def test_a_dataset_with_a_hostile_name_is_not_asked_for(pushed, rich, tmp_path, name):
    with pytest.raises(UsageError, match="not a name"):
        pull(pushed, name, tmp_path / "out")
    with pytest.raises(UsageError, match="not a name"):
        push(rich, pushed, name)


@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_a_link_pipe_or_folder_under_an_objects_name(pushed, tmp_path, kind):
    record = json.loads(read_key(pushed, version_key(NAME, 2)))
    path = tmp_path / "share" / object_key(NAME, record["clouds"][0]["sha256"])
    data = path.read_bytes()
    path.unlink()
    (tmp_path / "secret").write_bytes(data)
    make = {"link": lambda: path.symlink_to(tmp_path / "secret"), "pipe": lambda: os.mkfifo(path), "folder": path.mkdir}
    make[kind]()
    with pytest.raises(CandataError, match=path.name):
        pull(pushed, NAME, tmp_path / "out")
    assert not (tmp_path / "out/versions").exists()


@pytest.mark.parametrize("folder", ["parts", "staging", "objects", "versions"])
def test_a_target_whose_folder_leads_elsewhere(pushed, tmp_path, folder):
    (tmp_path / "elsewhere").mkdir()
    pull(pushed, NAME, tmp_path / "out", 1)
    path = tmp_path / "out" / folder
    if path.exists():
        path.rename(tmp_path / "elsewhere" / folder)
    else:
        (tmp_path / "elsewhere" / folder).mkdir()
    path.symlink_to(tmp_path / "elsewhere" / folder)
    before = snapshot(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match="leads out"):
        pull(pushed, NAME, tmp_path / "out")
    assert snapshot(tmp_path / "elsewhere") == before


@given(st.text(max_size=40))
def test_a_name_that_is_taken_stays_inside_its_folder(path):
    try:
        require_files([path], "x")
    except DataError:
        return
    target = os.path.normpath(f"/inside/{path}")
    assert target.startswith("/inside/")
    assert target == f"/inside/{path}"
