"""Noise on poses and commands: of the size asked for, the same for a window, the same for (seed, step, rank)."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import UsageError
from candata.loaders import Augmentation, as_tensors, augment, noise, windows
from candata.loaders.increments import increments
from candata.rotation import difference, exp, multiply


@pytest.fixture
def feed(hand, store):
    return windows(store(hand("a", 400)), 4, 3, stride=1)


def poses(batch):
    return np.concatenate([batch["history/object_pose"], batch["future/object_pose"]], axis=1).astype(np.float64)


def test_off_by_default(feed):
    batch = feed.batch(np.arange(20))
    out = augment(batch, Augmentation(), np.random.default_rng(0))
    assert Augmentation().is_off
    assert all(out[name] is values for name, values in batch.items())


def test_the_object_is_moved_and_its_motion_stays(feed):
    batch = feed.batch(np.arange(len(feed)))
    before = {name: values.copy() for name, values in batch.items()}
    out = augment(batch, Augmentation(position_m=0.01, rotation_rad=0.05), np.random.default_rng(0))
    assert all((values == before[name]).all() for name, values in batch.items()), "the batch given was changed"
    old, new = poses(batch), poses(out)
    # float32 poses of up to 4 m: half a unit in the last place is 2.4e-7 m; increments subtract two of them.
    np.testing.assert_allclose(increments(new), increments(old), atol=2e-6)
    shift = new[..., :3] - old[..., :3]
    np.testing.assert_allclose(shift, np.broadcast_to(shift[:, :1], shift.shape), atol=1e-6)
    assert np.abs(shift).max() > 0.01
    np.testing.assert_allclose(np.linalg.norm(new[..., 3:], axis=-1), 1, atol=1e-6)
    # 394 windows and 3 axes: the standard error of a standard deviation is 2 %.
    assert shift[:, 0].std() == pytest.approx(0.01, rel=0.1)
    turn = difference(new[:, 0, 3:], old[:, 0, 3:])
    assert turn.std() == pytest.approx(0.05, rel=0.1)
    assert all(out[name] is batch[name] for name in batch if "object_pose" not in name)


def test_a_turn_is_about_the_axes_of_the_body(hand, store):
    batch = windows(store(hand("a", 30)), 2, 1, stride=1).batch([5])
    out = augment(batch, Augmentation(rotation_rad=0.3), np.random.default_rng(4))
    drawn = np.random.default_rng(4).standard_normal((1, 3)) * 0.3
    expected = multiply(batch["history/object_pose"][..., 3:].astype(np.float64), exp(drawn)[:, None])
    np.testing.assert_allclose(out["history/object_pose"][..., 3:], expected, atol=1e-6)  # float32


def test_a_command_has_one_noise_wherever_it_stands(feed):
    batch = feed.batch(np.arange(200))
    before = {name: values.copy() for name, values in batch.items()}
    out = augment(batch, Augmentation(command=0.2), np.random.default_rng(1))
    assert all((values == before[name]).all() for name, values in batch.items()), "the batch given was changed"
    rows = np.concatenate([out["history/action"], out["future/action"]], axis=1)
    np.testing.assert_array_equal(out["planned/action"], rows[:, 3:-1])
    added = rows - np.concatenate([batch["history/action"], batch["future/action"]], axis=1)
    assert added.std() == pytest.approx(0.2, rel=0.1)  # 2,800 draws: a standard error of 1.3 %
    assert abs(np.corrcoef(added[:, 0].ravel(), added[:, 1].ravel())[0, 1]) < 0.2
    assert all(out[name] is batch[name] for name in batch if "action" not in name)


def test_windows_without_poses_or_commands(hand, store):
    arrays = {"object_pose": None, "action": None}
    batch = windows(store(hand("a", 30, arrays=arrays)), 2, 1, stride=1).batch([5])
    how = Augmentation(position_m=1, rotation_rad=1, command=1)
    assert augment(batch, how, np.random.default_rng(0)).keys() == batch.keys()


def test_noise_follows_from_seed_step_and_rank(feed):
    batch, how = feed.batch(np.arange(8)), Augmentation(position_m=0.1, rotation_rad=0.1, command=0.1)

    def drawn(*key):
        return augment(batch, how, noise(*key))

    first = drawn(3, 7, 1)
    assert all((values == first[name]).all() for name, values in drawn(3, 7, 1).items())
    for key in ((4, 7, 1), (3, 8, 1), (3, 7, 0)):
        other = drawn(*key)
        assert (other["history/object_pose"] != first["history/object_pose"]).any()
        assert (other["history/action"] != first["history/action"]).any()


def test_tensors_get_the_same_noise(feed):
    pytest.importorskip("torch")
    batch, how = feed.batch(np.arange(8)), Augmentation(position_m=0.1, rotation_rad=0.1, command=0.1)
    expected = augment(batch, how, noise(0, 0))
    for name, values in augment(as_tensors(batch), how, noise(0, 0)).items():
        # Two ways to multiply in float32, of numbers up to 4.
        np.testing.assert_allclose(values.numpy(), expected[name], atol=2e-6)


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_what_is_no_standard_deviation(value):
    with pytest.raises(UsageError, match="command"):
        Augmentation.parse({"command": value}, "settings")
