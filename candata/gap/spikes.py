"""Poses that jump out for one row and back: a tracker that took another marker, never the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.rotation import difference

Array = NDArray[np.float64]
#: How many times the usual bend of an episode's poses a spike is, and the least that it is [m, rad]. Chosen: an object
#: that bounces at 1 m/s turns round within 10 mm a row, but goes on from there.
TIMES, LEAST = 12.0, (0.005, 0.2)


def without_spikes(poses: Array) -> tuple[Array, tuple[str, ...]]:
    """Return poses `(E, T, 7)` with NaN in rows that fit neither what comes before nor what comes after, and a note.

    A row counts as a spike where position or rotation lies far from its neighbours' middle and from both straight
    lines, through the two rows before and through the two after.
    """
    if poses.shape[1] < 5:
        return poses, ()
    position = poses[..., :3]
    turned = difference(poses[..., 3:], np.broadcast_to(_first(poses[..., 3:]), poses[..., 3:].shape))
    # A rotation vector that passes pi turns over: what seems to jump there for good is no spike.
    spike = _spikes(position, LEAST[0]) | _spikes(turned, LEAST[1])
    if not spike.any():
        return poses, ()
    total = int(np.isfinite(poses).all(2).sum())
    note = f"object_pose: {spike.sum()} of {total} poses jump out for one row and back, and are left out"
    return np.where(spike[..., None], np.nan, poses), (note,)


def _first(quaternions: Array) -> Array:
    """Return the first finite quaternion `(E, 1, 4)` of each episode; the identity of none."""
    seen = np.asarray(np.isfinite(quaternions).all(2))
    first = quaternions[np.arange(len(seen)), seen.argmax(1)]
    first[~np.isfinite(first).all(1)] = [1.0, 0.0, 0.0, 0.0]
    return first[:, None]


def _spikes(values: Array, least: float) -> NDArray[np.bool_]:
    """Return `(E, T)` which of values `(E, T, 3)` are spikes; none within two rows of an end or a gap."""
    at = values[:, 2:-2]
    before, after = 2 * values[:, 1:-3] - values[:, :-4], 2 * values[:, 3:-1] - values[:, 4:]
    middle = (values[:, 1:-3] + values[:, 3:-1]) / 2
    away = np.stack([np.sqrt(((at - other) ** 2).sum(2)) for other in (before, after, middle)])
    with np.errstate(invalid="ignore"):
        usual = np.array([[np.median(e[np.isfinite(e)]) if np.isfinite(e).any() else 0.0 for e in one] for one in away])
        far = (away > np.maximum(TIMES * usual, least)[..., None]).all(0)
    return np.pad(far, ((0, 0), (2, 2)))
