from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.datasets.histograms import BARS, BINS, Histogram

number = st.floats(-1e12, 1e12, allow_subnormal=False).map(lambda v: float(np.float32(v)))


@given(st.lists(st.lists(number, min_size=1, max_size=8), min_size=1, max_size=8))
def test_counts_are_those_of_one_look_at_all_values(parts):
    found = Histogram(1)
    for part in parts:
        found.add(np.array(part)[:, None])
    values = np.concatenate(parts)
    bins = np.floor((values - found.start[0]) / found.width[0]).astype(int)
    assert np.array_equal(found.counts[0], np.bincount(bins, minlength=BINS))
    assert (found.low[0], found.high[0]) == (values.min(), values.max())


def test_each_element_has_its_own_scale(rng):
    values = rng.normal(size=(5000, 3)) * [1e-3, 1.0, 1e4]
    found = Histogram(3)
    found.add(values)
    for element, scale in enumerate((1e-3, 1.0, 1e4)):
        one = found.distribution(element)
        assert len(one.shares) <= BARS
        assert 4 * scale < one.edges[-1] - one.edges[0] < 8 * scale  # 99.8 % of a normal lie within 3.1 sd
        assert one.shares.sum() >= 0.998
        assert one.count == 5000


def test_a_wild_value_is_said_and_leaves_the_bars_to_the_rest(rng):
    found = Histogram(1)
    found.add(np.append(rng.normal(size=5000), 400.0)[:, None])
    one = found.distribution(0)
    assert one.high == 400.0
    assert one.edges[-1] < 6
    assert len(one.shares) > 10


def test_zeros_are_counted_and_no_value_gives_no_distribution():
    found = Histogram(2)
    found.add(np.array([[0.0, 1.0], [0.0, 1.0], [2.0, 1.0], [3.0, 1.0]]))
    assert found.distribution(0).zero_share == 0.5
    assert (found.distribution(1).low, found.distribution(1).high) == (1.0, 1.0)
    assert Histogram(1).distribution(0) is None


def test_the_largest_floats_fit():
    found = Histogram(1)
    found.add(np.zeros((3, 1)))
    found.add(np.array([[3e38], [-3e38]]))
    assert found.counts.sum() == 5
    assert found.distribution(0).shares.sum() == pytest.approx(1.0)
