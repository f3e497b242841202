"""Unit quaternions w x y z, vectorised over leading axes: what the stepping loop needs each step.

Source: J. Sola, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508, eqs. 12 (product), 19 (its
matrix), 101 (exponential), 105 (logarithm).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Index of the component at each place of the matrix of a product from the left, and its sign.
_LEFT_INDEX = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGN = np.array([[1.0, -1, -1, -1], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, 1, 1]])
#: Factors that turn a unit quaternion into its inverse.
_INVERSE = np.array([1.0, -1.0, -1.0, -1.0])


def multiply(a: Array, b: Array) -> Array:
    """Return the product `a b`, `(..., 4)`: first turn by b, then by a."""
    a_w, a_x, a_y, a_z = (a[..., i] for i in range(4))
    b_w, b_x, b_y, b_z = (b[..., i] for i in range(4))
    return np.stack(
        [
            a_w * b_w - a_x * b_x - a_y * b_y - a_z * b_z,
            a_w * b_x + a_x * b_w + a_y * b_z - a_z * b_y,
            a_w * b_y - a_x * b_z + a_y * b_w + a_z * b_x,
            a_w * b_z + a_x * b_y - a_y * b_x + a_z * b_w,
        ],
        axis=-1,
    )


def product(a: Array, b: Array) -> Array:
    """Return `multiply(a, b)` of few quaternions `(n, 4)` in few calls, of many in twice the time."""
    return (a[:, _LEFT_INDEX] * _SIGN * b[:, None]).sum(-1)


def conjugate(q: Array) -> Array:
    """Return the inverse of a unit quaternion, `(..., 4)`."""
    return q * _INVERSE


def exp(rotation_vector: Array) -> Array:
    """Return the quaternion of a rotation vector `(..., 3)` [rad]."""
    angle = np.sqrt((rotation_vector**2).sum(-1, keepdims=True))
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * rotation_vector], axis=-1)


def of_fixed_axes(rpy: tuple[float, float, float]) -> Array:
    """Return the quaternion of turns [rad] about fixed x, then y, then z: what a URDF calls `rpy`."""
    roll, pitch, yaw = (exp(angle * axis) for angle, axis in zip(rpy, np.eye(3), strict=True))
    return multiply(yaw, multiply(pitch, roll))


def log(q: Array) -> Array:
    """Return the shortest rotation vector `(..., 3)` [rad] of a unit quaternion."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.sqrt((q[..., 1:] ** 2).sum(-1, keepdims=True))
    angle = 2 * np.arctan2(sine, q[..., :1])
    return q[..., 1:] * np.where(sine < 1e-12, 2.0, angle / np.maximum(sine, 1e-12))


def difference(a: Array, b: Array) -> Array:
    """Return the world-frame rotation vector `(..., 3)` [rad] that turns b into a."""
    return log(multiply(a, conjugate(b)))


def rotate(q: Array, v: Array) -> Array:
    """Return the vectors `v (..., 3)` turned by `q (..., 4)`."""
    w, u = q[..., :1], q[..., 1:]
    t = 2 * _cross(u, v)
    return v + w * t + _cross(u, t)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product `(..., 3)`; numpy's own costs several times as much for small arrays."""
    a_x, a_y, a_z = a[..., 0], a[..., 1], a[..., 2]
    b_x, b_y, b_z = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x], axis=-1)


def normalise(q: Array) -> Array:
    """Return `q` with norm one."""
    return q / np.sqrt((q**2).sum(-1, keepdims=True))
