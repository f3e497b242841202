"""Effort of joints as a line through torque and speed: what a current, a duty or a torque in no known unit tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.velocity import joint_velocity

Array = NDArray[np.float64]


def effort_law(effort: Array, torque: Array, speed: Array) -> tuple[Array, float]:
    """Return `(3,)` the weights of torque, speed and one in an effort, and which share of its variance they foretell.

    Parameters
    ----------
    effort, torque, speed : (E, T) float64
        What was recorded, and the torque and speed of its replay; rows that are not finite do not count.
    """
    known = np.isfinite(effort) & np.isfinite(torque) & np.isfinite(speed)
    if known.sum() < 3:
        return np.array([1.0, 0.0, 0.0]), 0.0
    y = effort[known]
    x = np.stack([torque[known], speed[known], np.ones_like(y)], axis=-1)
    weights = np.asarray(np.linalg.lstsq(x, y, rcond=None)[0], float)
    variance = float(y.var())
    return weights, 1 - float(((y - x @ weights) ** 2).mean()) / variance if variance > 0 else 0.0


def foretold_effort(recorded: Array, torque: Array, position: Array) -> Array:
    """Return what the torque and speed of a replay say of an effort whose size tells nothing, `(E, T, J)` in its unit.

    Parameters
    ----------
    recorded, torque : (E, T, J) float64
        What was recorded, and the torque of the replay [N m; N of slides].
    position : (E, T, J) float64
        Joint positions of the replay [rad; m of slides].
    """
    out, speed = np.empty(torque.shape), joint_velocity(position, 1.0)
    for j in range(torque.shape[2]):
        weights, _ = effort_law(recorded[..., j], torque[..., j], speed[..., j])
        out[..., j] = weights[0] * torque[..., j] + weights[1] * speed[..., j] + weights[2]
    return out
