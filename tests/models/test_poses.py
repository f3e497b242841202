"""Pose increments and their inverse are exact sentences about rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from candata import rotation
from candata.loaders.increments import increments as numpy_increments
from candata.models import increments, integrate, targets
from candata.models._poses import rotation_exp, rotation_log, rotation_matrix

#: float64 rounding in a handful of products of numbers near one.
EXACT = {"rtol": 0.0, "atol": 1e-12}

ANGLE = st.floats(0, math.pi - 1e-3)
COMPONENT = st.floats(-1, 1)


def vectors(angle: float, direction: tuple[float, float, float]) -> torch.Tensor:
    axis = np.add(direction, [1e-3, 0, 0])
    return torch.tensor(angle * axis / max(np.linalg.norm(axis), 1e-6))


def random_poses(*shape: int, seed: int = 0) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.tensor(
        np.concatenate([rng.normal(size=(*shape, 3)), rotation.normalise(rng.normal(size=(*shape, 4)))], -1)
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_a_quarter_turn_about_world_z(sign):
    poses = torch.zeros(2, 7, dtype=torch.float64)
    poses[0, 3] = 1
    poses[1] = torch.tensor([0.1, 0.2, 0.3, math.sqrt(0.5), 0, 0, math.sqrt(0.5)], dtype=torch.float64)
    poses[1, 3:] *= sign  # q and -q are one attitude
    wanted = torch.tensor([[0.1, 0.2, 0.3, 0, 0, math.pi / 2]], dtype=torch.float64)
    torch.testing.assert_close(increments(poses), wanted, **EXACT)


def test_omega_is_in_the_world_frame():
    tilted = torch.tensor(rotation.exp(np.array([0.7, 0.0, 0.0])))
    turned = torch.tensor(rotation.multiply(rotation.exp(np.array([0, 0, 0.2])), tilted.numpy()))
    poses = torch.stack([torch.cat([torch.zeros(3), q]) for q in (tilted, turned)])
    torch.testing.assert_close(increments(poses)[0, 3:], torch.tensor([0, 0, 0.2], dtype=torch.float64), **EXACT)


def test_increments_are_those_of_the_loaders():
    poses = random_poses(4, 9)
    np.testing.assert_allclose(increments(poses), numpy_increments(poses.numpy()), rtol=0, atol=1e-12)


def test_integrate_undoes_increments_for_samples_and_windows():
    poses = random_poses(3, 5, 9)
    back = integrate(poses[:, :, 0], increments(poses))
    torch.testing.assert_close(rotation_matrix(back[..., 3:]), rotation_matrix(poses[..., 1:, 3:]), **EXACT)
    torch.testing.assert_close(back[..., :3], poses[..., 1:, :3], **EXACT)


def test_integrate_broadcasts_windows_against_samples():
    start, steps = random_poses(5), 0.1 * torch.randn(3, 5, 4, 6, generator=torch.Generator().manual_seed(0)).double()
    found = integrate(start, steps)
    assert found.shape == (3, 5, 4, 7)
    torch.testing.assert_close(found[2, 3], integrate(start[3], steps[2, 3]), **EXACT)


def test_targets_start_at_the_present_pose(batch):
    windows = batch(3)
    poses = torch.cat([windows["history/object_pose"], windows["future/object_pose"]], dim=1)
    assert torch.equal(targets(windows), increments(poses)[:, windows["history/object_pose"].shape[1] - 1 :])


@given(ANGLE, COMPONENT, COMPONENT, COMPONENT)
def test_log_undoes_exp(angle, x, y, z):
    vector = vectors(angle, (x, y, z))
    torch.testing.assert_close(rotation_log(rotation_exp(vector)), vector, rtol=0, atol=1e-11)
    np.testing.assert_allclose(rotation_exp(vector), rotation.exp(vector.numpy()), rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-160, 1e-30, 1e-12, 1e-8, 1e-4])
def test_small_turns_keep_all_their_digits(angle):
    vector = torch.tensor([angle, -angle, 0.5 * angle], dtype=torch.float64)
    torch.testing.assert_close(rotation_log(rotation_exp(vector)), vector, rtol=1e-12, atol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_where_nothing_turns(dtype):
    vector = torch.zeros(3, dtype=dtype, requires_grad=True)
    rotation_log(rotation_exp(vector)).sum().backward()
    torch.testing.assert_close(vector.grad, torch.ones(3, dtype=dtype))  # log(exp(v)) = v
