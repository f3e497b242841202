"""Statistics as LeRobot keeps them: mean, std, min, max, count and quantiles of every column."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Stats = dict[str, dict[str, list]]

#: Quantiles of LeRobot v3. Source: lerobot, `compute_stats.DEFAULT_QUANTILES`.
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
#: Values held for the quantiles of a whole set, in bytes; a larger set is thinned evenly.
_HELD_BYTES = 256 << 20


class FeatureTally:
    """Statistics of a whole set, gathered episode by episode; rows that are not finite are left out.

    Quantiles are exact up to 256 MB of values; beyond, they are those of every k-th row.
    """

    def __init__(self, rows: int, columns: int) -> None:
        """Begin, with the number of rows and columns that will come."""
        self._every = max(1, -(-rows * columns * 4 // _HELD_BYTES))
        self._moments: dict[str, tuple[NDArray, ...]] = {}
        self._held: dict[str, list[NDArray]] = {}
        self._rows = 0

    def add(self, arrays: Mapping[str, NDArray]) -> Stats:
        """Return the statistics of one episode, `(T, n)` by key, and count it in."""
        stats = {key: self._add(key, values) for key, values in arrays.items()}
        self._rows += len(next(iter(arrays.values())))
        return stats

    def total(self) -> Stats:
        """Return the statistics of everything that was added."""
        stats = {}
        for key, (count, mean, spread, low, high) in self._moments.items():
            values = np.concatenate(self._held[key]).astype(np.float64)
            stats[key] = _stats_lists(
                count, mean, np.sqrt(spread / np.maximum(count, 1)), low, high, _quantiles(values)
            )
        return stats

    def _add(self, key: str, values: NDArray) -> dict[str, list]:
        """Return the statistics of one key of one episode, and merge them."""
        moments = _moments(values)
        self._moments[key] = _merge_moments(self._moments[key], moments) if key in self._moments else moments
        self._held.setdefault(key, []).append(values[(-self._rows) % self._every :: self._every])
        count, mean, spread, low, high = moments
        std = np.sqrt(spread / np.maximum(count, 1))
        return _stats_lists(count, mean, std, low, high, _quantiles(values.astype(np.float64)))


def _moments(values: NDArray) -> tuple[NDArray, ...]:
    """Return count, mean, sum of squared deviations, least and largest of each column; 0 where nothing is finite."""
    numbers = values.astype(np.float64)
    finite = np.isfinite(numbers)
    count = finite.sum(axis=0)
    mean = np.where(finite, numbers, 0.0).sum(axis=0) / np.maximum(count, 1)
    spread = np.where(finite, numbers - mean, 0.0) ** 2
    low = np.where(finite, numbers, np.inf).min(axis=0)
    high = np.where(finite, numbers, -np.inf).max(axis=0)
    return count, mean, spread.sum(axis=0), low, high


def _merge_moments(a: tuple[NDArray, ...], b: tuple[NDArray, ...]) -> tuple[NDArray, ...]:
    """Return the moments of two sets together.

    Source: Chan, Golub, LeVeque, Updating formulae and a pairwise algorithm for computing sample variances, 1979.
    """
    count = a[0] + b[0]
    share = b[0] / np.maximum(count, 1)
    difference = b[1] - a[1]
    spread = a[2] + b[2] + difference**2 * a[0] * share
    return count, a[1] + difference * share, spread, np.minimum(a[3], b[3]), np.maximum(a[4], b[4])


def _quantiles(values: NDArray[np.float64]) -> dict[str, NDArray]:
    """Return the quantiles of each column over what is finite."""
    if np.isfinite(values).all():
        quantiles = np.quantile(values, list(_QUANTILES.values()), axis=0)
    else:
        columns = [column[np.isfinite(column)] for column in values.T]
        shares = list(_QUANTILES.values())
        quantiles = np.stack([np.quantile(c, shares) if len(c) else np.zeros(len(shares)) for c in columns], axis=1)
    return dict(zip(_QUANTILES, quantiles, strict=True))


def _stats_lists(
    count: NDArray, mean: Any, std: Any, low: Any, high: Any, quantiles: Mapping[str, Any]
) -> dict[str, list]:
    """Return statistics as lists of numbers; what nothing finite is known of is 0.

    LeRobot weights episodes by one count for all columns: that of the column with the most finite rows.
    """
    stats = {"min": low, "max": high, "mean": mean, "std": std, **quantiles}
    rows = max(1, int(count.max()))
    return {name: np.where(np.isfinite(v), v, 0.0).tolist() for name, v in stats.items()} | {"count": [rows]}
