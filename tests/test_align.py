"""Resampling in closed form: nothing is invented, nothing crosses a gap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from candata.align import MAX_GAP_PERIODS, clock_fit, grid, period_ns, resample
from candata.errors import DataError, UsageError
from candata.rotation import difference, exp

MS = 1_000_000
ROLES = ("state", "command", "measurement", "sample", "flag")
TIME = np.arange(50) * 12 * MS


def streams(least=1):
    """Irregular stamps with two values each."""
    steps = st.integers(least, 30).flatmap(lambda n: st.lists(st.integers(1, 40), min_size=n, max_size=n))
    return steps.flatmap(
        lambda s: st.tuples(
            st.just(np.cumsum(s) * MS), arrays.arrays(np.float64, (len(s), 2), elements=st.floats(-1e3, 1e3))
        )
    )


@pytest.mark.parametrize("role", ["state", "command"])
def test_the_stream_on_its_own_stamps_is_itself(role, rng):
    values = rng.normal(size=(50, 3))
    found = resample(TIME, values, TIME, role)
    assert np.array_equal(found.values, values)
    assert found.valid.all()


@pytest.mark.parametrize("role", ["measurement", "sample", "flag"])
def test_a_reading_belongs_to_the_step_that_it_falls_in(role, rng):
    values = rng.integers(0, 2, 50).astype(bool) if role == "flag" else rng.normal(size=50)
    found = resample(TIME, values, TIME + 1, role)  # [t_k-1 + 1, t_k + 1) holds reading k alone
    assert np.array_equal(found.values, values)
    assert found.valid.all()
    late = resample(TIME, values, TIME, role)  # [t_k-1, t_k) holds reading k - 1
    assert np.array_equal(late.values[1:], values[:-1])
    assert not late.valid[0]


@given(streams(), st.sampled_from(ROLES[:3]), st.floats(-100, 100))
def test_a_constant_stays_one(stream, role, constant):
    time, values = stream
    at = grid(int(time[0]), int(time[-1]), 80.0)
    found = resample(time, np.full_like(values, constant), at, role, max_gap_ns=1e12)
    assert (found.values[found.valid] == constant).all()


def test_a_line_at_half_steps_is_the_line():
    values = TIME[:, None] * np.array([1e-9, -3e-9])
    found = resample(TIME, values, TIME[:-1] + 6 * MS, "state")
    # Two products and a sum in float64 near 1: a few units in the last place.
    np.testing.assert_allclose(found.values, (values[:-1] + values[1:]) / 2, rtol=0, atol=1e-15)
    assert found.valid.all()


def test_a_command_holds_until_the_next():
    found = resample(TIME, np.arange(50.0), TIME[:-1] + 11 * MS, "command")
    assert found.values.tolist() == list(range(49))


def test_a_mean_is_that_of_the_step_before():
    time, at = np.arange(100) * 3 * MS, np.arange(1, 20) * 12 * MS
    found = resample(time, np.arange(100.0), at, "measurement")
    assert found.values.tolist() == [4 * k + 1.5 for k in range(19)]
    assert resample(time, np.arange(100.0), at, "sample").values.tolist() == [4 * k + 3 for k in range(19)]


def test_any_flag_of_the_step_counts():
    time, at = np.arange(100) * 3 * MS, np.arange(1, 20) * 12 * MS
    flags = np.zeros((100, 2), bool)
    flags[5, 1] = True
    found = resample(time, flags, at, "flag").values
    assert np.argwhere(found).tolist() == [[1, 1]]


@given(streams(), st.sampled_from(ROLES[:4]), st.integers(0, 12 * MS), st.floats(20, 300))
def test_no_value_lies_outside_its_neighbours(stream, role, phase, rate):
    time, values = stream
    at = grid(int(time[0]) - 30 * MS + phase, int(time[-1]) + 30 * MS, rate)
    found = resample(time, values, at, role, max_gap_ns=60 * MS)
    step = int(at[1] - at[0])
    for k in np.flatnonzero(found.valid):
        start = at[k] - step if role in ("measurement", "sample") else at[k]
        near = [i for i in range(len(time)) if start - 60 * MS <= time[i] <= at[k] + 60 * MS]
        assert (values[near].min(0) <= found.values[k]).all()
        assert (found.values[k] <= values[near].max(0)).all()
    assert not np.isfinite(found.values[~found.valid]).any()


@given(streams(2), st.sampled_from(ROLES), st.integers(0, 12 * MS))
def test_nothing_crosses_a_gap(stream, role, phase):
    time, values = stream
    gap = 45 * MS  # more than any step of the stream
    cut = len(time) // 2
    time = np.concatenate([time[:cut], time[cut:] + gap])
    at = grid(int(time[0]) + phase, int(time[-1]), 250.0)
    found = resample(time, values > 0 if role == "flag" else values, at, role, max_gap_ns=42 * MS)
    inside = (at - 4 * MS > time[cut - 1]) & (at < time[cut])  # the whole step before the row lies in the gap
    if role == "command":
        inside = (at >= time[cut - 1]) & (at < time[cut])
    assert not found.valid[inside].any()


@pytest.mark.parametrize("role", ROLES)
def test_a_lost_reading_is_a_gap_and_a_late_one_is_not(role, rng):
    values = rng.normal(size=50)
    at = TIME[1:-1] + 4 * MS
    late = TIME + (np.arange(50) == 20) * 5 * MS  # 17 ms and 7 ms: within 1.5 periods
    assert resample(late, values, at, role).valid.all()
    lost = np.arange(50) != 20
    valid = resample(TIME[lost], values[lost], at, role).valid
    # Between readings 19 and 21: two rows of a state or a held command, one whole step of what is averaged.
    expected = {19, 20} if role in ("state", "command") else {20}
    assert set(np.flatnonzero(~valid) + 1) == expected


def test_rows_that_are_not_finite_were_not_read():
    values = np.c_[np.arange(50.0), np.arange(50.0)]
    values[20, 1] = np.nan
    found = resample(TIME, values, TIME, "state")
    assert np.flatnonzero(~found.valid).tolist() == [20]
    assert np.isnan(found.values[20]).all()


def test_a_quaternion_turns_at_constant_speed_the_shorter_way():
    turns = np.linspace(0, 3.0, 50)
    pose = np.c_[np.zeros((50, 3)), exp(np.outer(turns, [0, 0, 1.0]))]
    pose[::2, 3:] *= -1  # the same rotations
    found = resample(TIME, pose, TIME[:-1] + 3 * MS, "state", quaternion=slice(3, 7)).values
    wanted = exp(np.outer(turns[:-1] + 0.25 * (turns[1] - turns[0]), [0, 0, 1.0]))
    # Logarithm and exponential of float64 rotations.
    assert np.abs(difference(found[:, 3:], wanted)).max() < 1e-12
    assert np.abs(np.linalg.norm(found[:, 3:], axis=1) - 1).max() < 1e-12


def test_outside_the_stream_nothing_is_known():
    at = np.array([-20, -1, 588 + 19, 588 + 40]) * MS
    for role in ("state", "command", "measurement"):
        found = resample(TIME, np.ones(50), at, role)
        assert not found.valid[[0, 3]].any()
        assert np.isnan(found.values[[0, 3]]).all()
    assert not resample(np.zeros(0, int), np.zeros((0, 2)), at, "state").valid.any()
    assert resample(np.zeros(0, int), np.zeros((0, 2)), at, "sample").values.shape == (4, 2)


def test_one_stamp_twice_counts_once():
    time = np.array([0, 0, 10, 20]) * MS
    assert resample(time, np.arange(4.0), time[1:], "state").values.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("time", "role", "error"),
    [([0, 2, 1], "state", DataError), ([0, 1], "state", DataError), ([0, 1, 2], "x", UsageError)],
)
def test_wrong_streams_are_refused(time, role, error):
    with pytest.raises(error):
        resample(np.array(time), np.zeros(3), np.arange(3), role)


@given(st.integers(0, 10**18), st.floats(1, 1000), st.integers(1, 2000))
def test_a_grid_has_the_rate_and_does_not_drift(start, rate, count):
    at = grid(start, start + round((count - 1) * 1e9 / rate), rate)
    assert len(at) == count
    assert at[0] == start
    assert abs(int(at[-1]) - start - (count - 1) * 1e9 / rate) <= 1  # rounding to whole nanoseconds


def test_an_end_before_the_start_is_no_grid():
    assert len(grid(10, 5 - 10**9, 80.0)) == 0


def test_two_clocks_in_closed_form():
    reference = np.arange(100) * 1_000 * MS
    other = reference + 5 * MS + np.round(reference * 20e-6).astype(int)
    fit = clock_fit(reference, other, "pairs")
    # The median of a drift of 20 ppm over 99 s, plus 5 ms; stamps are whole nanoseconds.
    assert fit.offset_s == pytest.approx(5e-3 + 49.5 * 20e-6, abs=1e-8)
    assert fit.drift_ppm == pytest.approx(20.0, abs=1e-3)
    assert clock_fit(reference[:0], other[:0], "pairs").offset_s == 0
    assert clock_fit(reference[:1], other[:1], "pairs").drift_ppm == 0


def test_the_period_of_a_stream_is_its_median_step():
    assert period_ns(TIME) == 12 * MS
    assert period_ns(TIME[:1]) == np.inf
    assert MAX_GAP_PERIODS * 12 == 18
