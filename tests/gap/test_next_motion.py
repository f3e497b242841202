"""The next motion: it separates what the recorded one does not, within limits, and luck is no separation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.fit.candidates import candidate
from candata.gap.fit.problem import Problem
from candata.gap.fit.signatures import library
from candata.gap.measure.floor import floor
from candata.gap.measure.score import score
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import starts
from candata.gap.run.streams import Streams
from candata.gap.verdict import next_motion, proposal
from candata.gap.verdict.next_motion import (
    REFIT,
    Choice,
    Rivals,
    all_motions,
    rival_excess,
    separating_motion,
    separations,
    usual_motions,
)
from candata.policies import Motion, command_limits
from candata.schema.effect import EffectSetting
from candata.schema.scene import Noise


@pytest.fixture(scope="module")
def tied(arm, planted):
    """Damping and dry friction of the arm's joints, which strokes of one speed hardly tell apart."""
    sets = (planted("joint_damping", damping_Nms_rad=0.4), planted("joint_dry_friction", frictionloss_Nm=0.25))
    return Rivals(Replayer(arm), sets, arm.file.noise, ("joint_position",))


def test_a_rival_that_fits_after_a_refit_loses_nothing(white_score, rng):
    level = white_score(rng)
    cause = 8 * rng.standard_normal(level.mask.shape).astype(np.float32)
    own = level.null[0]
    # The fit goes half the way: twice as much of it explains all, and leaves what the truth leaves.
    losses = rival_excess(level, own + cause, own + np.float32(0.5) * cause) + 1
    best = int(np.argmin(losses.mean(1)))
    assert best == REFIT.index(2.0)
    assert losses[best] == pytest.approx(level.loss(own), rel=1e-4)


def test_a_motion_that_cannot_be_simulated_separates_nothing(tied, monkeypatch):
    motions = usual_motions(tied.replayer.scene, 2.0)[:1] * 2
    true = next_motion.tried_episodes

    def failing(scene, jobs, **options):
        made, fails = true(scene, jobs, **options)
        return made, np.where([j.id.startswith("1-") for j in jobs], 0.5, fails)

    sound, _ = separations(tied, motions, 2, 3)
    monkeypatch.setattr(next_motion, "tried_episodes", failing)
    apart, _ = separations(tied, motions, 2, 3)
    assert sound.min() > 0
    assert (apart[0], apart[1]) == (sound[0], 0)


def test_what_a_rival_cannot_explain_is_a_loss(white_score, rng):
    level = white_score(rng, episodes=4, size=400)
    cause, across = 4 * rng.standard_normal((2, *level.mask.shape)).astype(np.float32)
    losses = rival_excess(level, cause, cause + across)
    # Nothing of the cause lies along the fit, so the best refit leaves about as much as none at all.
    assert losses.mean(1).min() > 0.9 * losses.mean(1)[0] > 1


def test_the_designed_motion_separates_more_than_the_recorded_one(tied, arm):
    recorded = next(m for m in all_motions(arm, 2.0) if m.name == "slow reversals in the air")
    choice = separating_motion(tied, 2.0, np.random.default_rng(3))
    # Judged with starts and noise that the choice has not seen.
    (before, after), _ = separations(tied, [recorded, choice.motion], 4, 99)
    assert after > 1.5 * before
    assert after == pytest.approx(choice.separation, rel=0.2)
    low, high = command_limits(arm).T
    assert ((low <= choice.motion.commands) & (choice.motion.commands <= high)).all()


def test_only_jumps_tell_a_servos_damping_from_its_joints(hand):
    """Below its limit a motor's damping is the joint's: the same torque. At the limit it is none."""
    sets = tuple(
        (EffectSetting(name=name, element="mid1", parameters=by),)
        for name, by in (("servo_damping", {"kv_scale": 3.0}), ("joint_damping", {"damping_Nms_rad": 0.16}))
    )
    rivals = Rivals(Replayer(hand), sets, hand.file.noise, ("joint_position",))
    motions = [m for m in all_motions(hand, 2.0) if "in the air" in m.name]
    jumps = np.array(["jumps" in m.name for m in motions])
    apart, _ = separations(rivals, motions, 2, 7)
    assert apart[~jumps].max() < 0.02 < 0.1 < apart[jumps].min(), apart


def test_a_world_is_no_rival_of_its_own(tied, arm):
    same = Rivals(tied.replayer, (tied.sets[0], tied.sets[0]), tied.noise, tied.channels)
    apart, _ = separations(same, all_motions(arm, 2.0)[:2], 3, 5)
    other, _ = separations(tied, all_motions(arm, 2.0)[:2], 3, 5)
    assert apart.max() < 0.01 < 0.3 < other.max(), apart


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
        rivals = Rivals(tied.replayer, tied.sets, tied.noise, tied.channels, limit)
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


def test_too_little_data_asks_for_the_usual_motions(arm, arm_episodes, cube):
    words, motions = proposal.usual_proposal(arm, recordings(arm, arm_episodes(count=3)), 8)
    assert [m.name for m in motions] == ["free_sweep"] == [m.name for m in usual_motions(arm, 2.0)]
    assert (words.name, words.file) == ("the usual motions in turn", "motion.parquet")
    assert words.reason == "at least 5 more episodes, the object put back before each"
    # Enough episodes in which nothing moves are as good as none.
    still, _ = proposal.usual_proposal(arm, recordings(arm, arm_episodes(count=8)), 8)
    assert still.reason.startswith("at least 8 more episodes")


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
    spread = floor(replayer, recs, begin, plan, arm.file.noise, rng, 4)
    raw = residual(recs, plan, readings)
    level = score(raw, spread, plan)
    shelf = library(replayer, recs, begin, plan, raw, None)
    return Problem(replayer, recs, begin, plan, level, [], arm.file.noise, "declared", Streams(2), shelf, readings, raw)


def tie(arm, *names: str) -> SimpleNamespace:
    """What the search hands over: fits of one effect each, which it cannot tell apart."""
    some = [candidate(n, arm) for n in names]
    return SimpleNamespace(tied=tuple(SimpleNamespace(labels=(c.label,), members=((c, c.high),)) for c in some))


@pytest.mark.parametrize(
    ("separation", "reason"),
    [
        (
            2.04,
            "a wrong cause would be 2 floors worse, in the usual motions 0.31",
        ),
        (
            0.01,
            "a wrong cause would be 0.01 floors worse, in the usual motions 0.31; "
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
    words, motions = proposal.separating(problem, tie(arm, "joint_damping", "joint_dry_friction"))
    assert motions == (motion,)
    assert (words.name, words.file) == ("fast reversals", "motion.parquet")
    assert words.separates == ("joint_damping", "joint_dry_friction")
    how = "play it 8 times and diagnose old and new together; best of 6 motions: "
    assert (words.expected_separation, words.reason) == (separation, how + reason)
    ((rivals, duration_s),) = asked
    assert duration_s == 1.6
    assert [s.name for (s,) in rivals.sets] == ["joint_damping", "joint_dry_friction"]
    assert rivals.force_limit_n is None, "the arm feels nothing"


def test_where_no_motion_stays_within_the_limits_the_recorded_task_is_named(problem, arm, monkeypatch):
    monkeypatch.setattr(proposal, "separating_motion", lambda *_: None)
    words, motions = proposal.separating(problem, tie(arm, "joint_damping", "joint_dry_friction"))
    assert motions == ()
    assert words.name in ("slow", "fast")
    assert (words.file, words.reason) == (None, None)


def test_no_motion_is_proposed_for_what_follows_a_recording(problem, arm, monkeypatch):
    """What it would follow in another motion nobody knows."""
    monkeypatch.setattr(proposal, "separating_motion", lambda *_: pytest.fail("a motion was simulated"))
    words, motions = proposal.separating(problem, tie(arm, "joint_damping", "supply_sag"))
    assert (words.name in ("slow", "fast"), words.file, motions) == (True, None, ())
