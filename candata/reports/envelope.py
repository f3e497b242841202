"""Long traces as few points that hide nothing: each column of a plot keeps its least and its largest value."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Columns of a trace; a plot in a page is hardly wider in pixels.
COLUMNS = 240
#: A pause of this many usual steps between two rows is a gap, over which no line is drawn.
GAP_STEPS = 3.5


def envelope(time_s: Array, values: Array, columns: int = COLUMNS) -> tuple[list[float], list[float]]:
    """Return times and values of at most `2 columns` points (more only for gaps), NaN where a line must break.

    A longer trace becomes, in each of `columns` parts of equal time, its least and its largest value, so that a
    single wild value is still drawn.

    Parameters
    ----------
    time_s : (T,) float64 [s]
        Increasing.
    values : (T,) float64
        NaN where no value is valid.
    columns : int
        Columns of the plot.
    """
    if len(time_s) <= 2 * columns:
        return _with_breaks(time_s, values)
    low, high = bounds(time_s, values, columns)
    centres = time_s[0] + (np.arange(columns) + 0.5) * (time_s[-1] - time_s[0]) / columns
    return np.repeat(centres, 2).tolist(), np.stack([low, high], axis=1).ravel().tolist()


def bounds(time_s: Array, values: Array, columns: int) -> tuple[Array, Array]:
    """Return least and largest value in each of `columns` parts of equal time, `(columns,)`; NaN in an empty part."""
    column = column_of(time_s, columns)
    low, high = np.full(columns, np.nan), np.full(columns, np.nan)
    np.fmin.at(low, column, values)
    np.fmax.at(high, column, values)
    return low, high


def column_of(time_s: Array, columns: int) -> NDArray[np.int64]:
    """Return the column of each row, `(T,)`, when the time is cut into `columns` equal parts."""
    length = time_s[-1] - time_s[0]
    if not length > 0:
        return np.zeros(len(time_s), np.int64)
    return np.minimum((columns * (time_s - time_s[0]) / length).astype(np.int64), columns - 1)


def runs(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield first row and row behind the last of each unbroken stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def turning_rows(points: Array, stretches: int) -> NDArray[np.int64]:
    """Return rows, increasing, that keep a path's extremes: of each of `stretches` stretches the ends of every axis.

    Parameters
    ----------
    points : (T, D) float64
        NaN where no value is valid; such rows are kept only as breaks.
    stretches : int
        Stretches of equally many rows.
    """
    if len(points) <= 2 * points.shape[1] * stretches:
        return np.arange(len(points))
    rows = {0, len(points) - 1}
    for stretch in np.array_split(np.arange(len(points)), stretches):
        is_gap = np.isnan(points[stretch]).any(axis=1)
        rows |= {int(row) for row in stretch[is_gap][:1]}
        valid_rows = stretch[~is_gap]
        if len(valid_rows):
            extremes = (*points[valid_rows].argmin(axis=0), *points[valid_rows].argmax(axis=0))
            rows |= {int(valid_rows[i]) for i in extremes}
    return np.array(sorted(rows), np.int64)


def _with_breaks(time_s: Array, values: Array) -> tuple[list[float], list[float]]:
    """Return all points, with a break wherever rows are missing."""
    steps = np.diff(time_s)
    gaps = np.flatnonzero(steps > GAP_STEPS * np.median(steps)) if len(steps) else np.zeros(0, np.int64)
    times = np.insert(time_s, gaps + 1, time_s[gaps])
    return times.tolist(), np.insert(np.asarray(values, float), gaps + 1, np.nan).tolist()
