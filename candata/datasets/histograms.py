"""Histograms of values whose range is not known before they are read: one pass, a fixed amount of memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Bins kept of an element; their width doubles whenever a value lies outside. So many that one wild value of
#: some hundred times the usual range leaves the rest its shape.
BINS = 2048
#: Bins of the first values: the rest is room to grow before the width doubles.
FIRST_BINS = BINS // 2
#: Least width of a bin, as a share of the values' size: finer, and floats could not tell its edges apart.
FINEST = 2.0**-40
#: Rows taken in at a time.
ROWS = 8192
#: Bars drawn, and the share of the values that the drawn range may leave out on each side.
BARS, TAIL = 40, 0.001


@dataclass(frozen=True)
class Distribution:
    """How often values lie where.

    Attributes
    ----------
    count : int
        Valid values.
    low, high : float
        Least and largest value.
    zero_share : float
        Share of the values that are exactly zero.
    edges : (B + 1,) float64
        Edges of the bars; they hold all values but at most 0.1 % on each side.
    shares : (B,) float64
        Share of all values in each bar.
    """

    count: int
    low: float
    high: float
    zero_share: float
    edges: Array
    shares: Array


class Histogram:
    """Running histograms of E elements.

    Widths of bins are powers of two and edges multiples of them, so that doubling a width merges whole bins: the
    counts are exact whatever came in which order.
    """

    def __init__(self, size: int) -> None:
        """Start without values."""
        self.counts = np.zeros((size, BINS), np.int64)
        self.start = np.zeros(size)
        self.width = np.zeros(size)
        self.zeros = np.zeros(size, np.int64)
        self.low = np.full(size, np.inf)
        self.high = np.full(size, -np.inf)

    def add(self, values: NDArray) -> None:
        """Take in finite values, `(N, E)`, a few thousand rows at a time: a long episode needs no more memory."""
        for start in range(0, len(values), ROWS):
            self._add(np.asarray(values[start : start + ROWS], float))

    def _add(self, values: Array) -> None:
        """Take in some rows."""
        self.zeros += (values == 0).sum(axis=0)
        low, high = values.min(axis=0), values.max(axis=0)
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
        for element in np.flatnonzero(self._is_outside(low, high)):
            self._fit(int(element))
        bins = np.floor((values - self.start) / self.width).astype(np.int64)
        np.add.at(self.counts.reshape(-1), (bins + BINS * np.arange(len(self.start))).ravel(), 1)

    def _is_outside(self, low: Array, high: Array) -> NDArray[np.bool_]:
        """Return `(E,)`: where new values need another range."""
        return (self.width == 0) | (low < self.start) | (high >= self.start + BINS * self.width)

    def _fit(self, element: int) -> None:
        """Widen one element's bins until its least and largest value lie inside."""
        low, high = self.low[element], self.high[element]
        if self.width[element] == 0:
            least_width = max(FINEST * max(abs(low), abs(high)), 1e-12)
            self.width[element] = 2.0 ** np.ceil(np.log2(max((high - low) / FIRST_BINS, least_width)))
            self.start[element] = np.floor(low / self.width[element] - BINS // 4) * self.width[element]
        while not (self.start[element] <= low and high < self.start[element] + BINS * self.width[element]):
            self._double(element, is_downward=low < self.start[element])

    def _double(self, element: int, is_downward: bool) -> None:
        """Double one element's bins, making room below or above."""
        old_start, width = self.start[element], 2 * self.width[element]
        start = (
            (np.ceil(old_start / width + BINS / 2) - BINS) * width
            if is_downward
            else np.floor(old_start / width) * width
        )
        target = np.floor((old_start + self.width[element] * np.arange(BINS) - start) / width).astype(np.int64)
        merged_counts = np.zeros(BINS, np.int64)
        np.add.at(merged_counts, target, self.counts[element])
        self.counts[element], self.start[element], self.width[element] = merged_counts, start, width

    def distribution(self, element: int) -> Distribution | None:
        """Return what was counted of one element, in few bars; None without a value."""
        counts = self.counts[element]
        count = int(counts.sum())
        if not count:
            return None
        cumulative = np.cumsum(counts)
        first_bin = int(np.searchsorted(cumulative, TAIL * count, side="right"))
        last_bin = int(np.searchsorted(cumulative, (1 - TAIL) * count, side="left"))
        group = max(1, -(-(last_bin - first_bin + 1) // BARS))
        edges = first_bin + group * np.arange(-(-(last_bin - first_bin + 1) // group) + 1)
        counts_below = np.concatenate([[0], cumulative])
        bars = np.diff(counts_below[np.minimum(edges, BINS)])
        return Distribution(
            count=count,
            low=float(self.low[element]),
            high=float(self.high[element]),
            zero_share=float(self.zeros[element] / count),
            edges=self.start[element] + self.width[element] * edges,
            shares=bars / count,
        )
