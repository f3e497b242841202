"""How far: the share of the gap that closes, with its interval over episodes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.gap.validation.closure import gap, trust
from candata.schema.report import Gap

SIZES = st.lists(st.floats(1.5, 20.0), min_size=8, max_size=24).map(np.array)


@given(SIZES, st.integers(0, 100))
def test_a_gap_that_comes_down_to_the_floor_is_closed(before, seed):
    found = gap(before, np.ones_like(before), np.random.default_rng(seed), gap_left=True)
    assert (found.closed, found.low, found.high) == (1.0, 1.0, 1.0)


@given(SIZES, st.integers(0, 100))
def test_a_gap_that_stays_is_open(before, seed):
    found = gap(before, before, np.random.default_rng(seed), gap_left=True)
    assert (found.closed, found.low, found.high) == (0.0, 0.0, 0.0)


@given(SIZES, st.floats(0.0, 0.95), st.integers(0, 100))
def test_the_share_is_that_of_what_lies_above_the_floor(before, share, seed):
    found = gap(before, 1 + (1 - share) * (before - 1), np.random.default_rng(seed), gap_left=True)
    # Every episode closes by the same share, so resampling changes nothing; printed to four places.
    assert [found.closed, found.low, found.high] == pytest.approx([share] * 3, abs=1e-4)


def test_the_interval_contains_the_share_and_narrows_with_episodes():
    widths = []
    for count in (8, 200):
        rng = np.random.default_rng(count)
        before = 1 + rng.lognormal(1.0, 0.4, count)
        after = 1 + (before - 1) * rng.uniform(0.1, 0.5, count)
        found = gap(before, after, rng, gap_left=True)
        assert found.low < found.closed < found.high
        assert found.closed == pytest.approx(1 - (after.mean() - 1) / (before.mean() - 1), abs=1e-4)
        widths.append(found.high - found.low)
    # With 25 times the episodes an interval is five times as narrow, each known to a third or so.
    assert widths[1] < widths[0] / 2.5


def test_the_interval_covers_the_truth_nine_times_in_ten():
    hits = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        before = 1 + rng.lognormal(1.0, 0.4, 16)
        after = 1 + (before - 1) * rng.uniform(0.1, 0.5, 16)
        found = gap(before, after, rng, gap_left=True)
        hits += found.low <= 0.7 <= found.high
    # 180 are meant; a bootstrap of 16 episodes falls short by a few, and 200 draws scatter by 4.
    assert 155 <= hits <= 195


def test_more_discrepancy_after_than_before_is_a_negative_share():
    found = gap(np.full(8, 2.0), np.full(8, 2.5), np.random.default_rng(0), gap_left=True)
    assert (found.before, found.after, found.closed) == (2.0, 2.5, -0.5)


def test_luck_below_the_floor_closes_no_more_than_everything():
    found = gap(np.full(8, 3.0), np.full(8, 0.9), np.random.default_rng(0), gap_left=True)
    assert found.closed == 1.0


def test_without_a_name_nothing_closes():
    found = gap(np.full(8, 2.0), np.full(8, 2.0), np.random.default_rng(0), gap_left=False)
    assert (found.before, found.after, found.floor) == (2.0, 2.0, 1.0)
    assert (found.closed, found.low, found.high) == (None, None, None)


@pytest.mark.parametrize(
    ("after", "closed", "least", "most"),
    [
        (1.0, 1.0, 1.0, 1.0),
        (0.98, 1.0, 1.0, 1.0),
        (1.1, 0.9, 0.5, 0.5),
        (1.04, 0.6, 0.8, 0.9),
        (4.0, 0.97, 0.9, 0.95),
        (1.6, 0.5, 0.0, 0.05),
    ],
)
def test_a_set_that_leaves_much_is_trusted_less(after, closed, least, most):
    """By the smaller of floors and share that are left: neither a faint nor a large gap is held against it."""
    found = trust(Gap(before=5.0, after=after, closed=closed))
    assert least - 1e-9 <= found <= most + 1e-9


def thrown(left: float, before: float = 3.0, episodes: int = 20, odd: tuple[int, ...] = (2, 12)) -> Gap:
    """Of episodes that come down to `left`, two are thrown by a contact that no replay repeats."""
    was, now = np.full(episodes, before), np.full(episodes, left)
    was[list(odd)] = now[list(odd)] = 25.0
    ids = [f"e{i}" for i in range(episodes)]
    return gap(was, now, np.random.default_rng(0), gap_left=True, ids=ids)


def test_few_episodes_that_hold_most_of_what_remains_are_told_apart():
    found = thrown(1.1)
    assert found.closed == pytest.approx(1 - (0.9 * 0.1 + 2.4) / (0.9 * 2 + 2.4), abs=1e-4)
    assert (found.outlying, found.closed_elsewhere) == (("e2", "e12"), pytest.approx(0.95))
    # Also where little remains; no more than it takes.
    one = gap(np.full(8, 3.0), np.array([*np.ones(7), 3.0]), np.random.default_rng(0), True, list("abcdefgh"))
    assert (one.closed, one.outlying, one.closed_elsewhere) == (pytest.approx(0.875), ("h",), 1.0)
    assert thrown(1.1, episodes=64, odd=(7,)).outlying == ("e7",)


@pytest.mark.parametrize(
    "found",
    [
        thrown(4.0, before=5.0),  # the others hold more
        thrown(1.0, before=1.2),  # the others had next to nothing to explain
        gap(np.full(8, 3.0), np.array([*np.ones(7), 1.7]), np.random.default_rng(0), True, list("abcdefgh")),
        gap(np.full(4, 3.0), np.array([1.0, 1.0, 1.0, 9.0]), np.random.default_rng(0), True, list("abcd")),
    ],
    ids=["others hold more", "little elsewhere", "little remains", "too few"],
)
def test_otherwise_none_are(found):
    assert (found.outlying, found.closed_elsewhere) == ((), None)
