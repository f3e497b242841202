"""Charts: where things are drawn, and what happens to values that cannot be."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup

from candata.reports.chart import Axis, chart, dots, line, linear_axis, log_axis, tooltip_strips

NUMBERS = st.floats(-1e9, 1e9)


@given(st.lists(NUMBERS, max_size=20))
def test_a_linear_axis_holds_its_values_and_its_ticks(values):
    axis = linear_axis(values)
    assert axis.low < axis.high
    assert all(0 <= axis.share(v) <= 1 for v in values)
    assert all(-1e-9 <= axis.share(v) <= 1 + 1e-9 for v, _ in axis.ticks)
    assert 1 <= len(axis.ticks) <= 8


@given(st.lists(st.floats(1e-6, 1e9), max_size=20))
def test_a_logarithmic_axis_holds_its_values(values):
    axis = log_axis(values)
    assert all(-1e-9 <= axis.share(v) <= 1 + 1e-9 for v in values)
    assert len(axis.ticks) <= 17


def test_ticks_are_round_numbers():
    assert [text for _, text in linear_axis([0.0, 0.37], 4, " s").ticks] == ["0 s", "0.1 s", "0.2 s", "0.3 s"]
    assert [text for _, text in log_axis([1.0, 6.0]).ticks] == ["1", "2", "5"]


def test_a_line_breaks_where_a_value_is_missing():
    unit = Axis(0.0, 1.0, ())
    markup = line(unit, unit, [0.0, 0.5, 0.6, 1.0], [0.0, 1.0, math.nan, 0.5], "x")
    assert re.search(r'd="([^"]*)"', markup).group(1) == "M0 1000l500 -1000M1000 500h0"
    assert line(unit, unit, [0.0], [math.nan], "x") == ""


def test_a_dot_far_outside_stays_beside_the_chart():
    unit = Axis(0.0, 1.0, ())
    assert 'd="M1050 -50h0"' in dots(unit, unit, [9.0], [9.0], "x")


def test_a_strip_reaches_half_way_to_its_neighbours_and_escapes_its_text():
    markup = tooltip_strips(Axis(0.0, 1.0), [0.2, 0.4, 0.8], ["a<b", "c", "d"])
    assert re.findall(r'd="M(-?\d+) 0H(-?\d+)V', markup) == [("-50", "300"), ("300", "600"), ("600", "1050")]
    assert "<title>a&lt;b</title>" in markup


@pytest.mark.parametrize("values", [[], [math.nan], [math.inf], [0.0, 0.0]])
def test_an_axis_of_nothing_can_be_drawn(values):
    axis = linear_axis(values)
    assert "nan" not in chart(axis, axis, Markup(""), "nothing", 80)
