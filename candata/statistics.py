"""Resampling, and the spread of noise told by medians: the one place for both."""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Median of |x| for a unit normal. Source: P. J. Rousseeuw and C. Croux, "Alternatives to the Median Absolute
#: Deviation", JASA 88 (1993), eq. 1.3.
MEDIAN_OF_UNIT_NORMAL = 0.6745
#: Standard deviation of a normal distribution in median absolute deviations, 1 / Phi^-1(3/4).
#: Source: F. R. Hampel, "The influence curve and its role in robust estimation", JASA 69 (1974).
MAD_TO_SD = 1.4826


def resamples(rng: np.random.Generator, count: int, draws: int) -> NDArray[np.int64]:
    """Return `(draws, count) int64`: a row numbers the items of a bootstrap sample, drawn with replacement.

    One seed gives the same rows, whether they are drawn at once or one after the other.

    Source: B. Efron, "Bootstrap Methods: Another Look at the Jackknife", Annals of Statistics 7 (1979).
    """
    return rng.integers(count, size=(draws, count))


def noise_sd(values: Array, time_axis: int, axes: int | tuple[int, ...] | None = None, order: int = 2) -> Array:
    """Return the standard deviation of white noise on a slow signal, by the median of its differences of an order.

    Differences of order n of white noise have (2n choose n) times its variance: the sum of the squared binomial
    coefficients that they weigh readings by.

    Parameters
    ----------
    values : array
        Readings; those that are not finite do not count.
    time_axis : int
        Axis of time.
    axes : int or tuple of int, optional
        Axes that share one deviation; all by default.
    order : int
        Order of the differences; the higher, the less a smooth signal adds to them.

    Returns
    -------
    array
        Unit of `values`; 0 where fewer readings in a row are finite than a difference takes, `order` + 1.
    """
    bends = np.abs(np.diff(values, order, axis=time_axis))
    finite = np.isfinite(bends)
    if not bends.size:
        return np.zeros(np.sum(bends, axis=axes).shape)
    if not finite.all():  # nanmedian takes a hundred times as long
        has_readings = finite.any(axis=axes, keepdims=True)
        median_bend = np.nanmedian(np.where(finite, bends, np.where(has_readings, np.nan, 0.0)), axis=axes)
    else:
        median_bend = np.median(bends, axis=axes)
    return np.asarray(median_bend / MEDIAN_OF_UNIT_NORMAL / np.sqrt(comb(2 * order, order)))
