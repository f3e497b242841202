"""Streams put on one clock: the one function that resamples, by what a stream means, and a line between two clocks.

Nothing is interpolated over a gap. A reading is invented nowhere: every value lies between its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from candata import rotation
from candata.errors import DataError, UsageError
from candata.schema.channels import QUATERNION
from candata.schema.episode import Alignment

Role = Literal["state", "command", "measurement", "sample", "flag"]
Times = NDArray[np.int64]

#: Neighbours further apart than this many periods of the stream are the ends of a gap: between one lost reading
#: (two periods) and none (one period, with jitter).
MAX_GAP_PERIODS = 1.5
#: A step this many times the median is a gap that should be marked invalid.
GAP_STEPS = 5.0
#: Units of time that stamps are taken for by mistake, as ratios of seconds, milliseconds, microseconds, nanoseconds.
TIME_UNITS = (1e3, 1e6, 1e9)
#: How near a ratio of rates is to a whole number, or to a unit's, to be called that. Chosen.
NEAR_FACTOR = 0.1


@dataclass(frozen=True, eq=False)
class Resampled:
    """A stream on a grid.

    Attributes
    ----------
    values : (K, ...) ndarray
        What the stream says at each time of the grid; where invalid, NaN, or the last known where there is no NaN.
    valid : (K,) bool
        False outside the stream and within its gaps.
    """

    values: NDArray
    valid: NDArray[np.bool_]


def resample(
    time_ns: Times,
    values: NDArray,
    grid_ns: Times,
    role: Role,
    *,
    max_gap_ns: float | None = None,
    quaternion: slice | None = None,
) -> Resampled:
    """Return what a stream says at the times of a grid.

    Parameters
    ----------
    time_ns : (n,) int64 [ns]
        Stamps of the stream, not decreasing; of equal ones the last counts.
    values : (n, ...) ndarray
        What was read at each stamp; rows that are not finite count as not read.
    grid_ns : (K,) int64 [ns]
        Times at which it is asked for, strictly increasing.
    role : str
        `state`: linear between the neighbours. `command`: the last at or before. `measurement`: the mean over
        [grid[k-1], grid[k]), the nearest where none falls in. `flag`: whether any in that step is set. `sample`: the
        last in that step, unchanged. The step before grid[0] is as long as the one after it.
    max_gap_ns : float, optional
        Neighbours further apart are the ends of a gap [ns]; 1.5 median intervals of the stream by default.
    quaternion : slice, optional
        Columns of a state that hold a unit quaternion w x y z: it turns at constant speed, the shorter way.

    Raises
    ------
    DataError
        When the stamps run back, or are not as many as the rows.
    UsageError
        When the role is not known.
    """
    time, rows = np.asarray(time_ns, np.int64), np.asarray(values)
    time, rows = _read_rows(time, rows)
    grid = np.asarray(grid_ns, np.int64)
    if not len(time):
        nothing = np.zeros(len(grid), bool)
        return Resampled(_filled(np.zeros((len(grid), *rows.shape[1:]), rows.dtype), nothing), nothing)
    limit = MAX_GAP_PERIODS * period_ns(time) if max_gap_ns is None else float(max_gap_ns)
    if role == "state":
        found, valid = _linear(time, rows, grid, limit, quaternion)
    elif role == "command":
        found, valid = _held(time, rows, grid, limit)
    elif role in _OVER_A_STEP:
        found, valid = _over_steps(time, rows, grid, limit, role)
    else:
        raise UsageError("unknown role", expected=f"state, command, {', '.join(_OVER_A_STEP)}", found=repr(role))
    return Resampled(_filled(found, valid), valid)


#: What a channel's readings mean; others are states.
ROLES: dict[str, Role] = {
    "action": "command",
    "joint_effort": "measurement",
    "fingertip_force": "measurement",
    "fingertip_contact": "flag",
    "contact": "flag",
    "taxels": "sample",
}


def on_rows(
    channel: str,
    time_ns: Times,
    values: NDArray,
    rows_ns: Times,
    *,
    max_gap_periods: float = MAX_GAP_PERIODS,
    role: Role | None = None,
    action: Literal["next", "previous"] = "next",
) -> Resampled:
    """Return a stream at the rows of an episode, each kind of reading where it counts.

    A command counts by the middle of the step that it is held over; a reading over a step (force, flag, sample) by the
    middle of the stream's period before its stamp. With one rate for stream and rows, jitter below half a period then
    moves nothing into another row.

    Parameters
    ----------
    channel : str
        Channel; says the role where none is given, and which columns are a quaternion.
    time_ns, values, rows_ns
        As in `resample`.
    max_gap_periods : float
        Neighbours further apart, in median intervals of the stream, are the ends of a gap.
    role : str, optional
        Another role than the channel's.
    action : str
        Whether a command is held over the step after its row or the one before.

    Raises
    ------
    DataError, UsageError
        As `resample`.
    """
    role, period = role or ROLES.get(channel, "state"), period_ns(time_ns)
    step = float(rows_ns[1] - rows_ns[0]) if len(rows_ns) > 1 else 0.0
    shift = {"state": 0.0, "command": step if action == "next" else -step}.get(role, period) / 2
    at = rows_ns + (round(shift) if np.isfinite(shift) else 0)
    gap = max_gap_periods * period
    return resample(time_ns, values, at, role, max_gap_ns=gap, quaternion=QUATERNION.get(channel))


def period_ns(time_ns: Times) -> float:
    """Return the median interval of a stream [ns]; infinite for fewer than two stamps."""
    steps = np.diff(np.unique(time_ns))
    return float(np.median(steps)) if len(steps) else np.inf


def grid(start_ns: int, end_ns: int, rate_hz: float) -> Times:
    """Return the times `(K,) int64 [ns]` from `start_ns` to at most `end_ns`, at a rate; no rounding adds up."""
    count = max(0, int(np.floor((end_ns - start_ns) * rate_hz * 1e-9 + 1e-6)) + 1)
    return start_ns + np.round(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)


def clock_fit(reference_ns: Times, other_ns: Times, method: str) -> Alignment:
    """Return offset and drift of another clock against a reference, read at the same moments.

    The offset is the median of other minus reference; the drift is the slope of a straight line through the
    differences, by least squares.

    Parameters
    ----------
    reference_ns, other_ns : (n,) int64 [ns]
        Readings of both clocks.
    method : str
        Words that say how the streams were aligned.
    """
    difference = (np.asarray(other_ns, np.int64) - np.asarray(reference_ns, np.int64)).astype(np.float64)
    if not len(difference):
        return Alignment(method=method)
    elapsed = (reference_ns - reference_ns[0]).astype(np.float64)
    centred = elapsed - elapsed.mean()
    spread = float(centred @ centred)
    slope = float(centred @ (difference - difference.mean())) / spread if spread else 0.0
    return Alignment(method=method, offset_s=float(np.median(difference)) * 1e-9, drift_ppm=slope * 1e6)


def _read_rows(time: Times, rows: NDArray) -> tuple[Times, NDArray]:
    """Return the rows that were read, the last of those with one stamp."""
    if time.shape != rows.shape[:1]:
        raise DataError("a stream has not one stamp a row", expected=f"{len(rows)} stamps", found=str(time.shape))
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        raise DataError("the stamps of a stream run back", found=f"at row {back[0] + 1}", fix="sort the rows by time")
    keep = np.append(np.diff(time) > 0, True)[: len(time)]
    if rows.dtype.kind == "f":
        keep &= np.isfinite(rows).all(axis=tuple(range(1, rows.ndim)))
    return (time, rows) if keep.all() else (time[keep], rows[keep])


def _filled(found: NDArray, valid: NDArray[np.bool_]) -> NDArray:
    """Return what was found, with NaN where invalid if the type has it."""
    if found.dtype.kind == "f":
        found[~valid] = np.nan
    return found


def _neighbours(time: Times, at: Times, limit: float) -> tuple[NDArray, NDArray, NDArray[np.bool_]]:
    """Return the stamps before or at, and after or at, each time, and whether both lie within the limit."""
    before = np.searchsorted(time, at, side="right") - 1
    after = np.searchsorted(time, at, side="left")
    inside = (before >= 0) & (after < len(time))
    before, after = np.maximum(before, 0), np.minimum(after, len(time) - 1)
    return before, after, inside & (time[after] - time[before] <= limit)


def _linear(
    time: Times, rows: NDArray, at: Times, limit: float, quaternion: slice | None
) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return states between their neighbours."""
    before, after, valid = _neighbours(time, at, limit)
    step = np.maximum(time[after] - time[before], 1)
    share = np.clip((at - time[before]) / step, 0.0, 1.0).reshape(-1, *[1] * (rows.ndim - 1))
    low, high = rows[before].astype(np.float64), rows[after].astype(np.float64)
    # The share's complement is exact at both ends, and a constant stays one; clipping undoes the last rounding.
    found = np.clip((1.0 - share) * low + share * high, np.minimum(low, high), np.maximum(low, high))
    if quaternion is not None:
        a, b = low[:, quaternion], high[:, quaternion]
        turned = rotation.multiply(rotation.exp(share * rotation.difference(b, a)), a)
        found[:, quaternion] = np.where(share > 0, rotation.normalise(turned), a)
    return found, valid


def _held(time: Times, rows: NDArray, at: Times, limit: float) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return the last command at or before each time; what follows within the limit need not be there."""
    before = np.searchsorted(time, at, side="right") - 1
    known = before >= 0
    before = np.maximum(before, 0)
    next_one = np.minimum(before + 1, len(time) - 1)
    unbroken = time[next_one] - time[before] <= limit
    return rows[before], known & unbroken & (at - time[before] <= limit)


def _over_steps(time: Times, rows: NDArray, at: Times, limit: float, role: str) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return what the readings of [at[k-1], at[k]) say together; the nearest reading where there is none."""
    step = int(at[1] - at[0]) if len(at) > 1 else int(min(limit, 1e9))
    edges = np.searchsorted(time, np.concatenate([at[:1] - step, at]), side="left")
    first, stop = edges[:-1], edges[1:]
    empty = first == stop
    nearest = _nearest(time, at - step / 2)
    before, after = np.maximum(first - 1, 0), np.minimum(stop, len(time) - 1)
    bridged = (first > 0) & (stop < len(time)) & (time[after] - time[before] <= limit)
    valid = np.where(empty, bridged, True)
    return _OVER_A_STEP[role](rows, np.where(empty, nearest, first), np.where(empty, nearest + 1, stop)), valid


def _nearest(time: Times, at: NDArray) -> NDArray[np.intp]:
    """Return the index of the stamp next to each time."""
    right = np.clip(np.searchsorted(time, at), 1, max(len(time) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(time) - 1)
    return np.where(at - time[left] <= time[right] - at, left, right)


def _mean(rows: NDArray, first: NDArray, stop: NDArray) -> NDArray:
    """Return the mean of `rows[first:stop]`, between the least and the largest of them."""
    count = (stop - first).reshape(-1, *[1] * (rows.ndim - 1))
    values = rows.astype(np.float64)
    total = values[first]
    low, high = total.copy(), total.copy()
    for k in range(1, int((stop - first).max(initial=1))):
        more = np.flatnonzero(stop - first > k)
        row = values[first[more] + k]
        total[more] += row
        low[more], high[more] = np.minimum(low[more], row), np.maximum(high[more], row)
    return np.clip(total / count, low, high)


def _any(rows: NDArray, first: NDArray, stop: NDArray) -> NDArray:
    """Return whether any of `rows[first:stop]` is set."""
    total = np.concatenate([np.zeros((1, *rows.shape[1:]), np.int64), np.cumsum(rows.astype(bool), axis=0)])
    return total[stop] > total[first]


def _last(rows: NDArray, first: NDArray, stop: NDArray) -> NDArray:
    """Return the last of `rows[first:stop]`."""
    return rows[stop - 1]


_OVER_A_STEP = {"measurement": _mean, "sample": _last, "flag": _any}


def time_factor(ratio: float) -> str:
    """Return in words by what factor steps of time are off; nothing where it is none of a unit and no whole number.

    Parameters
    ----------
    ratio : float
        Their median over what the stated rate says.
    """
    times = max(ratio, 1 / ratio)
    factor = next((f for f in (*TIME_UNITS, float(round(times))) if abs(times / f - 1) < NEAR_FACTOR), 1.0)
    if factor == 1:
        return ""
    unit = ": stamps in another unit of time" if factor in TIME_UNITS else ""
    return f", {factor:.4g} times as {'long' if ratio > 1 else 'short'} a step{unit}"
