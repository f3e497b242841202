"""Positions and speeds at one row, fitted to the rows around it: what recorded positions say of a start."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.rotation import conjugate, difference, exp, multiply, rotate

Array = NDArray[np.float64]
#: Half the time over which a moving state is smoothed [s], and the fewest rows on either side. Chosen: over 0.1 s a
#: cubic follows a sine of 0.5 rad at 2 Hz within 1 mrad and 0.03 rad/s.
HALF_S, HALF_ROWS = 0.05, 4
#: Standard errors that a speed must differ from zero by for an episode to begin in motion. Chosen: one in 10,000 fits
#: of a joint at rest, so that of a hundred joints at rest few are taken to move, which costs their first rows only.
MOVING = 4.0
#: Standard errors that a cubic term must differ from zero by to be fitted; without it a speed is 2.5 times as sure.
CURVED = 3.0


class Fit(NamedTuple):
    """A polynomial through rows of positions, read at one row.

    Attributes
    ----------
    position, speed : (E, D) float64
        Position, and speed per row; NaN where a row was not seen.
    error : (E, D) float64
        Standard error of the speed, from what the polynomial leaves of all episodes' rows.
    noise : (D,) float64
        Noise of one row, from the same.
    """

    position: Array
    speed: Array
    error: Array
    noise: Array

    @property
    def moves(self) -> NDArray[np.bool_]:
        """`(E,)` whether any of the columns moves."""
        return np.asarray((np.abs(self.speed) > MOVING * self.error).any(1))


def half_rows(rate_hz: float) -> int:
    """Return how many rows on either side of a row its state is smoothed over."""
    return max(HALF_ROWS, round(HALF_S * rate_hz))


def fitted(rows: Array, at: int, least: Array) -> Fit:
    """Return the fit of `rows (E, W, D)` read at row `at`: a parabola, or a cubic where that is plainly one.

    Ordinary least squares; the noise is pooled over episodes, as a fit of a few rows leaves too little to tell it, and
    taken for no less than `least (D,)`, the sensors' resolution.
    """
    steps = np.arange(rows.shape[1]) - at
    parabola, error, _ = _polynomial(rows, steps, 2, least)
    cubic, cubic_error, noise = _polynomial(rows, steps, 3, least)
    bends = np.abs(cubic[3]) > CURVED * cubic_error[3]
    chosen = np.where(bends, cubic[:2], parabola[:2])
    return Fit(chosen[0], chosen[1], np.where(bends, cubic_error[1], error[1]), noise)


def _polynomial(rows: Array, steps: NDArray[np.int64], degree: int, least: Array) -> tuple[Array, Array, Array]:
    """Return coefficients `(degree + 1, E, D)`, their standard errors `(degree + 1, 1, D)` and the noise `(D,)`."""
    basis = np.vander(steps.astype(float), degree + 1, increasing=True)
    solve = np.linalg.pinv(basis)
    values = np.einsum("kw,ewd->ked", solve, rows)
    remainder = rows - np.einsum("wk,ked->ewd", basis, values)
    free = len(steps) - degree - 1
    variance = (remainder**2).sum(1) / max(free, 1)
    finite = np.isfinite(variance)
    typical = np.array([np.median(v[f]) if f.any() else np.nan for v, f in zip(variance.T, finite.T, strict=True)])
    noise = np.maximum(np.sqrt(typical), least)
    return values, (noise * np.sqrt((solve**2).sum(1))[:, None])[:, None, :], noise


def tangent(pose: Array, anchor: Array) -> Array:
    """Return poses `(E, W, 7)` as positions [m] and world-frame rotation vectors [rad] from anchors `(E, 7)`."""
    turn = difference(pose[..., 3:], np.broadcast_to(anchor[:, None, 3:], pose[..., 3:].shape))
    return np.concatenate([pose[..., :3], turn], axis=-1)


def pose_fit(pose: Array, at: int, least: Array) -> tuple[Fit, Array]:
    """Return the fit of poses `(E, W, 7)` in the tangent space at row `at`, and the anchors `(E, 7)` it counts from."""
    anchor = pose[:, min(at, pose.shape[1] - 1)]
    return fitted(tangent(pose, anchor), at, least), anchor


def pose_of(fit: Fit, anchor: Array) -> Array:
    """Return the poses `(E, 7)` of a fit of poses."""
    return np.concatenate([fit.position[:, :3], multiply(exp(fit.position[:, 3:]), anchor[:, 3:])], axis=1)


def twist_of(fit: Fit, pose: Array, rate_hz: float) -> Array:
    """Return `(E, 6)` the velocity of a fit of poses [m/s, rad/s], turning in the body's frame as MuJoCo counts it."""
    speed = fit.speed * rate_hz
    return np.concatenate([speed[:, :3], rotate(conjugate(pose[:, 3:]), speed[:, 3:])], axis=1)
