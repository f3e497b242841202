"""The mean of poses and their distance: numpy, over any leading axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.rotation import difference

Array = NDArray[np.float64]


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
