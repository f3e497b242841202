"""Scores: the Student-t loss of residuals in units of the floor's spread, over that of the nulls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t

from candata.gap.data.robust_loss import NU, weights
from candata.gap.fit.comparison import null_level
from candata.gap.measure.floor import Floor, spread
from candata.gap.measure.score import score
from candata.gap.replay.residuals import Layout
from candata.schema.scene import Noise

E, B, D, R = 3, 6, 3, 10


PLAN = Layout(
    (("joint_position", "a", "rad"), ("joint_position", "b", "rad"), ("object_pose", "position x", "m")),
    ("free",),
    np.zeros((E, B), int),
    5,
)


@pytest.fixture
def case(rng):
    """A residual, and a floor whose spread differs by episode and by quantity."""
    sigma = np.array([1.0, 2.0, 5.0])[:, None, None] * np.array([1.0, 2.0, 0.01]) * np.ones((E, B, D))
    null = sigma * rng.standard_normal((R, E, B, D))
    return 3 * sigma * rng.standard_normal((E, B, D)), Floor(sigma, null)


def test_the_loss_is_student_s_t(case):
    residual, floor = case
    level = score(residual, floor, PLAN)
    z = residual.reshape(E, -1) / floor.sigma.reshape(E, -1)
    null = floor.null.reshape(R, E, -1) / floor.sigma.reshape(E, -1)

    def rho(x):
        return 0.5 * (NU + 1) * np.log(1 + x**2 / NU)

    expected = rho(z).mean(-1) / rho(null).mean(-1).mean(0)
    # Residuals are kept in single precision.
    np.testing.assert_allclose(level.loss(level.normal(residual)), expected, rtol=1e-5)


def test_the_density_is_that_of_student_s_t_of_the_spread(case):
    residual, floor = case
    level = score(residual, floor, PLAN)
    scale = floor.sigma.reshape(E, -1)
    expected = (t.logpdf(residual.reshape(E, -1) / scale, NU) - np.log(scale)).mean(-1) - t.logpdf(0, NU)
    np.testing.assert_allclose(level.density(level.normal(residual)), expected, rtol=1e-5)
    residual[:, 0, 0] = np.nan
    some = score(residual, floor, PLAN)
    seen = np.isfinite(residual.reshape(E, -1))
    each = t.logpdf(np.nan_to_num(residual).reshape(E, -1) / scale, NU) - np.log(scale) - t.logpdf(0, NU)
    expected = (each * seen).sum(-1) / seen.sum(-1)
    np.testing.assert_allclose(some.density(some.normal(residual)), expected, rtol=1e-5)


def test_nulls_lose_one_on_average(case):
    level = score(*case, PLAN)
    np.testing.assert_allclose(level.null_loss.mean(0), 1.0, rtol=1e-6)
    np.testing.assert_allclose(level.loss(level.null), level.null_loss, rtol=1e-6)
    np.testing.assert_allclose(level.size(level.null).mean(0), 1.0, rtol=1e-6)


@pytest.mark.parametrize("replicas", [4, 16])
def test_a_recording_of_the_nominal_scene_loses_one_by_however_few_nulls(rng, replicas):
    # Heavy tails, as where contact is chaos; the spread is the nulls' own.
    plan = replace(PLAN, columns=PLAN.columns[:2], phase=np.zeros((20, 40), int))

    def draw(n):
        return rng.standard_t(3.0, (n, 20, 1, 1)) * rng.standard_normal((n, 20, 40, 2))

    means, above, own = [], [], []
    for seed in range(40):
        level = score(draw(1)[0], spread(Noise(joint_position=1e-6), plan, draw(replicas)), plan, seed=seed)
        fresh = np.array([level.loss(level.normal(r)).mean() for r in draw(4)])
        means.append(fresh.mean())
        above.append(fresh > null_level(level))
        own.append(level.loss(level.null).mean())
    assert np.mean(means) == pytest.approx(1.0, abs=0.06)
    assert np.mean(above) < 0.06
    assert np.mean(own) < 0.97, "they lie nearer what was learnt from them"


def test_the_discrepancy_is_linear_in_the_residual_and_the_loss_is_not(case):
    residual, floor = case
    level = score(residual, floor, PLAN)
    z = level.normal(residual)
    np.testing.assert_allclose(level.size(7 * z), 7 * level.size(z), rtol=1e-5)
    assert (level.loss(7 * z) < 7 * level.loss(z)).all()


def test_units_drop_out(case):
    residual, floor = case
    scaled = Floor(1e3 * floor.sigma, 1e3 * floor.null)
    a, b = score(residual, floor, PLAN), score(1e3 * residual, scaled, PLAN)
    np.testing.assert_allclose(a.loss(a.normal(residual)), b.loss(b.normal(1e3 * residual)), rtol=1e-5)


def test_what_was_not_recorded_counts_neither_for_nor_against(case):
    residual, floor = case
    residual[0, :3] = np.nan
    level = score(residual, floor, PLAN)
    z = level.normal(residual)
    assert not z[~level.mask].any()
    assert (~level.mask).sum() == 3 * D
    shorter = Floor(floor.sigma[:1, 3:], floor.null[:, :1, 3:])
    short = score(residual[:1, 3:], shorter, replace(PLAN, phase=PLAN.phase[:1, 3:]))
    part = short.normal(residual[:1, 3:])
    assert level.loss(z)[0] == pytest.approx(short.loss(part)[0], rel=1e-5)
    assert level.size(z)[0] == pytest.approx(short.size(part)[0], rel=1e-5)


def test_a_quantity_that_was_not_recorded_has_no_discrepancy(case):
    residual, floor = case
    residual[0, :, 2] = np.nan
    level = score(residual, floor, PLAN)
    joints = score(
        residual[..., :2],
        replace(floor, sigma=floor.sigma[..., :2], null=floor.null[..., :2]),
        replace(PLAN, columns=PLAN.columns[:2]),
    )
    expected = joints.size(joints.normal(residual[..., :2]))[0]
    assert level.size(level.normal(residual))[0] == pytest.approx(expected, rel=1e-5)


def test_the_discrepancy_is_the_mean_over_quantities_of_error_over_null_error(case):
    residual, floor = case
    level = score(residual, floor, PLAN)
    error, null = np.abs(residual), np.abs(floor.null)
    joints = error[..., :2].mean((1, 2)) / null[..., :2].mean((2, 3)).mean(0)
    position = error[..., 2].mean(1) / null[..., 2].mean(2).mean(0)
    np.testing.assert_allclose(level.size(level.normal(residual)), (joints + position) / 2, rtol=1e-5)


def test_some_episodes_score_as_they_do_among_all(case):
    residual, floor = case
    level = score(residual, floor, PLAN)
    z, index = level.normal(residual), np.array([2, 0])
    np.testing.assert_array_equal(level.take(index).loss(z[index]), level.loss(z)[index])
    np.testing.assert_array_equal(level.take(index).size(z[index]), level.size(z)[index])


def test_one_outlier_does_not_outweigh_an_episode(case):
    residual, floor = case
    level = score(residual, floor, PLAN)
    z = level.normal(np.zeros_like(residual))
    wild, mild = z.copy(), z.copy()
    wild[0, 0] = 1000.0
    mild[0] = 3.0
    # 3 log(1 + 1000^2 / 5) once against 3 log(1 + 3^2 / 5) eighteen times.
    assert level.loss(wild)[0] < level.loss(mild)[0]
    assert level.size(wild)[0] > level.size(mild)[0], "the discrepancy is not robust: it is what is reported"


def test_weights_are_the_loss_s_slope_over_the_residual():
    z = np.array([0.01, 0.5, 1.0, 4.0, 30.0])
    step = 1e-4

    def rho(x):
        return 0.5 * (NU + 1) * np.log1p(x**2 / NU)

    slope = (rho(z + step) - rho(z - step)) / (2 * step)
    # Central differences err by step^2; single precision by 1e-7.
    np.testing.assert_allclose(weights(z.astype(np.float32)) * z, slope, rtol=1e-4)
