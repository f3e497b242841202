"""Streams put on one clock: the one function that resamples, by the role of a stream, and a line between two clocks.

Nothing is interpolated over a gap. No reading is invented: every value lies between its neighbours.
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
class ResampledStream:
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
) -> ResampledStream:
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
        never_valid = np.zeros(len(grid), bool)
        return ResampledStream(
            _mask_invalid(np.zeros((len(grid), *rows.shape[1:]), rows.dtype), never_valid), never_valid
        )
    limit = MAX_GAP_PERIODS * period_ns(time) if max_gap_ns is None else float(max_gap_ns)
    if role == "state":
        result, valid = _linear(time, rows, grid, limit, quaternion)
    elif role == "command":
        result, valid = _hold_last(time, rows, grid, limit)
    elif role in _OVER_A_STEP:
        result, valid = _over_steps(time, rows, grid, limit, role)
    else:
        raise UsageError("unknown role", expected=f"state, command, {', '.join(_OVER_A_STEP)}", found=repr(role))
    return ResampledStream(_mask_invalid(result, valid), valid)


#: What a channel's readings mean; others are states.
ROLES: dict[str, Role] = {
    "action": "command",
    "joint_effort": "measurement",
    "supply_voltage": "measurement",
    "torque_on": "command",
    "fingertip_force": "measurement",
    "fingertip_contact": "flag",
    "fingertip_collision": "flag",
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
) -> ResampledStream:
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
    elapsed_ns = (reference_ns - reference_ns[0]).astype(np.float64)
    centred_ns = elapsed_ns - elapsed_ns.mean()
    spread = float(centred_ns @ centred_ns)
    slope = float(centred_ns @ (difference - difference.mean())) / spread if spread else 0.0
    return Alignment(method=method, offset_s=float(np.median(difference)) * 1e-9, drift_ppm=slope * 1e6)


def _read_rows(time: Times, rows: NDArray) -> tuple[Times, NDArray]:
    """Return the rows that were read, the last of those with one stamp."""
    if time.shape != rows.shape[:1]:
        raise DataError("a stream has not one stamp a row", expected=f"{len(rows)} stamps", found=str(time.shape))
    backward_steps = np.flatnonzero(np.diff(time) < 0)
    if len(backward_steps):
        raise DataError(
            "the stamps of a stream run back", found=f"at row {backward_steps[0] + 1}", fix="sort the rows by time"
        )
    keep = np.append(np.diff(time) > 0, True)[: len(time)]
    if rows.dtype.kind == "f":
        keep &= np.isfinite(rows).all(axis=tuple(range(1, rows.ndim)))
    return (time, rows) if keep.all() else (time[keep], rows[keep])


def _mask_invalid(values: NDArray, valid: NDArray[np.bool_]) -> NDArray:
    """Return the values, with NaN where invalid if the type has it."""
    if values.dtype.kind == "f":
        values[~valid] = np.nan
    return values


def _neighbours(time: Times, at: Times, limit: float) -> tuple[NDArray, NDArray, NDArray[np.bool_]]:
    """Return the stamps before or at, and after or at, each time, and whether both lie within the limit."""
    lower = np.searchsorted(time, at, side="right") - 1
    upper = np.searchsorted(time, at, side="left")
    is_inside = (lower >= 0) & (upper < len(time))
    lower, upper = np.maximum(lower, 0), np.minimum(upper, len(time) - 1)
    return lower, upper, is_inside & (time[upper] - time[lower] <= limit)


def _linear(
    time: Times, rows: NDArray, at: Times, limit: float, quaternion: slice | None
) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return states between their neighbours."""
    lower, upper, valid = _neighbours(time, at, limit)
    step = np.maximum(time[upper] - time[lower], 1)
    share = np.clip((at - time[lower]) / step, 0.0, 1.0).reshape(-1, *[1] * (rows.ndim - 1))
    low, high = rows[lower].astype(np.float64), rows[upper].astype(np.float64)
    # The share's complement is exact at both ends, and a constant stays one; clipping undoes the last rounding.
    values = np.clip((1.0 - share) * low + share * high, np.minimum(low, high), np.maximum(low, high))
    if quaternion is not None:
        a, b = low[:, quaternion], high[:, quaternion]
        orientation = rotation.multiply(rotation.exp(share * rotation.difference(b, a)), a)
        values[:, quaternion] = np.where(share > 0, rotation.normalise(orientation), a)
    return values, valid


def _hold_last(time: Times, rows: NDArray, at: Times, limit: float) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return the last command at or before each time; the stream may end there, within the limit."""
    index = np.searchsorted(time, at, side="right") - 1
    is_known = index >= 0
    index = np.maximum(index, 0)
    next_one = np.minimum(index + 1, len(time) - 1)
    unbroken = time[next_one] - time[index] <= limit
    return rows[index], is_known & unbroken & (at - time[index] <= limit)


def _over_steps(time: Times, rows: NDArray, at: Times, limit: float, role: str) -> tuple[NDArray, NDArray[np.bool_]]:
    """Return the combined reading over [at[k-1], at[k]); the nearest reading where there is none."""
    step = int(at[1] - at[0]) if len(at) > 1 else int(min(limit, 1e9))
    edges = np.searchsorted(time, np.concatenate([at[:1] - step, at]), side="left")
    start, stop = edges[:-1], edges[1:]
    is_empty = start == stop
    nearest_index = _nearest_index(time, at - step / 2)
    lower, upper = np.maximum(start - 1, 0), np.minimum(stop, len(time) - 1)
    is_bridged = (start > 0) & (stop < len(time)) & (time[upper] - time[lower] <= limit)
    valid = np.where(is_empty, is_bridged, True)
    start, stop = np.where(is_empty, nearest_index, start), np.where(is_empty, nearest_index + 1, stop)
    return _OVER_A_STEP[role](rows, start, stop), valid


def _nearest_index(time: Times, at: NDArray) -> NDArray[np.intp]:
    """Return the index of the stamp next to each time."""
    upper = np.clip(np.searchsorted(time, at), 1, max(len(time) - 1, 1))
    lower = upper - 1
    upper = np.minimum(upper, len(time) - 1)
    return np.where(at - time[lower] <= time[upper] - at, lower, upper)


def _mean(rows: NDArray, start: NDArray, stop: NDArray) -> NDArray:
    """Return the mean of `rows[first:stop]`, between the least and the largest of them."""
    count = (stop - start).reshape(-1, *[1] * (rows.ndim - 1))
    values = rows.astype(np.float64)
    total = values[start]
    low, high = total.copy(), total.copy()
    for k in range(1, int((stop - start).max(initial=1))):
        step_ids = np.flatnonzero(stop - start > k)
        row = values[start[step_ids] + k]
        total[step_ids] += row
        low[step_ids], high[step_ids] = np.minimum(low[step_ids], row), np.maximum(high[step_ids], row)
    return np.clip(total / count, low, high)


def _any_set(rows: NDArray, start: NDArray, stop: NDArray) -> NDArray:
    """Return whether any of `rows[first:stop]` is set."""
    total = np.concatenate([np.zeros((1, *rows.shape[1:]), np.int64), np.cumsum(rows.astype(bool), axis=0)])
    return total[stop] > total[start]


def _last_row(rows: NDArray, start: NDArray, stop: NDArray) -> NDArray:
    """Return the last of `rows[first:stop]`."""
    return rows[stop - 1]


_OVER_A_STEP = {"measurement": _mean, "sample": _last_row, "flag": _any_set}


def time_factor(ratio: float) -> str:
    """Return in words by what factor steps of time are off; empty if it is neither a unit's factor nor a whole number.

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
