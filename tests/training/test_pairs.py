"""Forecasters against each other on resampled episodes."""

from __future__ import annotations

import numpy as np
import pytest

from candata.training.pairs import resampled_areas

COUNTS = np.array([10, 20, 30, 10, 20, 30, 10, 20, 30, 40])


def areas(seed: int, gain: float) -> dict[str, np.ndarray]:
    """Episodes that differ far more from each other than two forecasters do on one of them."""
    level = np.random.default_rng(seed).uniform(0.2, 0.8, len(COUNTS))
    return {"better": (level + gain) * COUNTS, "worse": level * COUNTS, "same": level * COUNTS}


def test_values_are_means_over_rows():
    found = resampled_areas(areas(0, 0.1), COUNTS, 0)
    assert found.value["worse"] == pytest.approx(areas(0, 0.1)["worse"].sum() / COUNTS.sum())


def test_pairs_are_drawn_together_so_that_the_difficulty_of_episodes_cancels():
    found = resampled_areas(areas(1, 0.02), COUNTS, 0)
    better, equal, other = found.pairs()
    assert (better.forecaster, better.reference) == ("better", "worse")
    assert (equal.forecaster, equal.reference) == ("better", "same")
    # A gain that is the same on every episode is known exactly, though the areas themselves are not.
    assert better.low == pytest.approx(0.02) == better.high
    assert (other.value, other.low, other.high) == (0, 0, 0)
    low, high = found.interval("better")
    assert high - low > 0.1
    assert better.reversed().model_dump() == {
        "forecaster": "worse",
        "reference": "better",
        "value": -better.value,
        "low": -better.high,
        "high": -better.low,
    }


def test_the_interval_is_that_of_a_bootstrap_of_means():
    level = np.random.default_rng(2).uniform(0, 1, 400)
    found = resampled_areas({"one": level, "none": np.zeros(400)}, np.ones(400, np.int64), 0)
    low, high = found.interval("one")
    half_width = 1.96 * level.std() / np.sqrt(400)
    assert (high - low) / 2 == pytest.approx(half_width, rel=0.1)  # 2,000 resamples: 3 % of the ends
    assert found.pairs()[0].low == low


def test_fewer_than_8_episodes_have_no_interval():
    found = resampled_areas({name: values[:7] for name, values in areas(3, 0.1).items()}, COUNTS[:7], 0)
    assert found.interval("better") is None
    assert found.pairs()[0].low is None
    assert found.pairs()[0].value == pytest.approx(0.1)
