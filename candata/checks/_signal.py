"""Measures of a channel: noise, means, lags, unit factors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.statistics import MAD_TO_SD, noise_sd

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Parts of an episode whose noise is compared, and the share of them that is quiet: contact chatters. Chosen.
SEGMENTS, QUIET_SHARE = 8, 0.2
#: Share of the noise by second differences that those of fourth order show of white noise, at least. Chosen: of motion
#: that takes ten rows a twentieth is left.
WHITE = 0.5
#: Factors between units that people mix up (CGPM SI brochure, 9th edition): what a value is multiplied by.
UNITS = {
    "thousandths (mm, mN, mrad)": 1000.0,
    "hundredths (cm)": 100.0,
    "gram-force": 1 / 9.80665e-3,
    "kilogram-force": 1 / 9.80665,
    "degrees": 180 / np.pi,
}


def noise(values: Array, order: int = 2) -> Array:
    """Return the spread of white noise in each column of `(T, N)`, by differences of an order."""
    return noise_sd(values, 0, axes=0, order=order)


def white_noise(values: Array) -> Array:
    """Return `noise` where it is one: smooth motion bends too, but less the higher the order; NaN there."""
    second_order, fourth_order = noise(values), noise(values, 4)
    return np.where((second_order > 0) & (fourth_order > WHITE * second_order), second_order, np.nan)


def quiet_noise(series: Array) -> float:
    """Return the noise of a series `(T,)` where it is quietest, of `SEGMENTS` parts of it; 0 where nothing is seen."""
    finite_values = series[np.isfinite(series)]
    parts = [float(noise(part[:, None])[0]) for part in np.array_split(finite_values, SEGMENTS) if len(part) > 2]
    return float(np.quantile(parts, QUIET_SHARE)) if parts else 0.0


def resolution(values: Array) -> float:
    """Return the smallest step between values `(N,)` that occur; 0 where there are fewer than two."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(steps.min()) if len(steps) else 0.0


def moving_mean(values: Array, rows: int) -> Array:
    """Return `(T, ...)` means over `rows` rows around each, the ends over what is there; NaN rows stay out."""
    rows = max(1, min(rows, len(values)))
    columns = values.reshape(len(values), -1)
    is_finite = np.isfinite(columns)
    start = np.maximum(np.arange(len(columns)) - rows // 2, 0)
    end = np.minimum(np.arange(len(columns)) + (rows + 1) // 2, len(columns))
    # Running sums about the mean: those of large values would lose the small changes.
    centre = np.where(is_finite.any(axis=0), np.nanmean(np.where(is_finite, columns, np.nan), axis=0), 0.0)
    sums, counts = (
        np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
        for x in (np.where(is_finite, columns - centre, 0.0), is_finite.astype(float))
    )
    total = counts[end] - counts[start]
    mean = (sums[end] - sums[start]) / np.maximum(total, 1) + centre
    return np.where(total > 0.5, mean, np.nan).reshape(values.shape)


def correlation(leader: Array, follower: Array, lags: NDArray[np.int64]) -> Array:
    """Return `(L, N)` the correlation of columns of `leader (T, N)` with those of `follower`, `lag` rows later.

    NaN counts as its column's mean; a column that stands still correlates with nothing.
    """
    leader, follower = (np.where(np.isfinite(x), x, np.nanmean(x, axis=0)) for x in (leader, follower))
    out = np.zeros((len(lags), leader.shape[1]))
    for k, lag in enumerate(lags):
        a = leader[max(0, -lag) : len(leader) - max(0, lag)]
        b = follower[max(0, lag) : len(follower) - max(0, -lag)]
        if len(a) > 3:
            a, b = a - a.mean(axis=0), b - b.mean(axis=0)
            size = np.sqrt((a * a).sum(axis=0) * (b * b).sum(axis=0))
            out[k] = np.where(size > 0, (a * b).sum(axis=0) / np.where(size > 0, size, 1), 0.0)
    return out


def peak(values: Array) -> float:
    """Return where `(N,)` is largest, between rows by the parabola through the three values there."""
    k = int(np.argmax(values))
    if k in (0, len(values) - 1):
        return float(k)
    previous_value, top, next_value = values[k - 1 : k + 2]
    bend = previous_value - 2 * top + next_value
    return float(k + 0.5 * (previous_value - next_value) / bend) if bend < 0 else float(k)


def unit_of(ratio: float, tolerance: float = 0.35) -> str:
    """Return which unit's factor a ratio is, or one over it; nothing where it is near none.

    Parameters
    ----------
    ratio : float
        Found over expected, positive.
    tolerance : float
        Largest difference of logarithms; half the gap between a hundredth and a gram-force does not matter, as the
        nearest is taken.
    """
    if not ratio > 0:
        return ""
    distances = {name: min(abs(np.log(ratio / f)), abs(np.log(ratio * f))) for name, f in UNITS.items()}
    nearest_unit = min(distances, key=lambda name: distances[name])
    return nearest_unit if distances[nearest_unit] < tolerance else ""


def finite_median(values: Array) -> float:
    """Return the median of what is finite; NaN where nothing is."""
    finite_values = values[np.isfinite(values)]
    return float(np.median(finite_values)) if len(finite_values) else float("nan")


def spread(values: Array) -> float:
    """Return the robust standard deviation (by the MAD) of what is finite; 0 where nothing is."""
    finite_values = values[np.isfinite(values)]
    return float(MAD_TO_SD * np.median(np.abs(finite_values - np.median(finite_values)))) if len(finite_values) else 0.0
