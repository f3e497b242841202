"""Intervals and shares of the gap, against numbers done by hand."""

from __future__ import annotations

import numpy as np
import pytest

from candata.experiment.scores import Resampling, RowScores, excess


def test_half_of_the_way_to_the_floor_is_half_of_the_gap():
    rng = np.random.default_rng(0)
    nominal = 0.6 + 0.02 * rng.standard_normal((1, 60))
    floor = nominal + 0.3
    draws = Resampling(60)
    half = draws.closed((nominal + floor) / 2, nominal, floor)
    assert half.value == pytest.approx(0.5)
    assert half.low == pytest.approx(0.5)
    assert half.high == pytest.approx(0.5)
    assert draws.closed(nominal, nominal, floor).value == 0
    assert draws.closed(nominal, nominal, nominal + 0.001).value is None


def test_an_interval_holds_the_spread_of_seeds_too():
    rng = np.random.default_rng(1)
    one_seed = 0.5 + 0.05 * rng.standard_normal((1, 100))
    seeds = np.concatenate([one_seed - 0.1, one_seed, one_seed + 0.1])
    draws = Resampling(100)
    narrow, wide = draws.value(one_seed), draws.value(seeds)
    assert narrow.low < narrow.value < narrow.high
    assert narrow.high - narrow.low == pytest.approx(2 * 1.96 * 0.05 / 10, rel=0.25)
    assert wide.high - wide.low > 3 * (narrow.high - narrow.low)


def test_pairs_of_episodes_make_a_sure_difference_of_noisy_scores():
    noisy = np.random.default_rng(2).uniform(0, 1, (1, 40))
    gain = Resampling(40).difference(noisy + 0.01, noisy)
    assert gain.low == pytest.approx(0.01)
    assert gain.high == pytest.approx(0.01)


def test_few_test_episodes_have_no_interval_and_missing_scores_no_value():
    draws = Resampling(29)
    assert draws.value(np.full((2, 29), 0.5)).low is None
    assert draws.value(np.full((2, 29), np.nan)).value is None


def test_the_floor_itself_is_one_and_twice_its_error_is_two():
    empty = np.zeros((1, 1))
    floor = RowScores(empty, empty, empty, 0.01, 0.1)
    assert excess(floor, floor) == 1
    assert excess(RowScores(empty, empty, empty, 0.02, 0.2), floor) == pytest.approx(2)
    assert excess(floor, None) is None
