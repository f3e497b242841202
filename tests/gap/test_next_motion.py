"""The next motion: it separates what the recorded one does not, within limits, and luck is no separation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap import next_motion, proposal
from candata.gap.candidates import candidate
from candata.gap.floor import floor
from candata.gap.next_motion import (
    Choice,
    Rivals,
    all_motions,
    separating_motion,
    separations,
    typical_spread,
    unexplained,
    usual_motions,
)
from candata.gap.recordings import recordings
from candata.gap.replay import Replayer, replay_all
from candata.gap.residuals import layout, residual
from candata.gap.score import score
from candata.gap.search import Problem
from candata.gap.starts import starts
from candata.policies import Motion, command_limits
from candata.schema.scene import Noise

SHAPE = (1, 4, 40, 5)


@pytest.fixture(scope="module")
def tied(arm, planted):
    """Damping and dry friction of the arm's joints, which strokes of one speed hardly tell apart."""
    sets = (planted("joint_damping", damping_Nms_rad=0.4), planted("joint_dry_friction", frictionloss_Nm=0.25))
    return Rivals(Replayer(arm), sets, arm.file.noise, ("joint_position",))


def test_a_rival_that_fits_after_a_refit_leaves_nothing(rng):
    signature = rng.standard_normal(SHAPE[2:])
    none = np.broadcast_to(signature, SHAPE)
    # The rival's fit goes half the way: twice as much of it explains all.
    assert unexplained(none, 0.5 * none, np.ones(SHAPE))[0] == pytest.approx(0, abs=1e-6)


def test_what_a_rival_cannot_explain_is_left_in_floors(rng):
    signature, across = rng.standard_normal((2, *SHAPE[2:]))
    across -= signature * (across * signature).sum() / (signature**2).sum()
    none = np.broadcast_to(3 * signature, SHAPE)
    left = unexplained(none, none + across, np.full(SHAPE, 0.5))
    # The step lies across the residual: nothing of it is explained, and a floor is half a unit.
    assert left[0] == pytest.approx(6 * np.sqrt((signature**2).mean()), rel=1e-6)


def test_noise_and_chaos_are_no_separation(rng):
    noise = 5 * rng.standard_normal(SHAPE)
    # 200 cells of four plays: the mean product is 0 within 5^2 / 5^2 / sqrt(200 x 6) = 0.03, its root within 0.3.
    assert unexplained(noise, noise + 0.1, np.ones(SHAPE))[0] < 0.3
    assert np.sqrt((noise**2).mean()) > 4


def test_cells_that_were_not_seen_count_for_nothing(rng):
    none = np.broadcast_to(rng.standard_normal(SHAPE[2:]), SHAPE).copy()
    whole = unexplained(none, none, np.ones(SHAPE))
    none[:, :, 20:] = np.nan
    half = unexplained(none, none, np.ones(SHAPE))
    assert half[0] == pytest.approx(np.sqrt((none[0, 0, :20] ** 2).mean()), rel=1e-6)
    assert half[0] != whole[0]


def test_the_designed_motion_separates_more_than_the_recorded_one(tied, arm):
    recorded = next(m for m in all_motions(arm, 2.0) if m.name == "slow reversals in the air")
    choice = separating_motion(tied, 2.0, np.random.default_rng(3))
    # Judged with starts and noise that the choice has not seen.
    (before, after), _ = separations(tied, [recorded, choice.motion], 4, 99)
    assert after > 1.5 * before
    assert after == pytest.approx(choice.separation, rel=0.2)
    low, high = command_limits(arm).T
    assert ((low <= choice.motion.commands) & (choice.motion.commands <= high)).all()


def test_a_world_is_no_rival_of_its_own(tied, arm):
    same = Rivals(tied.replayer, (tied.sets[0], tied.sets[0]), tied.noise, tied.channels)
    apart, _ = separations(same, all_motions(arm, 2.0)[:2], 3, 5)
    other, _ = separations(tied, all_motions(arm, 2.0)[:2], 3, 5)
    assert apart.max() < 0.3 < other.max()


def test_the_choice_is_the_best_motion_below_the_force_limit(tied, monkeypatch):
    apart, force = np.array([1.0, 2.0, 9.0, 4.0]), np.array([2.0, 1.0, 8.0, 3.0])
    motions = tuple(Motion(str(i), np.zeros((2, 2)), np.zeros(3)) for i in range(4))
    by_name = {m.name: i for i, m in enumerate(motions)}

    def told(_rivals, some, _plays, _seed):
        index = [by_name[m.name] for m in some]
        return apart[index], force[index]

    monkeypatch.setattr(next_motion, "all_motions", lambda *_: motions)
    monkeypatch.setattr(next_motion, "usual_motions", lambda *_: motions[:2])
    monkeypatch.setattr(next_motion, "separations", told)

    def chosen(limit):
        rivals = Rivals(tied.replayer, tied.sets, tied.noise, tied.channels, None, limit)
        found = separating_motion(rivals, 2.0, np.random.default_rng(1))
        return found and (found.motion.name, found.separation, found.tried)

    assert chosen(100.0) == ("2", 9.0, 4)
    assert chosen(5.0) == ("3", 4.0, 3)
    # Without a limit: half as much again as the usual motions need, 3 N.
    assert chosen(None) == ("3", 4.0, 3)
    assert chosen(1.5) == ("1", 2.0, 1)
    assert chosen(0.5) is None


def test_motions_stay_within_the_limits_of_joints_and_actuators(hand):
    low, high = command_limits(hand).T
    motions = all_motions(hand, 2.0)
    assert [m.name for m in motions[:5]] == list(hand.policies)
    for m in motions:
        assert m.commands.shape == (160, 15)
        assert ((low <= m.commands) & (m.commands <= high)).all()


def test_the_spread_is_the_median_floor_of_a_phase(one_phase, white_score, rng):
    level = white_score(rng, episodes=3, size=40, columns=2)
    level.sigma[:] = np.tile([2.0, 4.0], 20)
    plan = one_phase(3, 20, 2, ("free", "sustained"))
    assert np.allclose(typical_spread(plan, level), [[2, 4], [2, 4]])
    level.mask[:, ::2] = False
    assert np.allclose(typical_spread(plan, level), [[1, 4], [1, 4]]), "one floor where none was seen"


def test_too_little_data_asks_for_the_usual_motions(arm, arm_episodes, cube):
    words, motions = proposal.more(arm, recordings(arm, arm_episodes(count=3)), 8)
    assert [m.name for m in motions] == ["free_sweep"] == [m.name for m in usual_motions(arm, 2.0)]
    assert (words.name, words.file) == ("the usual motions in turn", "motion.parquet")
    assert words.reason == "at least 5 more episodes, the object put back before each"


def test_a_toss_has_nothing_to_command(cube):
    assert all_motions(cube, 1.0) == ()
    assert (
        separating_motion(Rivals(Replayer(cube), ((), ()), Noise(), ("object_pose",)), 1.0, np.random.default_rng(1))
        is None
    )


@pytest.fixture(scope="module")
def problem(arm, arm_episodes, planted):
    """Two episodes of a damped arm, in units of their floor."""
    rng = np.random.default_rng(2)
    replayer = Replayer(arm)
    recs = recordings(arm, arm_episodes(planted("joint_damping", damping_Nms_rad=0.4), count=2))
    begin = starts(arm, recs)
    readings = replay_all(replayer, recs, begin, [()])[0]
    plan = layout(arm, recs, begin, readings)
    spread = floor(replayer, recs, begin, plan, rng, 4)
    level = score(residual(recs, plan, readings), spread, plan)
    return Problem(replayer, recs, begin, plan, level, [], spread.noise, spread.kind, rng)


def tie(arm, *names: str) -> SimpleNamespace:
    """What the search hands over: fits of one effect each, which it cannot tell apart."""
    some = [candidate(n, arm) for n in names]
    return SimpleNamespace(tied=tuple(SimpleNamespace(labels=(c.label,), members=((c, c.high),)) for c in some))


@pytest.mark.parametrize(
    ("separation", "reason"),
    [
        (2.04, "best of 6 motions: a wrong cause would leave 2 floors, where the usual motions leave 0.31"),
        (
            0.4,
            "best of 6 motions: a wrong cause would leave 0.4 floors, where the usual motions leave 0.31; "
            "that is little, and it may not decide",
        ),
    ],
)
def test_a_tie_is_answered_with_words_and_commands(problem, arm, monkeypatch, separation, reason):
    motion = Motion("fast reversals", np.zeros((2, 2)), np.zeros(3))
    asked = []

    def found(rivals, duration_s, _rng):
        asked.append((rivals, duration_s))
        return Choice(motion, separation, 0.31, 6)

    monkeypatch.setattr(proposal, "separating_motion", found)
    before = problem.rng.bit_generator.state
    words, motions = proposal.separating(problem, tie(arm, "joint_damping", "joint_dry_friction"))
    assert problem.rng.bit_generator.state == before, "no other number of the report may change"
    assert motions == (motion,)
    assert (words.name, words.file) == ("fast reversals", "motion.parquet")
    assert words.separates == ("joint_damping", "joint_dry_friction")
    assert (words.expected_separation, words.reason) == (separation, reason)
    ((rivals, duration_s),) = asked
    assert duration_s == 1.6
    assert [s.name for (s,) in rivals.sets] == ["joint_damping", "joint_dry_friction"]
    assert rivals.force_limit_n is None, "the arm feels nothing"
    # The floor is that of the recordings: no less than what averaging four rows leaves of 1 mrad.
    assert (rivals.spread > 4e-4).all()


def test_where_no_motion_stays_within_the_limits_the_recorded_task_is_named(problem, arm, monkeypatch):
    monkeypatch.setattr(proposal, "separating_motion", lambda *_: None)
    words, motions = proposal.separating(problem, tie(arm, "joint_damping", "joint_dry_friction"))
    assert motions == ()
    assert words.name in ("slow", "fast")
    assert (words.file, words.reason) == (None, None)
