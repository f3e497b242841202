"""Metrics against closed forms and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from candata.rotation import exp, multiply, normalise, rotate
from candata.training import metrics


def random_poses(rng, *shape):
    return np.concatenate([rng.normal(0, 0.05, (*shape, 3)), normalise(rng.normal(size=(*shape, 4)))], axis=-1)


def brute_adds(cloud, predicted, truth):
    placed = [rotate(pose[3:], cloud) + pose[:3] for pose in (truth, predicted)]
    return cdist(*placed).min(1).mean()


def test_adds_is_that_of_brute_force(rng):
    cloud = rng.normal(0, 0.03, (200, 3))
    predicted, truth = random_poses(rng, 5, 4), random_poses(rng, 5, 4)
    found = metrics.adds(cloud, predicted, truth)
    brute = [
        [brute_adds(cloud, *pair) for pair in zip(*row, strict=True)] for row in zip(predicted, truth, strict=True)
    ]
    np.testing.assert_allclose(found, brute, rtol=0, atol=2e-9)  # the promise; rounding alone is 1e-16


def test_adds_of_many_poses_in_several_parts(rng, monkeypatch):
    cloud = rng.normal(0, 0.03, (50, 3))
    predicted, truth = random_poses(rng, 7), random_poses(rng, 7)
    whole = metrics.adds(cloud, predicted, truth)
    monkeypatch.setattr(metrics, "_POSES", 3)
    monkeypatch.setattr(metrics, "_DISTANCES", 400)
    np.testing.assert_array_equal(metrics.adds(cloud, predicted, truth), whole)


def test_adds_is_exact_for_poses_that_nearly_agree_and_for_a_cloud_off_its_origin(rng):
    """The promise of 2e-9 m holds where |p - c|^2 from |p|^2 + |c|^2 - 2 p.c would lose half its digits."""
    cloud = rng.normal(0, 0.05, (300, 3)) + 5.0
    truth = random_poses(rng, 40)
    near = truth + np.where(np.arange(7) < 3, rng.normal(0, 1e-9, (40, 7)), 0)
    brute = [brute_adds(cloud, *pair) for pair in zip(near, truth, strict=True)]
    np.testing.assert_allclose(metrics.adds(cloud, near, truth), brute, rtol=0, atol=1e-13)  # rounding at 5 m
    assert metrics.adds(cloud, truth, truth).max() < 1e-13


def test_adds_of_a_shift_smaller_than_half_the_spacing_is_the_shift():
    cloud = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    truth = np.array([0.0, 0, 0, 1, 0, 0, 0])
    predicted = truth + np.array([0.02, 0.01, 0.02, 0, 0, 0, 0])
    assert metrics.adds(cloud, predicted, truth) == pytest.approx(0.03, abs=1e-12)


def test_adds_forgives_a_symmetry():
    square = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    truth = np.array([0.0, 0, 0, 1, 0, 0, 0])
    quarter = np.concatenate([truth[:3], exp(np.array([0, 0, np.pi / 2]))])
    assert metrics.adds(square, quarter, truth) < 1e-12


def test_each_window_is_scored_with_its_own_object(rng):
    clouds = rng.normal(0, 0.03, (2, 60, 3))
    predicted, truth = random_poses(rng, 3, 2), random_poses(rng, 3, 2)
    found = metrics.adds_of(clouds, np.array([1, 0, 1]), predicted, truth)
    for row, index in enumerate((1, 0, 1)):
        np.testing.assert_array_equal(found[row], metrics.adds(clouds[index], predicted[row], truth[row]))


def test_auc_is_the_area_under_the_curve(rng):
    errors = rng.uniform(0, 0.15, 400)
    thresholds = np.linspace(0, 0.1, 20_001)
    shares = np.searchsorted(np.sort(errors), thresholds, side="right") / len(errors)
    area = np.trapezoid(shares, thresholds) / 0.1
    assert metrics.auc(errors) == pytest.approx(area, abs=5e-5)  # one step of the thresholds
    # The paper's 88.23 is 11.8 mm.
    assert metrics.auc(np.array([0.01177])) == pytest.approx(0.8823, abs=1e-9)
    assert metrics.auc(np.array([0.1, 5.0])) == 0.0
    assert np.isnan(metrics.auc(np.array([])))


def test_the_energy_score_of_one_sample_is_its_error(rng):
    sample, truth = rng.normal(size=(1, 4, 3)), rng.normal(size=(4, 3))
    np.testing.assert_allclose(metrics.energy_score(sample, truth), np.linalg.norm(sample[0] - truth, axis=-1))


def test_the_energy_score_rewards_the_true_spread():
    rng = np.random.default_rng(3)
    truth = rng.normal(size=(4000, 3))
    scores = {s: metrics.energy_score(s * rng.normal(size=(8, 4000, 3)), truth).mean() for s in (0.3, 1.0, 3.0)}
    assert scores[1.0] < min(scores[0.3], scores[3.0])
    # E|x - y| of two standard normals in 3-D is 4/sqrt(pi); the score is half of it. 4000 rows: s.e. 0.011.
    assert scores[1.0] == pytest.approx(2 / np.sqrt(np.pi), abs=0.04)


def test_f1():
    found = metrics.f1(np.array([1, 1, 0, 0, 1]), np.array([1, 0, 1, 0, 1]))
    assert found == {"precision": 2 / 3, "recall": 2 / 3, "f1": 2 / 3}
    assert metrics.f1(np.zeros(3), np.zeros(3)) == {"precision": None, "recall": None, "f1": None}


def test_turned_and_moved_together_nothing_changes(rng):
    cloud = rng.normal(0, 0.03, (80, 3))
    predicted, truth = random_poses(rng), random_poses(rng)
    turn, shift = normalise(rng.normal(size=4)), rng.normal(size=3)

    def moved(pose):
        return np.concatenate([rotate(turn, pose[:3]) + shift, multiply(turn, pose[3:])])

    assert metrics.adds(cloud, moved(predicted), moved(truth)) == pytest.approx(metrics.adds(cloud, predicted, truth))
