"""Lagged regression: the lag, the slope and the servo behind a motion come back."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.data.lag import centred, drives, lag_moments, own_lag

T = np.arange(200) / 80.0


def wave(shift: float = 0.0) -> np.ndarray:
    """One sine of 1 Hz `(1, T, 1)` that comes `shift` rows late."""
    return np.sin(2 * np.pi * (T - shift / 80))[None, :, None]


@pytest.mark.parametrize("rows", [-3.0, -1.0, 0.0, 0.5, 1.0, 6.0])
def test_the_lag_of_a_delayed_sine_is_its_delay(rows):
    # The parabola through three correlations of a slow sine is exact to a hundredth of a row.
    assert own_lag(wave(rows), wave(), 10)[0] == pytest.approx(rows, abs=0.02)


def test_a_still_signal_has_no_lag():
    assert np.isnan(own_lag(0 * wave(), wave(), 10)[0])


def test_the_slope_is_how_far_one_moves_with_the_other():
    found = lag_moments(0.3 * wave() + 2.0, wave(), np.arange(3))
    assert found.slope()[0, 0, 0] == pytest.approx(0.3)
    assert found.r2()[0, 0, 0] == pytest.approx(1.0)
    assert lag_moments(-wave(), wave(), np.arange(1)).r2()[0, 0, 0] == pytest.approx(-1.0)


def test_rows_that_were_not_seen_do_not_count(rng):
    q, u = wave(2.0) + 0.1, wave()
    q[:, 50:90] = np.nan
    best = lag_moments(q, u, np.arange(5)).error()[:, 0, 0]
    assert best.argmin() == 2
    # What is left is rounding.
    assert best[2] == pytest.approx(0.0, abs=1e-12)


def test_a_constant_of_each_episode_is_taken_off():
    stacked = np.concatenate([wave() + 1, wave() - 1])
    assert np.abs(centred(stacked).mean(1)).max() == pytest.approx(0.0, abs=1e-12)


def test_a_position_servo_rests_at_its_command(hand):
    found = drives(hand)
    assert found.joints.tolist() == found.columns.tolist() == list(range(15))
    assert found.slope == pytest.approx(np.ones(15))
    assert found.offset == pytest.approx(np.zeros(15))


def test_a_toss_has_no_servos(cube):
    assert len(drives(cube).joints) == 0
