"""Responses: curves through probes, planes through slopes, and the best coordinates on training episodes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from candata.gap.data.robust_loss import rho
from candata.gap.fit import response as module
from candata.gap.fit.candidates import Candidate
from candata.gap.fit.response import Curve, Plane

E, K = 6, 300


def candidate(choices: bool = False, low: float = -2.0, high: float = 4.0) -> Candidate:
    ends = np.array([low]), np.array([high])
    own = np.ones(1, bool), np.zeros(1)
    return Candidate("joint_damping", None, np.zeros(1), *ends, np.zeros(1, bool), choices, *own)


@pytest.fixture
def curve(rng):
    at = np.array([-1.0, 0.0, 0.5, 2.0])
    return Curve(candidate(), at, rng.standard_normal((4, E, K)).astype(np.float32), np.ones(4, bool))


def planted_plane(rng, truth: np.ndarray, outliers: float = 0.1, size: float = 50.0) -> Plane:
    """White residuals of unit spread that vanish at `truth` but for a share of gross errors of either sign."""
    slope = rng.standard_normal((len(truth), E, K)).astype(np.float32)
    z = rng.standard_normal((E, K)) - np.tensordot(truth, slope, 1)
    bad = rng.random((E, K)) < outliers
    z[bad] += size * np.abs(rng.standard_normal(bad.sum()))
    bound = np.full(len(truth), 1e3)
    return Plane(-bound, bound, np.zeros(len(truth)), z.astype(np.float32), slope)


def test_a_curve_is_exact_at_its_probes(curve):
    for u, z in zip(curve.at, curve.z, strict=True):
        # Single precision: z0 + 1 (z1 - z0) rounds twice.
        np.testing.assert_allclose(curve.read(np.array([u])), z, atol=1e-6)


def test_a_curve_is_linear_between_probes_and_constant_beyond(curve):
    between = curve.read(np.array([0.5 + 0.25 * 1.5]))
    np.testing.assert_allclose(between, 0.75 * curve.z[2] + 0.25 * curve.z[3], atol=1e-6)
    for beyond, last in ((-1.7, 0), (3.5, 3)):
        np.testing.assert_allclose(curve.read(np.array([beyond])), curve.z[last], atol=1e-6)


def test_the_neutral_residual_is_the_one_without_the_effect(curve):
    assert np.array_equal(curve.neutral(), curve.z[1])


def test_more_probes_are_put_in_order_and_one_that_stands_is_replaced(curve, rng):
    new = rng.standard_normal((2, E, K)).astype(np.float32)
    found = curve.with_probes(np.array([1.0, 0.5]), new)
    assert found.at.tolist() == [-1.0, 0.0, 0.5, 1.0, 2.0]
    assert np.array_equal(found.z[3], new[0])
    assert np.array_equal(found.z[2], new[1])


def test_a_curve_s_best_lies_where_residuals_cancel(white_score, rng):
    level = white_score(rng, E, K)
    slope = rng.standard_normal((E, K))
    at = np.array([-2.0, 0.0, 1.0, 2.0, 4.0])
    z = (0.1 * rng.standard_normal((E, K)) + (at[:, None, None] - 1.5) * slope).astype(np.float32)
    found = Curve(candidate(), at, z, np.ones(len(at), bool)).fitter(level)(np.arange(E))
    assert found[0] == pytest.approx(1.5, abs=0.02)
    # Also where none of the six points between two probes lies, a twelfth of their spacing from the nearest.
    moved = (z - np.float32(1 / 12) * slope.astype(np.float32)).astype(np.float32)
    found = Curve(candidate(), at, moved, np.ones(len(at), bool)).fitter(level)(np.arange(E))
    assert found[0] == pytest.approx(1.5 + 1 / 12, abs=0.02)


def test_a_curve_is_fitted_on_training_episodes_only(white_score, rng):
    level = white_score(rng, E, K)
    at = np.linspace(-2, 4, 13)
    aim = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    z = ((at[:, None] - aim)[..., None] * rng.standard_normal((1, E, K))).astype(np.float32)
    fit = Curve(candidate(), at, z, np.ones(len(at), bool)).fitter(level)
    assert [fit(np.arange(3))[0], fit(np.arange(3, 6))[0]] == pytest.approx([1.0, -1.0], abs=1e-6)


@pytest.mark.parametrize(("u", "least"), [(1.0, 1.5), (1.5, 1.5), (-0.5, 4.0), (3.0, 1.0), (4.0, 1.0)])
def test_a_convex_loss_may_fall_as_far_as_its_chords_lead(u, least):
    """Beside 1 the lines through 0 and 1, and through 4 and 2, meet at 1.5."""
    at, losses = np.array([-2.0, 0.0, 1.0, 2.0, 4.0]), np.array([9.0, 4.0, 2.5, 2.0, 5.0])
    level = SimpleNamespace(loss=lambda z: z[:, 0])
    curve = Curve(candidate(), at, np.repeat(losses, E * K).reshape(5, E, K), np.ones(5, bool))
    assert curve.least_around(np.array([u]), level) == pytest.approx(least)
    two = Curve(candidate(), at[:2], curve.z[:2], np.ones(2, bool))
    assert two.least_around(np.array([-1.0]), level) == 4.0


def test_a_choice_is_one_of_its_values(white_score, rng):
    level = white_score(rng, E, K)
    z = np.stack([rng.standard_normal((E, K)), 0.9 * rng.standard_normal((E, K))]).astype(np.float32)
    curve = Curve(candidate(choices=True, low=0, high=1), np.array([0.0, 1.0]), z, np.ones(2, bool))
    assert curve.grid().tolist() == [0.0, 1.0]
    assert curve.fitter(level)(np.arange(E))[0] in (0.0, 1.0)


def test_rescaling_a_response_is_rescaling_what_it_reads(curve, rng):
    factor = rng.uniform(0.5, 2, (E, K)).astype(np.float32)
    plane = planted_plane(rng, np.array([1.0, -2.0]))
    for response, u in ((curve, np.array([0.3])), (plane, np.array([0.4, 0.1]))):
        np.testing.assert_allclose(response.rescaled(factor).read(u), factor * response.read(u), rtol=1e-4, atol=1e-4)


TRUTH = np.array([1.0, -0.5, 2.0, 0.0])
#: Least squares on n = 1800 values of unit noise knows a unit slope to 1 / sqrt(n) = 0.024; the Student-t loss and the
#: lost tenth cost a little. Five of those for the worst of four.
KNOWN = 5 * 1.15 / np.sqrt(E * K)


def test_a_plane_finds_a_planted_combination_among_outliers(rng):
    plane = planted_plane(rng, TRUTH)
    np.testing.assert_allclose(plane.best(np.arange(E)), TRUTH, atol=KNOWN)
    # The control: plain least squares is off by more, so it is the weights that find it.
    flat = plane.slope.reshape(4, -1).T.astype(float)
    plain = np.linalg.lstsq(flat, -plane.z.ravel().astype(float), rcond=None)[0]
    assert np.abs(plain - TRUTH).max() > 2 * KNOWN


def test_a_plane_is_fitted_on_training_episodes_only(rng):
    plane = planted_plane(rng, TRUTH)
    plane.z[4:] = 1e3
    np.testing.assert_allclose(plane.best(np.arange(4)), TRUTH, atol=KNOWN * np.sqrt(6 / 4))


def test_a_plane_stays_within_its_bounds(rng):
    plane = planted_plane(rng, TRUTH)
    narrow = Plane(np.full(4, -0.2), np.full(4, 0.7), plane.at, plane.z, plane.slope)
    found = narrow.best(np.arange(E))
    assert ((found >= -0.2) & (found <= 0.7)).all()
    assert found[[0, 1, 2]].tolist() == [0.7, -0.2, 0.7]


def far_plane(rng) -> Plane:
    """A tenth of the values lie 40 spreads off and follow the coordinate; the rest hardly move, and for the worse."""
    slope = np.full((1, E, K), 0.04, np.float32)
    slope[..., : K // 10] = 1.0
    z = 0.3 * rng.standard_normal((E, K)).astype(np.float32)
    z[:, : K // 10] -= 40.0
    return Plane(np.array([-1e3]), np.array([1e3]), np.zeros(1), z, slope)


def test_graduated_weights_find_a_far_optimum(white_score, rng, monkeypatch):
    plane, level = far_plane(rng), white_score(rng, E, K)
    line = np.linspace(0, 60, 601)
    losses = [level.loss(plane.read(np.array([u]))).mean() for u in line]
    found = plane.best(np.arange(E))[0]
    # The least loss along the whole line, to the line's step and single precision.
    assert found == pytest.approx(line[int(np.argmin(losses))], abs=0.2)
    assert found > 35
    monkeypatch.setattr(module, "SCALES", (1.0,) * len(module.SCALES))
    assert plane.best(np.arange(E))[0] < 30, "without them, far values count as outliers and stay where they are"


@pytest.mark.parametrize("seed", [247, 273, 428])
def test_a_plane_is_left_where_it_is_rather_than_made_worse(seed):
    """Of these few readings, half of them gross errors, reweighting ends where the robust loss is higher."""
    draw = np.random.default_rng(seed)
    z = (draw.standard_normal((1, 12)) * draw.choice([0.3, 20], 12)).astype(np.float32)
    slope = (draw.standard_normal((2, 1, 12)) * 10).astype(np.float32)
    plane = Plane(np.full(2, -9.0), np.full(2, 9.0), np.zeros(2), z, slope)
    score = SimpleNamespace(loss=lambda z: rho(z).mean(-1))
    assert score.loss(plane.read(plane.best(np.arange(1))))[0] > score.loss(z)[0]
    assert plane.fitter(score)(np.arange(1)).tolist() == [0.0, 0.0]


def test_points_that_are_the_same_count_once(curve):
    at = curve.at[1] + np.array([0.0, 1e-13, 0.3])
    z = np.stack([curve.z[1]] * 3)
    more = curve.with_probes(at, z)
    assert len(more.at) == len(curve.at) + 1
    assert np.all(np.diff(more.at) > 0)


def test_what_a_simulation_says_against_signatures_is_spread_between_sure_points():
    at = np.array([0.0, 1.0, 2.0, 4.0])
    z = np.zeros((4, E, K), np.float32)
    curve = Curve(candidate(low=0, high=4), at, z, np.array([True, False, False, False]))
    found = curve.with_probes(np.array([2.0]), np.full((1, E, K), 6.0, np.float32))
    assert list(found.sure) == [True, False, True, False]
    # Half the error half way, all of it at the point and beyond.
    assert found.z[:, 0, 0] == pytest.approx([0, 3, 6, 6])
