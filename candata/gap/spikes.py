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
    size = poses.shape[1]
    around = [poses[:, 2 + k : size - 2 + k] for k in (-2, -1, 1, 2)]
    at = poses[:, 2:-2]
    # Turns are told from each row itself: from the first row, a turn by pi would jump to and fro.
    moved = [some[..., :3] - at[..., :3] for some in around]
    turned = [difference(some[..., 3:], at[..., 3:]) for some in around]
    spike = np.pad(_spikes(moved, LEAST[0]) | _spikes(turned, LEAST[1]), ((0, 0), (2, 2)))
    if not spike.any():
        return poses, ()
    total = int(np.isfinite(poses).all(2).sum())
    note = f"object_pose: {spike.sum()} of {total} poses jump out for one row and back, and are left out"
    return np.where(spike[..., None], np.nan, poses), (note,)


def _spikes(around: list[Array], least: float) -> NDArray[np.bool_]:
    """Return `(E, N)` which rows are spikes, by where the two rows before and after lie from each `(E, N, 3)`."""
    first, before, after, last = around
    lines = (2 * before - first, 2 * after - last, (before + after) / 2)
    away = np.stack([np.sqrt((line**2).sum(2)) for line in lines])
    with np.errstate(invalid="ignore"):
        usual = np.array([[np.median(e[np.isfinite(e)]) if np.isfinite(e).any() else 0.0 for e in one] for one in away])
        return np.asarray((away > np.maximum(TIMES * usual, least)[..., None]).all(0))
