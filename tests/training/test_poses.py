"""Increments and means of poses."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from candata.loaders.increments import increments, integrate
from candata.rotation import exp, multiply, normalise
from candata.training import poses


def track(rng, *shape):
    return np.concatenate([rng.normal(size=(*shape, 3)), normalise(rng.normal(size=(*shape, 4)))], axis=-1)


def scipy_of(quaternion):
    return Rotation.from_quat(np.roll(quaternion, -1, axis=-1))


def test_integrating_the_increments_gives_the_poses_back(rng):
    rows = track(rng, 4, 6)
    found = integrate(rows[:, 0], increments(rows))
    np.testing.assert_allclose(found[..., :3], rows[:, 1:, :3], atol=1e-12)
    assert poses.rotation_error(found, rows[:, 1:]).max() < 1e-7  # an angle near 0 loses half the digits


def test_an_increment_turns_in_the_world(rng):
    start, omega = track(rng), np.array([0.1, -0.2, 0.3])
    found = integrate(start, np.concatenate([np.zeros(3), omega])[None])[0]
    expected = Rotation.from_rotvec(omega) * scipy_of(start[3:])
    assert (scipy_of(found[3:]) * expected.inv()).magnitude() < 1e-12


def test_samples_share_a_start(rng):
    start, steps = track(rng, 3), rng.normal(0, 0.1, (5, 3, 4, 6))
    found = integrate(start, steps)
    assert found.shape == (5, 3, 4, 7)
    np.testing.assert_allclose(found[2], integrate(start, steps[2]))


def test_the_mean_is_scipys_whatever_the_signs(rng):
    middle = track(rng, 3)
    spread = np.concatenate([np.zeros((9, 3, 3)), multiply(exp(0.4 * rng.normal(size=(9, 3, 3))), middle[:, 3:])], -1)
    spread[::2, ..., 3:] *= -1
    found = poses.mean_pose(spread)
    for row in range(3):
        known = scipy_of(spread[:, row, 3:]).mean()
        assert (scipy_of(found[row, 3:]) * known.inv()).magnitude() < 1e-7
    np.testing.assert_array_equal(poses.mean_pose(middle[None])[..., :3], middle[..., :3])


def test_errors_are_distance_and_angle(rng):
    pose = track(rng)
    other = pose.copy()
    other[:3] += [0.3, 0.0, 0.4]
    other[3:] = -multiply(exp(np.array([0.0, 0.25, 0.0])), pose[3:])
    np.testing.assert_allclose(poses.position_error(pose, other), 0.5)
    np.testing.assert_allclose(poses.rotation_error(pose, other), 0.25)
