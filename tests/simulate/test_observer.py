"""The observer against its law, written out with whole rotations."""

from __future__ import annotations

import numpy as np
import pytest

from candata.rotation import difference, exp, multiply, normalise
from candata.scenes import load_scene
from candata.simulate import Observer, at_rest
from candata.simulate.observer import ERROR_AVERAGE_SHARE, NOISE_SHARE, Follower

COUNT, ROW = 12, 1


@pytest.fixture(scope="module")
def hand():
    return load_scene("xhand_tabletop")


@pytest.fixture
def start(hand):
    """States of the hand with the object turned at random, and recordings a little off them."""
    rng = np.random.default_rng(2)
    qpos = at_rest(hand, COUNT)[0]
    at = hand.object_qpos
    qpos[:, at + 3 : at + 7] = normalise(rng.normal(size=(COUNT, 4)))
    pose = np.repeat(qpos[:, None, at : at + 7], 3, axis=1)
    pose[..., :3] += rng.normal(size=(COUNT, 3, 3)) * 0.006
    pose[..., 3:] = multiply(exp(rng.normal(size=(COUNT, 3, 3)) * 0.08), pose[..., 3:])
    joints = qpos[:, None, hand.joint_qpos] + rng.normal(size=(COUNT, 3, len(hand.joint_qpos))) * 0.01
    return qpos, {"object_pose": pose, "joint_position": joints}


def corrected(scene, recorded, touch, qpos):
    at = scene.object_qpos
    state = {"object_pose": qpos[:, at : at + 7].copy(), "joint_position": qpos[:, scene.joint_qpos]}
    out = qpos.copy()
    Follower(scene, Observer(recorded)).correct(ROW, state, touch, out, np.zeros((len(out), scene.model.nv)))
    return out


def by_law(scene, recorded, touch, qpos):
    observer, at, out = Observer(recorded), scene.object_qpos, qpos.copy()
    out[:, scene.joint_qpos] += observer.joint_gain * (recorded["joint_position"][:, ROW] - out[:, scene.joint_qpos])
    target, now = recorded["object_pose"][:, ROW], qpos[:, at : at + 7]
    shift, turn = target[:, :3] - now[:, :3], difference(target[:, 3:], now[:, 3:])
    near = (np.linalg.norm(shift, axis=1) <= observer.guard_m) & (np.linalg.norm(turn, axis=1) <= observer.guard_rad)
    gain = np.where(near & touch, observer.pose_gain, observer.free_gain)[:, None]
    assert 0 < np.sum(near & touch) < np.sum(touch) < COUNT
    out[:, at : at + 3] += gain * shift
    out[:, at + 3 : at + 7] = normalise(multiply(exp(gain * turn), now[:, 3:]))
    return out


def test_it_pulls_as_its_law_says(hand, start):
    qpos, recorded = start
    touch = np.arange(COUNT) % 3 > 0
    np.testing.assert_allclose(
        corrected(hand, recorded, touch, qpos), by_law(hand, recorded, touch, qpos), rtol=0, atol=1e-15
    )


def test_the_other_sign_of_a_quaternion_is_the_same_recording(hand, start):
    qpos, recorded = start
    other = {**recorded, "object_pose": recorded["object_pose"] * np.r_[1, 1, 1, -1, -1, -1, -1]}
    touch = np.zeros(COUNT, bool)
    np.testing.assert_allclose(
        corrected(hand, other, touch, qpos), corrected(hand, recorded, touch, qpos), rtol=0, atol=1e-15
    )


def test_what_was_recorded_already_stays(hand, start):
    qpos, _ = start
    at = hand.object_qpos
    there = {"object_pose": np.repeat(qpos[:, None, at : at + 7], 3, axis=1)}
    np.testing.assert_allclose(corrected(hand, there, np.zeros(COUNT, bool), qpos), qpos, rtol=0, atol=1e-15)


def test_each_gap_in_a_recording_pulls_nothing_of_its_own(hand, start):
    qpos, recorded = start
    pose, joints = recorded["object_pose"].copy(), recorded["joint_position"].copy()
    pose[0, ROW, 2], joints[0, ROW, 0] = np.nan, np.nan
    touch = np.zeros(COUNT, bool)
    found = corrected(hand, {"object_pose": pose, "joint_position": joints}, touch, qpos)
    full = corrected(hand, recorded, touch, qpos)
    at, joint = hand.object_qpos, hand.joint_qpos
    np.testing.assert_allclose(found[0, at : at + 7], qpos[0, at : at + 7], rtol=0, atol=1e-15)
    assert found[0, joint[0]] == qpos[0, joint[0]]
    np.testing.assert_array_equal(found[0, joint[1:]], full[0, joint[1:]])
    np.testing.assert_array_equal(found[1:], full[1:])


NOISE, ROWS = 0.001, 400


def pulled(scene, off, noise=NOISE, unseen=(), shake=0.0):
    """How far off joints are (ROWS, J) that begin `off` what was recorded, pulled and moved by nothing else."""
    qpos = at_rest(scene, 1)[0]
    told = np.repeat(qpos[:, None, scene.joint_qpos], ROWS, axis=1)
    told += shake * np.random.default_rng(0).normal(size=told.shape)
    told[:, list(unseen)] = np.nan
    follower = Follower(scene, Observer({"joint_position": told}, joint_noise=noise))
    begin = qpos[:, scene.joint_qpos].copy()
    qpos[:, scene.joint_qpos] += off
    out = []
    for row in range(ROWS):
        out.append(qpos[0, scene.joint_qpos] - begin[0])
        follower.correct(
            row,
            {"joint_position": qpos[:, scene.joint_qpos].copy()},
            np.zeros(1, bool),
            qpos,
            np.zeros((1, scene.model.nv)),
        )
    return np.array(out)


def test_what_noise_can_explain_of_a_joint_is_left(hand):
    off = pulled(hand, 0.9 * NOISE_SHARE * NOISE)
    np.testing.assert_array_equal(off, off[:1].repeat(ROWS, 0))


def test_more_is_pulled_back_to_that_and_no_further(hand):
    off = pulled(hand, 10 * NOISE)
    assert (np.diff(off, axis=0) <= 0).all()
    assert off[-1] == pytest.approx(NOISE_SHARE * NOISE, rel=0.05)
    assert pulled(hand, 10 * NOISE, noise=0.0)[-1] == pytest.approx(0, abs=0.01 * NOISE)


def test_the_average_of_an_error_takes_up_a_share_of_each_row(hand):
    off, gain = 10 * NOISE, Observer({}).joint_gain
    first = off - gain * (ERROR_AVERAGE_SHARE * off - NOISE_SHARE * NOISE)
    assert pulled(hand, off)[1] == pytest.approx(first, rel=1e-12)


def test_rows_that_are_missing_pull_nothing_and_are_no_error(hand):
    off = pulled(hand, 10 * NOISE, unseen=range(100, 150))
    np.testing.assert_array_equal(off[100:151], off[100:101].repeat(51, 0))
    assert off[151, 0] - off[150, 0] == pytest.approx(off[100, 0] - off[99, 0], rel=0.05)


def test_noise_moves_joints_by_a_small_part_of_what_it_would(hand):
    still, moved = (pulled(hand, 0.0, noise, shake=NOISE) for noise in (NOISE, 0.0))
    assert np.abs(np.diff(still, axis=0)).mean() < 0.1 * np.abs(np.diff(moved, axis=0)).mean()
