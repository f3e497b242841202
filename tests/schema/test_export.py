"""The committed JSON Schemas are what the records generate."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from candata.schema.export import documents, write

FOLDER = Path(__file__).resolve().parents[2] / "schemas"


def test_committed_schemas_have_not_drifted():
    committed = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}
    assert committed == documents(), "run: make schemas"


def test_writing_gives_the_documents(tmp_path):
    written = write(tmp_path / "new")
    assert {path.name: path.read_text(encoding="utf-8") for path in written} == documents()


@pytest.mark.parametrize("key", ["verdict", "effects", "class", "unknown", "ranking", "gap", "where"])
def test_every_key_of_a_report_is_required(key):
    assert key in json.loads(documents()["report.schema.json"])["required"]


def test_files_of_users_need_only_what_has_no_default():
    assert json.loads(documents()["scene.schema.json"])["required"] == ["model", "rate_hz"]
