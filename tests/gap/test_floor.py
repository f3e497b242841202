"""The floor: what null replays show when nothing but sensor noise differs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.measure.floor import floor, null_recordings, perturbed
from candata.gap.replay.hand_starts import STILL_ROWS
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import layout
from candata.gap.replay.starts import starts
from candata.rotation import difference
from candata.schema.scene import Noise


def floor_of(scene, episodes, replicas: int = 8, seed: int = 0, world=()):
    recs, replayer = recordings(scene, episodes), Replayer(scene)
    begin = starts(scene, recs)
    plan = layout(scene, recs, begin, replay_all(replayer, recs, begin, [()])[0])
    return plan, floor(replayer, recs, begin, plan, scene.file.noise, np.random.default_rng(seed), replicas, world)


@pytest.fixture(scope="module")
def arm_floor(arm, arm_episodes):
    return floor_of(arm, arm_episodes(count=4))


def test_the_spread_of_a_floor_is_positive_and_as_large_as_the_noise(arm, arm_floor):
    plan, found = arm_floor
    assert found.sigma.shape == (4, *plan.phase.shape[1:], 2)
    assert (found.sigma > 0).all()
    # A block mean of five rows keeps 1 / sqrt(5) of the noise; the start, known to 1 / sqrt(8), and the observer that
    # follows the noise add some.
    least = arm.file.noise.joint_position / np.sqrt(plan.rows)
    assert np.median(found.sigma[plan.phase >= 0]) == pytest.approx(least, rel=0.3)


def test_the_floor_grows_with_the_noise(arm, arm_episodes, arm_floor):
    loud = replace(arm, file=arm.file.model_copy(update={"noise": Noise(joint_position=0.01)}))
    _, found = floor_of(loud, arm_episodes(count=4))
    # Ten times the noise in a world that is nearly linear.
    assert np.median(found.sigma) == pytest.approx(10 * np.median(arm_floor[1].sigma), rel=0.2)


def test_nulls_are_centred_and_differ(arm_floor):
    _, found = arm_floor
    # Mean of 8 x 4 x 32 x 2 values with neighbours that are alike: a tenth of their spread is far out.
    assert abs(np.nanmean(found.null)) < 0.1 * np.nanstd(found.null)
    assert len({r.tobytes() for r in found.null}) == len(found.null)


def test_every_episode_has_a_spread_of_its_own(cube, played):
    plan, found = floor_of(cube, played(cube, count=3, duration_s=0.6))
    impact = plan.phases.index("impact")
    sizes = [np.unique(found.sigma[e][plan.phase[e] == impact][:, 0]) for e in range(3)]
    # One spread an episode, column and phase; a bounce magnifies the start's noise differently in each.
    assert [len(s) for s in sizes] == [1, 1, 1]
    assert max(sizes) > 1.2 * min(sizes)


def test_a_floor_follows_its_seed(arm, arm_episodes, arm_floor):
    episodes = arm_episodes(count=4)
    assert np.array_equal(floor_of(arm, episodes)[1].null, arm_floor[1].null, equal_nan=True)
    assert not np.array_equal(floor_of(arm, episodes, seed=1)[1].null, arm_floor[1].null, equal_nan=True)


def test_the_world_that_is_taken_for_true_is_in_both_null_and_replay(arm, arm_episodes, arm_floor, planted):
    # Were it in one only, the nulls would show the effect: some 300 floors.
    _, found = floor_of(arm, arm_episodes(count=4), world=planted("joint_damping", damping_Nms_rad=1.0))
    assert np.nanstd(found.null) < 2 * np.nanstd(arm_floor[1].null)


def test_perturbed_starts_are_off_by_what_averaging_leaves(hand, rng, plain_recordings):
    joints = np.zeros((400, 10, len(hand.file.joints)))
    pose = np.tile(hand.model.qpos0[hand.object_qpos : hand.object_qpos + 7], (400, 10, 1))
    recs = plain_recordings(commands=joints, joint_position=joints, object_pose=pose)
    begin = starts(hand, recs)
    moved = perturbed(Replayer(hand), begin, hand.file.noise, rng)
    at = hand.object_qpos
    off = moved.qpos - begin.qpos
    # 400 values or more know a standard deviation to 3.5 %.
    for columns, size in (
        (hand.joint_qpos, hand.file.noise.joint_position),
        ([at, at + 1], hand.file.noise.object_pose[0]),
    ):
        assert off[:, columns].std() == pytest.approx(size / np.sqrt(STILL_ROWS), rel=0.12)
    turned = difference(moved.qpos[:, at + 3 : at + 7], begin.qpos[:, at + 3 : at + 7])
    assert turned.std() == pytest.approx(hand.file.noise.object_pose[1] / np.sqrt(STILL_ROWS), rel=0.12)
    assert not off[:, at + 2].any(), "a resting object stands on its support"
    assert np.array_equal(moved.qvel, begin.qvel)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("joint_offset", {"offset_rad": (-0.05,) * 12}),
        ("pose_bias", {"bias_m": (0.03, -0.02, 0.01)}),
        ("pose_rotation_bias", {"bias_rad": (0.1, 0.2, -0.1)}),
    ],
)
def test_a_world_whose_sensors_err_starts_where_they_read_what_was_recorded(hand, played, planted, rng, name, values):
    recs = recordings(hand, played(hand, count=2, duration_s=0.3))
    begin = starts(hand, recs)
    nulls = null_recordings(Replayer(hand), recs, begin, Noise(), rng, 2, planted(name, **values))
    pose = slice(hand.object_qpos, hand.object_qpos + 7)
    for channel, columns in (("joint_position", hand.joint_qpos), ("object_pose", pose)):
        read = nulls.readings[channel][:2, 0]
        assert read == pytest.approx(begin.qpos0[:, columns], abs=2e-3)  # no noise; turns add up to first order
