"""A blind run for people: rows below target first in the text, a page that holds everything it shows."""

from __future__ import annotations

import re

import pytest

from candata.reports.bench import bench_page, bench_text, mark_text, target_text, value_text, write_bench
from candata.reports.heat import confusion
from candata.schema.bench import BenchFile, BenchRow, Bin, Miss

ROWS = (
    BenchRow(measure="one effect: first", value=80.0, n=40, low=95),
    BenchRow(measure="null: an effect named", value=0.0, n=10, high=3),
    BenchRow(measure="one effect: and nothing else", value=75.0, n=40),
)
MISS = Miss(case="case-0003", kind="one", truth="a<b>", verdict="no_gap", named="-", why="not first", gap=1.2345)


@pytest.fixture
def bench() -> BenchFile:
    method = BenchFile(
        scene="s",
        cases=50,
        done=50,
        rows=ROWS,
        misses=(MISS,),
        confusion={"a<b>": {"no_gap": 1}, "other": {"other": 3}},
        calibration=(Bin(support=0.7, right=0.6, n=10), Bin(support=0.95, right=0.9, n=10)),
    )
    return method.model_copy(update={"baselines": (method, method.model_copy(update={"method": "oracle"}))})


def test_the_text_says_measured_n_and_target_then_the_misses(bench):
    lines = bench_text(bench).splitlines()
    assert lines[0] == "s: 50 of 50 cases, 1 missed"
    assert lines[3].split() == ["one", "effect:", "first", "80.0", "%", "40", ">=", "95", "%", "MISSED"]
    assert lines[4].split()[-1] == "met"
    miss_line = next(line for line in lines if line.startswith("case-0003"))
    assert miss_line.split() == ["case-0003", "one", "a<b>", "no_gap", "-", "1.23", "not", "first"]
    assert "oracle" in next(line for line in lines if line.startswith("measure ("))


def test_the_page_is_self_contained_and_escapes_what_it_shows(bench, tmp_path):
    page = write_bench(bench, tmp_path).read_text()
    assert page == bench_page(bench)
    assert "1 of 2 targets met" in page
    assert "a&lt;b&gt;" in page
    assert '<script src="' not in page
    assert BenchFile.model_validate_json((tmp_path / "bench.json").read_text()) == bench


def test_rows_that_need_a_word_are_explained_where_they_are(bench):
    honest = BenchRow(measure="log score of support, silence counted", value=0.5, n=4, unit="")
    page = bench_page(bench.model_copy(update={"rows": (*ROWS, honest)}))
    assert "each of an ambiguous class of n 1/n" in page
    assert "over the deviation" not in page
    assert "How to read" not in bench_page(bench)


def test_a_confusion_map_puts_right_names_on_its_diagonal():
    table = confusion({"a": {"b": 1, "a": 3}, "b": {"b": 2}, "none": {"no_gap": 4}})
    assert re.findall(r'<th scope="col">(\w+)</th>', table) == ["a", "b", "no_gap"]
    rows = [re.findall(r"<td[^>]*>([^<]*)</td>", row) for row in re.findall(r'<th scope="row">.*?</tr>', table, re.S)]
    assert rows == [["3", "1", ""], ["", "2", ""], ["", "", "4"]]
    assert re.findall(r'class="(s\d)" title="hidden a, said (\w): (\d of \d)"', table) == [
        ("s3", "a", "3 of 4"),
        ("s1", "b", "1 of 4"),
    ]


def test_each_bin_of_the_calibration_shows_its_numbers(bench):
    page = bench_page(bench)
    assert "stated 0.70, right 0.60 of 10" in page
    assert "stated 0.95, right 0.90 of 10" in page


@pytest.mark.parametrize("width", [1280, 380])
def test_the_page_fits(browse, bench, width):
    names = [f"an_effect_with_quite_a_long_name_{k}" for k in range(30)]
    large_bench = bench.model_copy(update={"confusion": {name: {name: 3, "no_gap": 1} for name in names}})
    count = """() => ({ cells: document.querySelectorAll(".confusion tbody td").length })"""
    assert browse(bench_page(large_bench), count, width) == {"cells": 30 * 31}


def test_units_and_targets_in_words():
    assert value_text(BenchRow(measure="m", value=None, n=0)) == "-"
    assert value_text(BenchRow(measure="m", value=0.0421, n=9, unit="")) == "0.042"
    assert target_text(BenchRow(measure="m", value=1, n=1, low=85, high=95)) == "85 to 95 %"
    assert target_text(BenchRow(measure="m", value=1, n=1, high=20, unit="s")) == "<= 20 s"
    assert target_text(BenchRow(measure="m", value=1, n=1)) == ""
    assert mark_text(BenchRow(measure="m", value=1, n=1, low=-2, high=2, interval=(0.5, 1.51))) == "met (0.5 to 1.5)"
    assert mark_text(BenchRow(measure="m", value=3, n=1, high=2)) == "MISSED"
