from __future__ import annotations

import numpy as np

from candata.reports.envelope import COLUMNS, envelope, runs, turning_rows


def test_a_short_trace_is_drawn_as_it_is():
    time, values = np.arange(5.0), np.array([1.0, 2.0, np.nan, 4.0, 5.0])
    xs, ys = envelope(time, values)
    assert xs == [0, 1, 2, 3, 4]
    assert np.array_equal(ys, values, equal_nan=True)


def test_a_single_wild_value_of_a_long_trace_stays(rng):
    values = rng.normal(size=100_000)
    values[54_321] = 1000.0
    xs, ys = envelope(np.arange(100_000) * 0.01, values)
    assert len(xs) == 2 * COLUMNS
    assert (max(ys), min(ys)) == (1000.0, values.min())
    assert abs(xs[int(np.argmax(ys))] - 543.21) < 1000 / COLUMNS


def test_no_line_crosses_a_gap():
    time = np.concatenate([np.arange(10), 100 + np.arange(10)]) * 0.01
    _, ys = envelope(time, np.ones(20))
    assert np.isnan(ys).sum() == 1
    long_time = np.concatenate([np.arange(5000), 9000 + np.arange(5000)]) * 0.01
    assert np.isnan(envelope(long_time, np.ones(10_000))[1]).any()
    gappy_values = np.where(np.arange(10_000) // 1000 == 5, np.nan, 1.0)
    assert np.isnan(envelope(np.arange(10_000) * 0.01, gappy_values)[1]).any()


def test_one_row_and_standing_time():
    assert envelope(np.zeros(1), np.ones(1)) == ([0.0], [1.0])


def test_runs():
    assert list(runs(np.array([True, False, True, True]))) == [(0, 1), (2, 4)]
    assert list(runs(np.zeros(3, bool))) == []


def test_a_path_keeps_its_farthest_points(rng):
    points = np.cumsum(rng.normal(size=(50_000, 3)), axis=0)
    points[777] = 1e4
    rows = turning_rows(points, 50)
    assert 777 in rows
    assert {0, 49_999} <= set(rows)
    assert len(rows) <= 6 * 50 + 2
    assert (np.diff(rows) > 0).all()


def test_a_path_breaks_where_rows_are_lost():
    points = np.zeros((5000, 3))
    points[1000:1100] = np.nan
    assert np.isnan(points[turning_rows(points, 20)]).any()
