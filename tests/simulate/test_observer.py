"""The observer against its law, written out with whole rotations."""

from __future__ import annotations

import numpy as np
import pytest

from candata.rotation import difference, exp, multiply, normalise
from candata.scenes import load_scene
from candata.simulate import Observer, at_rest
from candata.simulate.observer import Follower

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
    Follower(scene, Observer(recorded)).correct(ROW, state, touch, out)
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
