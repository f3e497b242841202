"""Rank correlation, MMRV and calibration of success that is written by hand."""

from __future__ import annotations

import numpy as np
import pytest

from candata.policy_evaluation.ranking import (
    best_ranking,
    mean_rank_violation,
    spearman,
    wilson,
    world_ranking,
)


def flags(*counts: int, total: int = 10) -> np.ndarray:
    """Success of a policy a count: so many of the starts."""
    return np.array([[float(k < count) for k in range(total)] for count in counts])


def test_the_rank_violation_of_two_swapped_policies_is_their_difference():
    seen = np.array([0.1, 0.4, 0.9])
    assert mean_rank_violation(np.array([0.2, 0.3, 0.8]), seen) == 0
    # The first two are swapped, 0.3 apart; the third is right: (0.3 + 0.3 + 0) / 3.
    assert mean_rank_violation(np.array([0.5, 0.3, 0.8]), seen) == pytest.approx(0.2)
    # All alike: as the source has it, a policy differs from those that are seen to be better.
    assert mean_rank_violation(np.array([0.5, 0.5, 0.5]), seen) == pytest.approx((0.8 + 0.5 + 0.0) / 3)


def test_the_rank_correlation_is_of_ranks_and_has_no_value_without_an_order():
    assert spearman(np.array([0.1, 0.2, 0.9]), np.array([0.0, 0.6, 0.7])) == pytest.approx(1)
    assert spearman(np.array([0.9, 0.2, 0.1]), np.array([0.0, 0.6, 0.7])) == pytest.approx(-1)
    assert np.isnan(spearman(np.array([0.5, 0.5, 0.5]), np.array([0.0, 0.6, 0.7])))


def test_a_wilson_interval_reaches_from_zero_without_trials():
    assert (wilson(0, 0).low, wilson(0, 0).high) == (0, 1)
    ends = wilson(8, 10)  # Brown, Cai & DasGupta 2001, formula (4), with z = 1.96
    assert (ends.low, ends.high) == (pytest.approx(0.490, abs=1e-3), pytest.approx(0.943, abs=1e-3))


def test_a_world_is_judged_by_the_starts_that_were_seen():
    seen, predicted = flags(2, 5, 9), flags(4, 6, 9)
    ranking, drawn = world_ranking("w", predicted, seen, 0)
    assert (ranking.policies, ranking.pairs, len(drawn)) == (3, 30, 1000)
    assert ranking.spearman.value == pytest.approx(1)
    assert ranking.mmrv == 0
    assert ranking.mean_error == pytest.approx(0.1)
    assert ranking.bias == pytest.approx(0.1)
    assert ranking.agreement == pytest.approx(27 / 30)
    assert ranking.covered == 1
    seen[0, 2:] = np.nan  # of the first policy two starts were seen, both predicted right
    assert world_ranking("w", predicted, seen, 0)[0].mean_error == pytest.approx(0.1 / 3)
    seen[0] = np.nan
    assert world_ranking("w", predicted, seen, 0)[0].policies == 2


def test_starts_that_seldom_show_an_order_leave_the_rank_correlation_open():
    few, _ = world_ranking("w", flags(0, 1, total=3), flags(0, 1, total=3), 0)
    assert (few.spearman.value, few.spearman.low, few.spearman.high) == (pytest.approx(1), -1, 1)
    many, _ = world_ranking("w", flags(0, 9), flags(0, 9), 0)
    assert many.spearman.low == pytest.approx(1)


def test_the_best_world_ranks_best_and_one_without_an_order_is_none():
    seen = flags(1, 5, 9)
    right, wrong, flat = (
        world_ranking(name, flags(*counts), seen, 0)[0]
        for name, counts in (("right", (2, 5, 8)), ("wrong", (5, 2, 8)), ("flat", (5, 5, 5)))
    )
    best = best_ranking((wrong, right, flat))
    assert best is not None
    assert best.world == "right"
    assert best_ranking((flat,)) is None
