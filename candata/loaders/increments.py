"""Pose increments: what the models forecast, from poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.rotation import difference, exp, multiply, normalise


def increments(poses: NDArray) -> NDArray[np.float64]:
    """Return `(..., H, 6) float64`: dp [m] and world-frame rotation vector omega [rad] from each pose to the next.

    dp = p(k) - p(k-1); R(k) = exp(omega^) R(k-1).

    Parameters
    ----------
    poses : (..., H + 1, 7)
        Positions [m] and unit quaternions w x y z; the present one first.
    """
    poses = np.asarray(poses, np.float64)
    turn = normalise(poses[..., 3:])
    shift = np.diff(poses[..., :3], axis=-2)
    return np.concatenate([shift, difference(turn[..., 1:, :], turn[..., :-1, :])], axis=-1)


def integrate(start_pose: NDArray, steps: NDArray) -> NDArray[np.float64]:
    """Return `(..., H, 7) float64`: the poses that increments lead to, the inverse of `increments`.

    Parameters
    ----------
    start_pose : (..., 7)
        Position [m] and unit quaternion w x y z to start from.
    steps : (..., H, 6)
        Increments dp [m] and omega [rad].
    """
    start_pose, steps = np.asarray(start_pose, np.float64), np.asarray(steps, np.float64)
    position = start_pose[..., None, :3] + np.cumsum(steps[..., :3], axis=-2)
    turn, turns = normalise(start_pose[..., 3:]), []
    for k in range(steps.shape[-2]):
        turn = normalise(multiply(exp(steps[..., k, 3:]), turn))
        turns.append(turn)
    return np.concatenate([position, np.stack(turns, axis=-2)], axis=-1)
