"""Resampling is seeded; the spread of noise is told whatever lies under it and wherever readings are missing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import median_abs_deviation, norm

from candata.statistics import MAD_TO_SD, MEDIAN_OF_UNIT_NORMAL, noise_sd, resamples


def test_resamples_are_the_same_at_once_or_one_by_one():
    at_once = resamples(np.random.default_rng(3), 7, 5)
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(at_once, [resamples(rng, 7, 1)[0] for _ in range(5)])
    assert at_once.shape == (5, 7)
    assert set(at_once.ravel().tolist()) <= set(range(7))


def test_the_constants_are_those_of_the_normal_distribution():
    assert pytest.approx(norm.ppf(0.75), abs=5e-5) == MEDIAN_OF_UNIT_NORMAL  # as printed: four decimals
    sample = np.random.default_rng(0).normal(size=1001)
    robust = MAD_TO_SD * median_abs_deviation(sample)
    assert median_abs_deviation(sample, scale="normal") == pytest.approx(robust, rel=5e-5)


def test_noise_on_a_slow_signal_is_told_by_column():
    rng = np.random.default_rng(1)
    time = np.linspace(0, 1, 20_000)
    sd = np.array([0.1, 2.0])
    values = np.sin(time)[:, None] + sd * rng.normal(size=(len(time), 2))
    np.testing.assert_allclose(noise_sd(values, 0, axes=0), sd, rtol=0.03)  # three standard errors of the median
    values[::7] = np.nan
    np.testing.assert_allclose(noise_sd(values, 0, axes=0), sd, rtol=0.04)


def test_readings_that_are_missing_leave_no_noise():
    values = np.full((2, 9, 3), np.nan)
    np.testing.assert_array_equal(noise_sd(values, 1, axes=(0, 1)), np.zeros(3))
    assert noise_sd(values, 1) == 0
    assert noise_sd(values[:, :2], 1) == 0
    np.testing.assert_array_equal(noise_sd(values[:, :2], 1, axes=(0, 1)), np.zeros(3))
