"""Unit quaternions w x y z, vectorised over leading axes: what the stepping loop needs each step.

Source: J. Sola, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508, eqs. 12 (product), 19 (its
matrix), 101 (exponential), 105 (logarithm).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: What of a quaternion stands where in the matrix of a product from the left, and its sign.
_LEFT = np.array([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGN = np.array([[1.0, -1, -1, -1], [1, 1, -1, 1], [1, 1, 1, -1], [1, -1, 1, 1]])
#: What turns a unit quaternion into its inverse.
_INVERSE = np.array([1.0, -1.0, -1.0, -1.0])


def multiply(a: Array, b: Array) -> Array:
    """Return the product `a b`, `(..., 4)`: first turn by b, then by a."""
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def product(a: Array, b: Array) -> Array:
    """Return `multiply(a, b)` of few quaternions `(n, 4)` in few calls, of many in twice the time."""
    return (a[:, _LEFT] * _SIGN * b[:, None]).sum(-1)


def conjugate(q: Array) -> Array:
    """Return the inverse of a unit quaternion, `(..., 4)`."""
    return q * _INVERSE


def exp(rotation_vector: Array) -> Array:
    """Return the quaternion of a rotation vector `(..., 3)` [rad]."""
    angle = np.sqrt((rotation_vector**2).sum(-1, keepdims=True))
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * rotation_vector], axis=-1)


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
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def normalise(q: Array) -> Array:
    """Return `q` with norm one."""
    return q / np.sqrt((q**2).sum(-1, keepdims=True))
