"""docs/measured.md and the table of README are what the records in benchmarks/results render to."""

from __future__ import annotations

import json
import re
import shutil

from tests.docs import pages
from tools import measured


def test_the_page_and_the_readme_are_the_records():
    fix = "run: python tools/measured.py"
    assert pages.read(measured.PAGE) == measured.page(), fix
    assert pages.read(pages.README) == measured.readme(pages.read(pages.README)), fix


def test_every_record_has_a_value_a_date_and_a_command():
    for section in measured.sections():
        for record in section.records():
            assert ("value" in record) != ("values" in record), record
            assert re.fullmatch(r"2\d{3}-\d{2}-\d{2}", record["date"]), record
            assert record.get("command", section.command), record


def test_bold_figures_and_only_these_are_misses():
    for section in measured.sections():
        for record in section.records():
            assert ("**" in measured.result(record)) <= bool(record.get("missed")), record


def levels(record):
    """Return the numbers of a record's interval."""
    return set(re.findall(r"\d+(?:\.\d+)?", record.get("interval", "")))


def test_a_headline_shows_numbers_of_its_section():
    for section in measured.sections():
        values = [record.get("values", record.get("value")) for record in section.records()]
        numbers = set(re.findall(r"\d+(?:\.\d+)?", json.dumps(values)))
        for record in section.records():
            if "headline" in record:
                assert set(re.findall(r"\d+(?:\.\d+)?", measured.headline_value(record))) <= numbers | levels(record), (
                    record
                )


def test_a_draw_of_the_bench_becomes_the_first_column(tmp_path, monkeypatch):
    monkeypatch.setattr(measured, "SELF_CHECK", tmp_path / "self_check.json")
    shutil.copy(measured.RESULTS / "01_the_self_check.json", measured.SELF_CHECK)
    rows = [
        {"measure": "one effect: first", "value": 90.0, "low": 95.0, "high": None, "unit": "%"},
        {"measure": "a new measure", "value": 0.0123, "low": None, "high": None, "unit": ""},
    ]
    measured.add_draw({"rows": rows}, "seed 9", "2026-12-01")
    block = next(b for b in json.loads(measured.SELF_CHECK.read_text())["blocks"] if "records" in b)
    records = {record["measure"]: record for record in block["records"]}
    assert block["columns"][:3] == ["measure", "seed 9", "seed 8"]
    assert list(records["one effect: first"]["values"].items())[:2] == [
        ("seed 9", "**90.0 %**"),
        ("seed 8", "117 of 120 (97.5 %)"),
    ]
    assert records["one effect: first"]["missed"] is True
    assert records["a new measure"]["values"] == {"seed 9": "0.012"}
