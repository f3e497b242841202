"""Costs of chunks in closed form, and a choice that is none where nothing is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.errors import DataError, UsageError
from candata.policies import Goal, Motion
from candata.policy_evaluation.choice import choose
from candata.policy_evaluation.commands import candidate_motions
from candata.policy_evaluation.cost import CONTACT_WEIGHT, MOST_DEFICIT, ChunkCost, chunk_cost
from candata.policy_evaluation.filtering import choose_chunks, paired_lift
from candata.rotation import exp
from tests.policy_evaluation.chunks import BOUNDS, RATE_HZ, LiftingWorld, poses_of

LIFT = Goal(lift_m=0.02, held_s=0.3)


def lifted(*heights: float) -> np.ndarray:
    return poses_of(np.array(heights))


def test_a_lift_is_reached_when_it_is_held_for_its_time():
    held = chunk_cost(LIFT, lifted(0, 0.03, 0.03, 0.03), None, RATE_HZ)
    short = chunk_cost(LIFT, lifted(0, 0.03, 0.03, 0.0), None, RATE_HZ)
    assert held.reached
    assert not short.reached
    assert held.cost < 0 < short.cost == 1.0


def test_beyond_the_goal_little_is_gained_and_below_it_much_is_lost():
    cost = [chunk_cost(LIFT, lifted(0, z, z, z), None, RATE_HZ).cost for z in (-1.0, 0.0, 0.01, 0.02, 0.04, 1.0)]
    assert cost == sorted(cost, reverse=True)
    assert cost[0] == MOST_DEFICIT
    assert cost[1:4] == pytest.approx([1.0, 0.5, 0.0])
    assert cost[3] - cost[5] < 0.2 * (cost[1] - cost[3])


def test_lost_contact_costs_where_the_hand_must_hold_and_not_where_it_lets_go():
    held, lost = np.ones(4), np.array([1.0, 1.0, 0.0, 0.0])
    up = lifted(0, 0.03, 0.03, 0.03, 0.03)
    difference = chunk_cost(LIFT, up, lost, RATE_HZ).cost - chunk_cost(LIFT, up, held, RATE_HZ).cost
    assert difference == pytest.approx(CONTACT_WEIGHT)
    place = Goal(place_m=np.array([0.1, 0.0, 0.0]))
    assert chunk_cost(place, up, lost, RATE_HZ).cost == chunk_cost(place, up, held, RATE_HZ).cost


@pytest.mark.parametrize(
    ("goal", "angle", "axis"), [(Goal(turn_rad=0.5), 0.6, 2), (Goal(topple=True), np.pi / 2, 0)], ids=["turn", "topple"]
)
def test_turns_are_told_by_their_axis(goal, angle, axis):
    for turned_about in (0, 2):
        poses = lifted(0, 0, 0)
        poses[1:, 3:] = exp(angle * np.eye(3)[turned_about])
        assert chunk_cost(goal, poses, None, RATE_HZ).reached == (turned_about == axis)


def test_a_goal_that_poses_cannot_tell_is_refused():
    with pytest.raises(UsageError, match="no cost"):
        chunk_cost(Goal(slip=True, lift_m=0.1), lifted(0, 0), None, RATE_HZ)


def costs(mean: list[float], spread: float = 0.0) -> ChunkCost:
    """Costs of one start by two samples, which reach the goal where they are below 0."""
    cost = np.array([[mean], [mean]]) + spread * np.array([-1, 1])[:, None, None]
    return ChunkCost(cost, cost < 0)


def test_the_least_cost_is_chosen_among_those_that_are_known():
    assert choose(costs([0.5, 0.1, 0.9]), np.array([[True, True, True]]))[0].candidate == 1
    assert choose(costs([0.5, 0.1, 0.9]), np.array([[True, False, True]]))[0].candidate == 0


def test_all_outside_what_was_seen_is_an_abstention_not_the_least_bad():
    (choice,) = choose(costs([0.5, 0.1]), np.array([[False, False]]))
    assert (choice.candidate, choice.reason) == (None, "outside")


def test_it_abstains_when_forecasts_disagree_by_more_than_the_choice_gains():
    allowed = np.ones((1, 3), bool)
    assert choose(costs([0.5, 0.3, 0.5], spread=0.05), allowed)[0].candidate == 1
    (choice,) = choose(costs([0.5, 0.3, 0.5], spread=0.4), allowed)
    assert (choice.candidate, choice.reason) == (None, "unsure")


def test_it_chooses_among_chunks_that_all_succeed_for_sure():
    assert choose(costs([-0.5, -0.5, -0.5], spread=0.4), np.ones((1, 3), bool))[0].candidate is not None


def test_a_chunk_whose_forecast_is_no_number_is_not_chosen():
    assert choose(costs([0.5, np.nan]), np.ones((1, 2), bool))[0].candidate == 0


def test_the_chosen_chunk_lifts_and_a_strange_one_that_would_lift_more_is_left():
    commands = np.zeros((1, 3, 5, 2))
    commands[0, :, :, 0] = np.array([0.0, 0.3, 0.9])[:, None]
    world = LiftingWorld(spread_m=0.001)
    assert choose_chunks(world, commands, np.ones((1, 3), bool), LIFT, 0).candidate.tolist() == [2]
    known = replace(world, familiar_up_to=0.5)
    assert choose_chunks(known, commands, np.ones((1, 3), bool), LIFT, 0).candidate.tolist() == [1]
    assert choose_chunks(known, commands + 0.6, np.ones((1, 3), bool), LIFT, 0).candidate.tolist() == [-1]


def test_kept_commands_keep_limits_and_rate_and_leave_what_does_already(rng):
    wild = rng.normal(0, 3, (4, 20, 2))
    kept = BOUNDS.kept(wild, np.zeros((4, 2)))
    steps = np.diff(np.concatenate([np.zeros((4, 1, 2)), kept], axis=1), axis=1)
    assert np.abs(steps).max() <= 0.2 + 1e-12
    assert np.abs(kept).max() <= 1.0
    assert np.array_equal(BOUNDS.kept(kept, np.zeros((4, 2))), kept)
    assert BOUNDS.is_playable(kept, np.zeros((4, 2))).all()
    assert not BOUNDS.is_playable(wild, np.zeros((4, 2))).any()


def test_one_start_tells_nothing_of_the_gain_at_others(rng):
    one, two = paired_lift(np.array([0.5]), rng), paired_lift(np.array([0.5, 0.5]), rng)
    assert (one.value, one.low, one.high) == (0.5, -1, 1)
    assert (two.low, two.high) == (0.5, 0.5)


def test_noise_without_an_end_is_refused(rng):
    with pytest.raises(UsageError, match="no number"):
        BOUNDS.noise([rng], 2, 4, np.inf)


def test_noise_is_smooth_and_of_the_size_that_is_asked_for(rng):
    noise = BOUNDS.noise([rng], 2000, 16, 0.5)[0]
    assert noise[:, [3, 7, 11]].std() == pytest.approx(0.5 * 0.3, rel=0.05)  # at knots; 12 000 draws
    assert np.abs(np.diff(noise, axis=1)).max() < np.abs(noise).max()
    assert np.abs(noise[:, 0]).mean() < 0.5 * np.abs(noise[:, 3]).mean()


@pytest.mark.parametrize(
    ("commands", "problem"),
    [
        ([[0.0, 0.0], [np.nan, 0.0]], "is no number"),
        ([[0.0, 1.5], [0.0, 1.5]], "goes beyond a limit"),
        ([[0.0, 0.0], [0.0, 0.5]], "is too fast"),
    ],
)
def test_a_candidate_that_cannot_be_played_is_refused(commands, problem):
    with pytest.raises(DataError, match=problem):
        BOUNDS.check([Motion("bad", np.array(commands), np.zeros(3))])


def test_motions_of_any_length_become_chunks_of_one():
    short, long = (Motion(str(n), np.arange(2.0 * n).reshape(n, 2), np.zeros(3)) for n in (2, 9))
    chunks = candidate_motions([short, long], 4)
    assert np.array_equal(chunks[0, 1:], np.repeat(short.commands[-1:], 3, axis=0))
    assert np.array_equal(chunks[1], long.commands[:4])
    with pytest.raises(UsageError, match="nothing to choose"):
        candidate_motions([short], 4)


def test_the_interval_of_a_gain_holds_no_gain_where_there_is_none(rng):
    gains = rng.choice([-1.0, 1.0], 60)
    gains -= gains.mean()
    lift = paired_lift(gains, rng)
    assert lift.low < lift.value < lift.high
    assert lift.low < 0 < lift.high
    assert paired_lift(gains * 0.1 + 0.5, rng).low > 0.4
