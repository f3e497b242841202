from __future__ import annotations

import json

import pytest

from candata.datasets import create_dataset
from candata.errors import DataError, UsageError


def test_a_new_dataset_bears_its_folders_name_or_the_one_given(tmp_path):
    assert json.loads((create_dataset(tmp_path / "a" / "b") / "dataset.json").read_text())["name"] == "b"
    assert json.loads((create_dataset(tmp_path / "c", "other") / "dataset.json").read_text())["name"] == "other"


def test_an_existing_dataset_is_refused_unless_it_may_exist(tmp_path):
    root = create_dataset(tmp_path / "ds", "first")
    with pytest.raises(UsageError, match="exists already"):
        create_dataset(root)
    assert create_dataset(root, "second", exist_ok=True) == root
    assert json.loads((root / "dataset.json").read_text())["name"] == "first"


def test_a_folder_with_other_things_is_left_alone(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(UsageError, match=r"letter\.txt"):
        create_dataset(tmp_path, exist_ok=True)
    with pytest.raises(UsageError, match="not a folder"):
        create_dataset(tmp_path / "letter.txt")
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


def test_an_empty_folder_becomes_a_dataset(tmp_path):
    assert create_dataset(tmp_path) == tmp_path


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"format_version": 1}',
        '{"format_version": 9, "new": 1}',
        '{"format_version": "1"}',
        '{"format_version": 0}',
        '{"format_version": -1}',
        '{"format_version": true}',
        '{"format_version": 1.5}',
    ],
)
def test_a_damaged_or_newer_dataset_file_is_refused(tmp_path, text):
    root = create_dataset(tmp_path / "ds")
    (root / "dataset.json").write_text(text)
    with pytest.raises(DataError, match=r"dataset\.json"):
        create_dataset(root, exist_ok=True)
