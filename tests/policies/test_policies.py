"""Scripted policies: within limits, repeatable, and each touches the object as it is meant to."""

from __future__ import annotations

import numpy as np
import pytest

from candata.policies import policy, policy_names
from candata.policies._drive import command_range
from candata.policies.free_sweep import SWEEP_SHARE
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes

EPISODES = 4


@pytest.fixture(scope="module", params=["xhand_tabletop", "gripper_tabletop"])
def hand(request):
    return load_scene(request.param)


@pytest.fixture(scope="module")
def episodes(hand):
    """Four episodes of each policy of the scene, without noise."""
    jobs = [EpisodeJob(f"{p}{i}", i, p, 11) for p in hand.policies for i in range(EPISODES)]
    made = make_episodes(hand, jobs, duration_s=3.2)
    return {p: [e for e in made if e.meta.task == p] for p in hand.policies}


def contact(some) -> np.ndarray:
    """Share of the rows with contact, an episode each."""
    return np.array([e["contact"].mean() for e in some])


def lift(some) -> np.ndarray:
    """Highest rise of the object [m]."""
    return np.array([np.ptp(e["object_pose"][:, 2]) for e in some])


def travel(some) -> np.ndarray:
    """Farthest move over the table [m]."""
    return np.array([np.linalg.norm(e["object_pose"][:, :2] - e["object_pose"][0, :2], axis=1).max() for e in some])


@pytest.mark.parametrize("name", policy_names())
def test_plans_repeat_and_stay_within_limits(name):
    for scene in map(load_scene, ("cube_toss", "gripper_tabletop", "xhand_tabletop", "xarm7_xhand")):
        if not policy(name).possible(scene):
            continue
        plan, again, other = (policy(name).plan(scene, np.random.default_rng(s), 1.0) for s in (1, 1, 2))
        assert np.array_equal(plan.commands, again.commands)
        assert np.array_equal(plan.qpos, again.qpos)
        assert not (np.array_equal(plan.commands, other.commands) and np.array_equal(plan.qpos, other.qpos))
        low, high = command_range(scene).T if len(scene.actuator_ids) else (0, 0)
        assert ((low <= plan.commands) & (plan.commands <= high)).all()
        assert np.isfinite(plan.qpos).all()


@pytest.mark.parametrize("name", policy_names())
def test_variants_repeat_stay_within_limits_and_have_their_own_words(name, hand):
    low, high = command_range(hand).T
    usual = policy(name).plan(hand, np.random.default_rng(1), 2.0) if policy(name).possible(hand) else None
    for variant in policy(name).variants:
        plan, again = (variant.plan(hand, np.random.default_rng(1), 2.0) for _ in range(2))
        assert np.array_equal(plan.commands, again.commands)
        assert plan.commands.shape == usual.commands.shape
        assert ((low <= plan.commands) & (plan.commands <= high)).all()
        assert np.abs(plan.commands - usual.commands).max() > 0.05, "another motion"
    words = [v.words for v in policy(name).variants]
    assert len(set(words)) == len(words)


def test_reversals_in_the_air_touch_nothing_and_the_carry_goes_far(hand):
    from candata.policies import Motion

    made = {}
    for name in ("free_sweep", "grasp_lift_shake"):
        for v in policy(name).variants:
            plan = v.plan(hand, np.random.default_rng(2), 3.2)
            made[v.words] = EpisodeJob(v.words, 0, v.words, 1, motion=Motion(v.words, plan.commands, np.zeros(3)))
    played = dict(zip(made, make_episodes(hand, list(made.values()), duration_s=3.2), strict=True))
    for words, e in played.items():
        if "air" in words:
            assert not e["contact"].any(), words
    assert lift([played["lift high and put down"]])[0] > 0.08
    assert travel([played["lift and carry to both sides"]])[0] > 0.08


def test_every_policy_can_act_somewhere():
    scenes = [load_scene("cube_toss"), load_scene("xhand_tabletop")]
    assert all(any(policy(p).possible(s) for s in scenes) for p in policy_names())


def test_joints_follow_their_targets_in_the_free_sweep(episodes, hand):
    for e in episodes["free_sweep"]:
        error = e["joint_position"] - e["action"]
        swept = round(SWEEP_SHARE * len(error))
        rails = len(hand.file.groups["wrist"])
        assert np.sqrt((error[:swept, rails:] ** 2).mean()) < 0.1, "hinges [rad]"
        assert np.abs(error[:, :rails]).max() < 0.02, "wrist [m]"
        moving = e["action"][:swept].std(0) > 0.02
        for j in np.flatnonzero(moving & np.isin(np.arange(error.shape[1]), hand.driven_hinges)):
            assert np.corrcoef(e["joint_position"][:swept, j], e["action"][:swept, j])[0, 1] > 0.9


def test_the_jumps_at_the_end_of_the_sweep_drive_every_motor_to_its_limit(episodes, hand):
    model, ids = hand.model, hand.actuator_ids
    for e in episodes["free_sweep"]:
        error = (e["action"] - e["joint_position"])[round(SWEEP_SHARE * len(e)) :]
        moving = e["action"][: len(e) // 2].std(0) > 0.02
        asked = np.abs(error * model.actuator_gainprm[ids, 0]).max(0)
        hinges = np.isin(np.arange(len(ids)), hand.driven_hinges)
        assert (asked > model.actuator_forcerange[ids, 1])[hinges & moving].all()


def test_the_free_sweep_touches_nothing(episodes):
    assert (contact(episodes["free_sweep"]) == 0).all()
    assert travel(episodes["free_sweep"]).max() < 1e-3


def test_the_grasp_lifts_the_object_and_lets_go(episodes):
    some = episodes["grasp_lift_shake"]
    assert (lift(some) > 0.03).sum() >= EPISODES - 1
    assert (contact(some) > 0.5).all()
    for e in some:
        assert not e["contact"][0]
        assert e["fingertip_contact"][100:160].any(0).sum() >= 3, "several fingertips hold it"


def test_the_push_moves_the_object_along_the_table(episodes):
    some = episodes["push"]
    assert (travel(some) > 0.02).all()
    assert (contact(some) > 0.2).all()
    assert (lift(some) < 0.02).all()
    assert not any(e["contact"][0] for e in some)


@pytest.mark.parametrize("name", ["squeeze", "roll"])
def test_the_object_is_held_where_it_stands(episodes, name):
    some = episodes[name]
    assert (contact(some) > 0.5).all()
    assert (lift(some) < 0.03).all()
    for e in some:
        assert e["fingertip_contact"][:, 0].any(), "the thumb opposes"
        assert e["fingertip_contact"][:, 1:].any()


def test_the_toss_flies_and_lands():
    scene = load_scene("cube_toss")
    for e in make_episodes(scene, [EpisodeJob(f"t{i}", i, "toss", 3) for i in range(4)], duration_s=0.8):
        z = e["object_pose"][:, 2]
        assert z[0] > 0.1
        # It stands on a face, or is about to; the default contact is soft: it gives 17 mm on impact.
        assert 0.05 < z[-1] < 0.1
        assert z.min() > 0.03
