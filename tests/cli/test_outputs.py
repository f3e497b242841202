"""Outputs are tried before any work: the error comes before a scene is compiled or an episode read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from candata.datasets import create_dataset
from candata.errors import SetupError, UsageError
from candata_cli.outputs import check_output
from tests.cli.command import run

#: What comes after the output, none of which is there: an error about it would mean that work had begun.
NOWHERE = "nowhere"
DIAGNOSE = ("diagnose", NOWHERE, "--scene", NOWHERE)
GENERATE = ("generate-sim", "--scene", NOWHERE, "--episodes", 2)
#: Commands that write a folder of files, a new thing, or a file, without the path.
FOLDERS = (
    (*DIAGNOSE, "--out"),
    ("train", "--data", NOWHERE, "--out"),
    ("evaluate", NOWHERE, NOWHERE, "--out"),
    ("gap", "bench", "--scene", NOWHERE, "--out"),
    ("gap", "score", NOWHERE, "--labels", NOWHERE, "--out"),
    ("gap", "signatures", NOWHERE, "--scene", NOWHERE, "--cache-dir"),
    ("demo", "--out"),
    ("scene", "servo", "--dataset", NOWHERE, "--out"),
)
NEW = (
    ("import", "table", NOWHERE, "--out"),
    ("import", "log", NOWHERE, "--out"),
    ("export", "lerobot", NOWHERE, "--out"),
    ("fetch", "cube-tosses", "--from", NOWHERE, "--out"),
    ("registry", "merge", NOWHERE, NOWHERE, "--out"),
    ("registry", "filter", NOWHERE, "rows > 1", "--out"),
    ("registry", "cut", NOWHERE, "--length-s", 1, "--out"),
    ("registry", "relabel", NOWHERE, "--set", "task=a", "--out"),
    ("record-real", "--port", NOWHERE, "--out"),
    ("scene", "export", "--effects", NOWHERE, "--out"),
    ("scene", "object", "add", NOWHERE, "--mass", 1, "--out"),
)
DATASETS = ((*GENERATE, "--out"), ("registry", "pull", NOWHERE, NOWHERE, "--out"))
FILES = (
    ("validate", NOWHERE, "--html"),
    ("inspect", NOWHERE, "--html"),
    ("view", NOWHERE, "--out"),
    ("scene", "show", NOWHERE, "--out"),
)


@pytest.fixture
def dataset(tmp_path) -> Path:
    return create_dataset(tmp_path / "recordings")


def left(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@pytest.mark.parametrize("command", [*FOLDERS, *NEW, *DATASETS, *FILES], ids=lambda c: " ".join(map(str, c[:2])))
def test_no_output_may_lie_in_a_dataset(dataset, command):
    before = left(dataset)
    done = run(*command, dataset / "deep" / "one")
    option = command[-1]
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        f"{option} {dataset}/deep/one lies in a dataset\n"
        "  expected: a place outside of it: a dataset holds nothing but its own files\n"
        f"  found: the dataset {dataset}\n"
        f"  do: choose another {option}\n"
    )
    assert left(dataset) == before


@pytest.mark.parametrize("command", FOLDERS, ids=lambda c: " ".join(map(str, c[:2])))
def test_a_folder_is_no_file_and_no_dataset(dataset, tmp_path, command):
    (tmp_path / "file").write_text("mine")
    done = run(*command, tmp_path / "file")
    assert (done.code, done.err.splitlines()[0]) == (2, f"{command[-1]} {tmp_path}/file is a file")
    assert run(*command, dataset).err.startswith(f"{command[-1]} {dataset} lies in a dataset\n")


@pytest.mark.parametrize("command", NEW, ids=lambda c: " ".join(map(str, c[:2])))
def test_what_is_new_does_not_stand(dataset, tmp_path, command):
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    for standing in (dataset, tmp_path / "link"):
        done = run(*command, standing)
        assert (done.code, done.err.splitlines()[0]) == (2, "the output exists already")


@pytest.mark.parametrize("command", DATASETS, ids=lambda c: " ".join(map(str, c[:2])))
def test_a_dataset_is_no_folder_of_something_else(tmp_path, command):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "notes.txt").write_text("mine")
    assert run(*command, tmp_path / "folder").err.startswith("the folder is not empty and no dataset\n")


@pytest.mark.parametrize("command", FILES, ids=lambda c: " ".join(map(str, c[:2])))
def test_a_file_is_no_folder_and_no_device(tmp_path, command):
    assert run(*command, tmp_path).err.startswith(f"{command[-1]} {tmp_path} is a folder\n")
    assert run(*command, "/dev/null").err.startswith(f"{command[-1]} /dev/null is a device\n")


def test_what_is_appended_to_is_a_dataset(tmp_path):
    (tmp_path / "empty").mkdir()
    done = run("import", "table", NOWHERE, "--out", tmp_path / "empty", "--append")
    assert (done.code, done.err.splitlines()[0]) == (2, "not a dataset")


def test_a_run_is_not_trained_into_other_things(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    done = run("train", "--data", NOWHERE, "--out", tmp_path)
    assert (done.code, done.err.splitlines()[0]) == (2, "the output folder holds something that is no run")


def test_a_sealed_file_lies_in_no_dataset(dataset, tmp_path):
    done = run(*GENERATE, "--out", tmp_path / "sim", "--withhold", "any", "--seal", dataset / "seal.json")
    assert (done.code, done.err.splitlines()[0]) == (2, f"--seal {dataset}/seal.json lies in a dataset")


@pytest.mark.parametrize("kind", ["folder", "file", "new", "dataset"])
def test_what_can_be_written_leaves_no_trace_of_the_trial(tmp_path, kind):
    check_output(tmp_path / "deep" / "one", kind)
    assert left(tmp_path) == set()


def test_relative_paths_and_what_stands_are_fine(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    Path("page.html").write_text("old")
    for path, kind in (("folder", "folder"), ("page.html", "file"), ("new", "new"), ("recordings", "dataset")):
        check_output(Path(path), kind)
    check_output(Path("recordings.seal.json"), "file")
    assert Path("page.html").read_text() == "old"


def test_a_file_of_the_name_of_a_datasets_makes_no_dataset(tmp_path):
    (tmp_path / "dataset.json").write_text("{}")
    check_output(tmp_path / "out", "folder")


@pytest.mark.parametrize(
    ("name", "found"), [("file/one", "Not a directory"), ("x" * 300, "File name too long"), ("a/" + "x" * 300, "long")]
)
def test_what_the_system_refuses_is_told_with_its_reason(tmp_path, name, found):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(SetupError, match=f"cannot be written\n  found: .*{found}"):
        check_output(tmp_path / name, "folder")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_the_right_to_write_is_refused(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o555)
    with pytest.raises(SetupError, match="Permission denied"):
        check_output(tmp_path / "locked" / "deep" / "one", "folder")


def test_a_folder_of_the_system_is_refused():
    with pytest.raises(SetupError, match="/proc/one cannot be written"):
        check_output(Path("/proc/one"), "new")


def test_a_link_that_leads_nowhere_is_no_folder(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "gone")
    with pytest.raises(UsageError, match="is a link that leads nowhere"):
        check_output(tmp_path / "link", "folder")


def test_a_link_into_a_dataset_lies_in_it(dataset, tmp_path):
    (tmp_path / "link").symlink_to(dataset)
    with pytest.raises(UsageError, match="lies in a dataset"):
        check_output(tmp_path / "link" / "report", "folder")
