"""Centre and scale, by channel and by step of the increments; integrate undoes increments."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from candata.errors import DataError, UnknownNameError
from candata.loaders import Normaliser, integrate, normalise_batch, windows
from candata.loaders.increments import increments
from candata.loaders.normaliser import CHANNEL_FLOOR, channel_scale
from candata.rotation import exp


def test_robust_is_the_standard_deviation_of_a_normal_and_ignores_outliers(rng):
    values = 3 + 2 * rng.normal(size=(20_000, 1))
    values[:10] = 1e6
    found = channel_scale("joint_position", values)
    # The standard error of a median of 20,000 draws is 0.02 here and that of the range 0.03; the ten lift it by 0.06.
    assert found.centre[0] == pytest.approx(3, abs=0.1)
    assert found.scale[0] == pytest.approx(2, abs=0.1)
    assert channel_scale("joint_position", values, "std").scale[0] > 1000


def test_a_force_that_is_mostly_zero_keeps_its_size(rng):
    force = np.where(rng.random((10_000, 1)) < 0.01, rng.normal(5, 1, (10_000, 1)), 0)
    # Nine of ten touches lie within the range, which ends at 5 + 1.3 N: a touch is some 5 scales, not 500.
    assert channel_scale("fingertip_force", force).scale[0] == pytest.approx(6.3 / 6.18, rel=0.1)


def test_a_joint_that_never_moves_does_not_explode():
    assert channel_scale("joint_position", np.full((50, 2), 0.7)).scale == (CHANNEL_FLOOR,) * 2


def test_a_pose_keeps_its_directions_and_its_quaternion(rng):
    pose = np.c_[rng.normal(size=(1000, 3)) * [1, 2, 3], rng.normal(size=(1000, 4))]
    centre, scale = channel_scale("object_pose", pose).arrays()
    assert len(set(scale[:3].tolist())) == 1
    np.testing.assert_array_equal(centre[3:], 0)
    np.testing.assert_array_equal(scale[3:], 1)


def test_what_cannot_be_fitted():
    with pytest.raises(DataError, match="no valid value of action"):
        channel_scale("action", np.empty((0, 2)))
    with pytest.raises(UnknownNameError, match="did you mean 'quantile'"):
        channel_scale("action", np.zeros((3, 2)), "quantiles")


def test_an_unknown_method_is_refused_before_anything_is_read(hand, store):
    with pytest.raises(UnknownNameError, match="quantile, robust, std"):
        windows(store(hand("a")), 2, 3, stride=2, method="minmax")


def test_quantiles_become_minus_one_and_one_and_what_is_clipped_is_counted(hand, store, rng):
    rows = 3000
    joints = np.c_[rng.uniform(-2, 4, rows), np.full(rows, 0.7)]
    joints[:2, 0], joints[2, 0] = 50.0, -50.0
    feed = windows(store(hand("a", rows, arrays={"joint_position": joints})), 2, 3, stride=2, method="quantile")
    value = feed.normaliser
    centre, scale = value.channel("joint_position")
    # 0.1 % of 3,000 rows are three: the ends lie within a few of the outermost of 2,997 uniform draws.
    np.testing.assert_allclose(centre, [1, 0.7], atol=0.05)
    np.testing.assert_allclose(scale, [3, CHANNEL_FLOOR], atol=0.05)
    outside = np.abs((joints[:, 0].astype(np.float32) - centre[0]) / scale[0]) > 1
    assert value.clipped["joint_position"] == outside.sum() == 6
    assert value.clipped["object_pose"] > 0
    assert Normaliser.model_validate_json(value.model_dump_json()) == value
    batch = feed.batch([0, 1, 2, 1000])
    out = normalise_batch(batch, value)
    assert out["history/joint_position"].max() == 1
    assert out["future/joint_position"].min() == -1
    inner = batch["history/joint_position"][3]
    np.testing.assert_allclose(out["history/joint_position"][3] * scale + centre, inner, atol=1e-5)  # float32
    np.testing.assert_array_equal(out["history/object_pose"][..., 3:], batch["history/object_pose"][..., 3:])
    np.testing.assert_array_equal(out["history/contact"], batch["history/contact"])


def test_the_other_methods_do_not_clip(hand, store):
    feed = windows(store(hand("a", arrays={"action": np.r_[np.zeros((29, 2)), [[9, 9]]]})), 1, 1, stride=1)
    assert feed.normaliser.clipped == {}
    assert normalise_batch(feed.batch([28]), feed.normaliser)["future/action"].max() > 1


def test_json_and_back(hand, store):
    value = windows(store(hand("a")), 2, 3, stride=2).normaliser
    assert Normaliser.model_validate_json(value.model_dump_json()) == value
    assert value.method == "robust"
    assert set(value.channels) == {"object_pose", "joint_position", "action", "fingertip_force"}
    assert value.channel("fingertip_force")[0].shape == (1, 3)
    with pytest.raises(UnknownNameError, match="contact"):
        value.channel("contact")


def test_increments_are_fitted_at_the_models_rate(hand, store):
    value = windows(store(hand("a")), 2, 3, stride=2).normaliser
    centre, scale = value.increments.arrays()
    # The object moves 0.01 m and turns 0.01 rad about z a row, so twice that a step; float32 poses.
    np.testing.assert_allclose(centre, np.tile([0.02, 0, 0, 0, 0, 0.02], (3, 1)), atol=1e-6)
    np.testing.assert_allclose(scale, np.tile([1e-4] * 3 + [1e-3] * 3, (3, 1)), rtol=1e-6)


def test_increments_over_a_gap_or_beyond_the_end_do_not_count(hand, store):
    pose, valid = np.array(hand("x")["object_pose"]), np.ones(30, bool)
    pose[12:, 0] += 5
    valid[9:12] = False
    dataset = store(hand("a", arrays={"object_pose": pose, "object_pose_valid": valid}))
    centre, _ = windows(dataset, 1, 3, stride=1).normaliser.increments.arrays()
    np.testing.assert_allclose(centre[:, 0], 0.01, atol=1e-6)  # float32 poses


def test_a_step_that_no_episode_reaches_takes_the_others(hand, store):
    centre, _ = windows(store(hand("a", 5)), 1, 6, stride=1, pad="both").normaliser.increments.arrays()
    np.testing.assert_allclose(centre[:, 0], 0.01, atol=1e-6)  # float32 poses


def test_windows_without_a_pose_have_no_increments(hand, store):
    assert windows(store(hand("a", arrays={"object_pose": None})), 1, 2, stride=1).normaliser.increments is None


@given(st.integers(0, 2**32 - 1))
def test_integrate_undoes_increments(seed):
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(4, 5, 6))  # rotations of a few radians, below pi with a norm of at most about 3
    steps[..., 3:] *= np.minimum(1, 3 / np.linalg.norm(steps[..., 3:], axis=-1, keepdims=True))
    start = np.concatenate([rng.normal(size=(4, 3)), exp(rng.normal(size=(4, 3)))], axis=-1)
    path = np.concatenate([start[:, None], integrate(start, steps)], axis=1)
    np.testing.assert_allclose(increments(path), steps, atol=1e-9)  # float64 rounding near half a turn


def test_omega_is_in_the_world_frame():
    quarter = exp(np.array([np.pi / 2, 0, 0]))  # the body's y axis points along the world's z
    turned = integrate(np.r_[0, 0, 0, quarter], np.array([[0, 0, 0, 0, 0, 0.3]]))[0]
    from candata.rotation import rotate

    # A turn about the world's z leaves the body's y axis where it is.
    np.testing.assert_allclose(rotate(turned[3:], np.array([0.0, 1, 0])), [0, 0, 1], atol=1e-12)
