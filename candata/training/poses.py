"""Poses from increments, their mean and their distance: numpy, over any leading axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.rotation import difference, exp, multiply, normalise

Array = NDArray[np.float64]


def integrate(start: NDArray, increments: NDArray) -> Array:
    """Return the poses `(..., H, 7) float64 [m, w x y z]` that the increments lead to.

    Parameters
    ----------
    start : (..., 7)
        Present pose; its leading axes broadcast against those of `increments`.
    increments : (..., H, 6)
        dp [m], then the world-frame rotation vector omega [rad]: R(k) = exp(omega^) R(k-1).
    """
    steps = np.asarray(increments, np.float64)
    start = np.broadcast_to(np.asarray(start, np.float64), (*steps.shape[:-2], 7))
    poses = np.empty((*steps.shape[:-1], 7))
    poses[..., :3] = start[..., None, :3] + np.cumsum(steps[..., :3], axis=-2)
    turned, turns = normalise(start[..., 3:]), exp(steps[..., 3:])
    for k in range(steps.shape[-2]):
        turned = normalise(multiply(turns[..., k, :], turned))
        poses[..., k, 3:] = turned
    return poses


def increments_of(poses: NDArray) -> Array:
    """Return `(..., H, 6) [m, rad]`, the increments between the H + 1 rows of `poses (..., H + 1, 7)`."""
    poses = np.asarray(poses, np.float64)
    turns = difference(poses[..., 1:, 3:], poses[..., :-1, 3:])
    return np.concatenate([np.diff(poses[..., :3], axis=-2), turns], axis=-1)


def mean_pose(poses: NDArray) -> Array:
    """Return the mean `(..., 7)` over the first axis of `poses (M, ..., 7)`.

    The rotation is the one with the least sum of squared chordal distances, whatever the quaternions' signs.

    Source: F. L. Markley et al., "Averaging Quaternions", J. Guidance, Control, Dynamics 30(4), 2007, eqs. 12-13:
    the eigenvector of sum q q^T with the largest eigenvalue.
    """
    poses = np.asarray(poses, np.float64)
    q = poses[..., 3:]
    rotation = np.linalg.eigh(np.einsum("m...i,m...j->...ij", q, q))[1][..., -1]
    rotation = np.where(rotation[..., :1] < 0, -rotation, rotation)
    return np.concatenate([poses[..., :3].mean(0), rotation], axis=-1)


def position_error(a: NDArray, b: NDArray) -> Array:
    """Return the distance `(...) [m]` between the positions of poses `(..., 7)`."""
    return np.linalg.norm(np.asarray(a, np.float64)[..., :3] - np.asarray(b, np.float64)[..., :3], axis=-1)


def rotation_error(a: NDArray, b: NDArray) -> Array:
    """Return the angle `(...) [rad]`, 0 to pi, between the rotations of poses `(..., 7)`."""
    turn = difference(np.asarray(a, np.float64)[..., 3:], np.asarray(b, np.float64)[..., 3:])
    return np.linalg.norm(turn, axis=-1)
