"""By how much one stream lags behind another, window by window: the lag at which their speeds go together best."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata import align

#: Length of a window and from one to the next [s]: some motions of a hand, and several windows a minute.
WINDOW_S, STEP_S = 20.0, 10.0
#: A recording shorter than a window is one window, down to this [s].
SHORTEST_S = 5.0
#: Stamps of the host are never further off than this [s]: a second of buffers. Chosen.
MAX_LAG_S = 1.0
#: Grid on which speeds are compared [Hz]: a lag lies between its points, by the parabola through the peak.
RATE_HZ = 100.0
#: Speeds are smoothed over at least this [s]: it spans four readings of an 83 Hz hand.
SMOOTH_S = 0.05
#: Correlation from which two speeds show one motion, and by how much its peak must rise above any other. Chosen.
LEAST_CORRELATION, LEAST_SHARPNESS = 0.5, 0.1
#: Correlation of a speed with itself at another time from which the motion is called periodic. Chosen.
PERIODIC_CORRELATION = 0.85
#: Least spread of the joints' speed in a window; below it the hand is still [rad/s]. Chosen: the noise of its joints.
STILL_RAD_S = 0.02
#: Every so many points tell as much of a period: what repeats is slower than the smoothing.
_THINNING = 5
#: Least share of a window in which both speeds are known.
KNOWN_SHARE = 0.7


@dataclass(frozen=True, eq=False)
class Speed:
    """A speed (m) at the middle of each step [ns], NaN over gaps; `period_s` is the stream's."""

    time_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    period_s: float


@dataclass(frozen=True)
class Lag:
    """A stream was `lag_s` late around `at_s` after the start; height of the peak, and above any other."""

    at_s: float
    lag_s: float
    correlation: float
    sharpness: float


@dataclass(frozen=True)
class LagRefusal:
    """Why a window gives no lag."""

    reason: str
    is_still: bool = False


def window_lags(reference: Speed, other: Speed, start_ns: int) -> list[Lag | LagRefusal]:
    """Return what each window tells of the lag of `other` behind `reference`; times count from `start_ns`."""
    smooth_s = max(SMOOTH_S, reference.period_s, other.period_s)
    if not np.isfinite(smooth_s):
        return []
    first_ns = max(int(reference.time_ns[0]), int(other.time_ns[0]))
    last_ns = min(int(reference.time_ns[-1]), int(other.time_ns[-1]))
    grid_ns = align.grid(first_ns, last_ns, RATE_HZ)
    span_s = len(grid_ns) / RATE_HZ
    if span_s < SHORTEST_S:
        return []
    x, y = (_smoothed(speed, grid_ns, smooth_s) for speed in (reference, other))
    lags: list[Lag | LagRefusal] = []
    for rows in _windows(len(grid_ns)):
        middle_s = (int(grid_ns[(rows.start + rows.stop) // 2]) - start_ns) * 1e-9
        lags.append(_lag(x, y, rows, middle_s))
    return lags


def _windows(count: int) -> Iterator[slice]:
    """Yield the windows of a grid with room for the largest lag on both sides."""
    margin, size, step = (round(length_s * RATE_HZ) for length_s in (MAX_LAG_S, WINDOW_S, STEP_S))
    size = min(size, count - 2 * margin)
    for begin in range(margin, count - margin - size + 1, step):
        yield slice(begin, begin + size)


def _smoothed(speed: Speed, grid_ns: NDArray[np.int64], smooth_s: float) -> NDArray[np.float64]:
    """Return a speed on the grid, the mean over `smooth_s` around each time; NaN where it is not known."""
    gap_ns = align.MAX_GAP_PERIODS * max(speed.period_s, align.period_ns(speed.time_ns) * 1e-9) * 1e9
    is_read = np.isfinite(speed.values)
    values = align.resample(
        speed.time_ns[is_read], speed.values[is_read, None], grid_ns, "state", max_gap_ns=gap_ns
    ).values[:, 0]
    half = max(1, round(smooth_s * RATE_HZ / 2))
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.convolve(np.pad(values, half, mode="edge"), kernel, "valid")


def _lag(x: NDArray[np.float64], y: NDArray[np.float64], rows: slice, middle_s: float) -> Lag | LagRefusal:
    """Return what one window tells."""
    window = x[rows]
    margin = round(MAX_LAG_S * RATE_HZ)
    around = y[rows.start - margin : rows.stop + margin]
    if np.isfinite(window).mean() < KNOWN_SHARE or np.isfinite(around).mean() < KNOWN_SHARE:
        return LagRefusal("gaps: too little of both is known")
    if np.nanstd(window) < STILL_RAD_S:
        return LagRefusal("the hand is still", is_still=True)
    if _is_periodic(window):
        return LagRefusal("the motion is periodic: one lag is as good as another a period on")
    heights = _correlations(window, around)
    peak = int(np.argmax(heights))
    if heights[peak] < LEAST_CORRELATION:
        return LagRefusal(f"no common motion: the speeds go together by {heights[peak]:.2f} at most")
    if peak in (0, len(heights) - 1):
        return LagRefusal(f"the lag is at its limit of {MAX_LAG_S:g} s")
    sharpness = float(heights[peak] - _rival(heights, peak))
    if sharpness < LEAST_SHARPNESS:
        return LagRefusal(f"no sharp peak: another lag is within {sharpness:.2f} of the best")
    before, height, after = heights[peak - 1 : peak + 2]
    bend = before - 2 * height + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return Lag(middle_s, float((peak - margin + shift) / RATE_HZ), float(height), sharpness)


def _correlations(window: NDArray[np.float64], around: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlation of a window with each stretch of its length in `around`; NaN count as the mean."""
    centred = np.nan_to_num(window - np.nanmean(window))
    stretches = np.lib.stride_tricks.sliding_window_view(np.nan_to_num(around - np.nanmean(around)), len(window))
    stretches = stretches - stretches.mean(axis=1, keepdims=True)
    sizes = np.linalg.norm(stretches, axis=1) * np.linalg.norm(centred)
    return np.asarray(stretches @ centred / np.where(sizes > 0, sizes, np.inf))


def _rival(heights: NDArray[np.float64], peak: int) -> float:
    """Return the height of the highest other peak, or of an end of the lags."""
    inner = heights[1:-1]
    is_peak = np.concatenate([[True], (inner >= heights[:-2]) & (inner >= heights[2:]), [True]])
    is_peak[peak - 1 : peak + 2] = False
    return float(heights[is_peak].max())


def _is_periodic(window: NDArray[np.float64]) -> bool:
    """Tell whether a speed repeats itself so soon that two lags within the limit would serve."""
    thinned = np.nan_to_num(window - np.nanmean(window))[::_THINNING]
    reach = round(2 * MAX_LAG_S * RATE_HZ / _THINNING)
    heights = _correlations(thinned[:-reach], thinned)
    is_low = heights < PERIODIC_CORRELATION / 2
    return bool(is_low.any() and (heights[int(np.argmax(is_low)) :] > PERIODIC_CORRELATION).any())
