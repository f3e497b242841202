"""MPPI on a world that is known: it lifts, within bounds, and leaves alone what it cannot better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.errors import UsageError
from candata.policies import Goal
from candata.policy_evaluation.refinement import MppiSettings, path_weights, refine_chunks
from tests.policy_evaluation.chunks import BOUNDS, LiftingWorld

LIFT = Goal(lift_m=0.06, held_s=0.3)
STILL = np.zeros((2, 16, 2))
SETTINGS = MppiSettings(noise=1.0)


def refine(world: LiftingWorld, planned: np.ndarray = STILL, settings: MppiSettings = SETTINGS):
    return refine_chunks(world, planned, planned[:, 0], range(len(planned)), BOUNDS, LIFT, settings)


def test_weights_are_those_of_path_integral_control():
    cost = np.array([[1.0, 2.0, 4.0, np.inf]])
    expected = np.exp(-cost[0, :3] / (0.5 * cost[0, :3].std()))
    assert path_weights(cost, 0.5)[0] == pytest.approx([*(expected / expected.sum()), 0.0])


def test_weights_of_equal_costs_are_equal_and_without_a_cost_there_are_none():
    assert path_weights(np.array([[3.0, 3.0]]), 0.5).tolist() == [[0.5, 0.5]]
    assert path_weights(np.array([[np.inf, np.inf]]), 0.5).tolist() == [[0.0, 0.0]]


def test_a_chunk_that_does_not_lift_does_so_after():
    refined = refine(LiftingWorld(spread_m=0.001))
    assert refined.changed.all()
    assert not refined.reached_before.any()
    assert (refined.cost_after < 0.5 * refined.cost_before).all()
    assert refined.commands[..., 0].max(1).min() > 0.3
    assert np.abs(refined.commands[..., 1]).mean() < 0.5 * np.abs(refined.commands[..., 0]).mean()  # of no use


def test_it_keeps_limits_and_rate():
    commands = refine(LiftingWorld()).commands
    assert np.abs(np.diff(commands, axis=1)).max() <= 0.2 + 1e-12
    assert np.abs(commands).max() <= 1.0


def test_nothing_changes_where_commands_do_nothing_or_forecasts_disagree():
    for world in (LiftingWorld(works=False), LiftingWorld(spread_m=0.2)):
        refined = refine(world)
        assert not refined.changed.any()
        assert np.array_equal(refined.commands, STILL)


def test_it_does_not_leave_what_is_known():
    refined = refine(LiftingWorld(spread_m=0.001, familiar_up_to=0.25))
    assert np.abs(refined.commands).max() <= 0.25


def test_same_seed_same_chunk_whatever_other_starts_there_are():
    together, again, alone = (
        refine_chunks(
            LiftingWorld(), STILL[: len(numbers)], np.zeros((len(numbers), 2)), numbers, BOUNDS, LIFT, SETTINGS
        )
        for numbers in ([4, 7], [4, 7], [7])
    )
    assert np.array_equal(together.commands, again.commands)
    assert np.array_equal(together.commands[1:], alone.commands)
    assert not np.array_equal(together.commands[0], together.commands[1])


def test_settings_and_commands_that_mean_nothing_are_refused():
    with pytest.raises(UsageError, match="rounds"):
        refine(LiftingWorld(), settings=replace(SETTINGS, rounds=0))
    with pytest.raises(UsageError, match="no number"):
        refine(LiftingWorld(), np.full_like(STILL, np.nan))
