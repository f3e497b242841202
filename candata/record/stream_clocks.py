"""Clocks of the streams beside a hand, found against the clock of the log.

A device's own clock is laid on the host's stamps by a line. A stream without one is shifted, on request, until its
speed goes with that of the hand's joints, window by window; a line through the lags gives offset and drift. What
cannot be told (a still hand, periodic motion, no common motion, windows that disagree, a clock that steps) leaves the
stamps as they are, and says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata import align, rotation
from candata.record.companions import RecordedStream
from candata.record.import_streams import WIRE
from candata.record.motion_lags import Lag, LagRefusal, Speed, window_lags
from candata.schema.channels import QUATERNION
from candata.schema.episode import StreamClock

#: Channels that show how a stream moves; what is commanded moves earlier.
_MOVING = ("joint_position", "hand_pose", "object_pose")
#: Windows further from their line than this tell of no one clock [s]: some times what true lags of a 15 Hz tracker do.
LARGEST_RESIDUAL_S = 0.03
#: Least share of the windows with motion that must give a lag. Chosen.
LEAST_WINDOWS_SHARE = 0.5
#: A slope counts where it exceeds so many of its standard errors.
DRIFT_ERRORS = 3.0
#: Windows that a slope needs: two always lie on a line.
DRIFT_WINDOWS = 3
#: Frames that a line of a device's clock needs.
DEVICE_FRAMES = 20
#: Share of readings that may repeat the one before: more, and the clock ticks slower than the frames come. Chosen.
MAX_REPEATED_SHARE = 0.05
#: Crystals are off by 1e-4 at most; a clock this far from the host's counts in another unit. Chosen.
MAX_DEVICE_DRIFT = 0.01
#: In a block of this length, and of `DEVICE_FRAMES` at least, a frame comes without delay even on a loaded machine [s].
BLOCK_S = 2.0
#: A message is never early: so many of a stream's frames arrive sooner than the line is laid.
EARLY_SHARE = 0.05


@dataclass(frozen=True)
class _Line:
    """A clock against the log's: late by `offset_s` at `start_ns`, and by `slope` more each second."""

    offset_s: float
    slope: float
    residual_s: float


def set_clocks(
    streams: Sequence[RecordedStream], *, by_motion: bool
) -> tuple[list[RecordedStream], tuple[StreamClock, ...]]:
    """Return the streams with their stamps on the clock of the log, and how that clock was found, for each origin.

    Parameters
    ----------
    streams : sequence of RecordedStream
        The first holds the joints of the hand; those from the wire are on the clock of the log.
    by_motion : bool
        Fit those whose own clock does not serve by their motion. Else their stamps hold, and streams without a clock
        are not among the clocks.
    """
    reference, clocks = streams[0], {}
    aligned: dict[int, RecordedStream] = {}
    for origin in dict.fromkeys(s.origin for s in streams if s.origin != WIRE):
        members = [(k, s) for k, s in enumerate(streams) if s.origin == origin]
        if not by_motion and members[0][1].device_time_ns is None:
            continue
        clock, times = _clock(reference, origin, [s for _, s in members], by_motion)
        clocks[origin] = clock
        aligned |= {k: replace(s, time_ns=time_ns) for (k, s), time_ns in zip(members, times, strict=True)}
    return [aligned.get(k, s) for k, s in enumerate(streams)], tuple(clocks.values())


def _clock(
    reference: RecordedStream, origin: str, members: Sequence[RecordedStream], by_motion: bool
) -> tuple[StreamClock, list[NDArray[np.int64]]]:
    """Return the clock of one origin, and the stamps of its streams on the clock of the log."""
    untouched, reasons = [s.time_ns for s in members], []
    device_ns = members[0].device_time_ns
    if device_ns is not None:
        found = _device_clock(origin, members[0].time_ns, device_ns)
        if not isinstance(found, str):
            return found[0], [found[1]] * len(members)
        reasons.append(found)
    if by_motion:
        motion = _motion_clock(reference, origin, members)
        if not isinstance(motion, str):
            return motion, [_shifted(s.time_ns, motion, int(reference.time_ns[0])) for s in members]
        reasons.append(motion)
    return StreamClock(stream=origin, method="stamps", reason="; ".join(reasons)), untouched


def _device_clock(
    origin: str, host_ns: NDArray[np.int64], device_ns: NDArray[np.int64]
) -> tuple[StreamClock, NDArray[np.int64]] | str:
    """Return a clock by the device's own, and the stamps by it; why not, where it does not serve."""
    backward_steps = np.flatnonzero(np.diff(device_ns) < 0)
    if len(backward_steps):
        return f"the device's clock steps back {len(backward_steps)} times, first at frame {backward_steps[0] + 1}"
    if len(np.unique(device_ns)) < DEVICE_FRAMES:
        return f"fewer than {DEVICE_FRAMES} readings of the device's clock"
    repeated_share = float(np.mean(np.diff(device_ns) == 0))
    if repeated_share > MAX_REPEATED_SHARE:
        return f"the device's clock is coarse: {repeated_share:.0%} of its readings repeat the one before"
    device_s, host_s = (device_ns - device_ns[0]) * 1e-9, (host_ns - host_ns[0]) * 1e-9
    line = _theil_sen(device_s, host_s - device_s)
    if abs(line.slope) > MAX_DEVICE_DRIFT:
        return f"the device's clock runs {1 / (1 + line.slope):.4g} times as fast as the host's: another unit of time?"
    late_s = host_s - device_s - line.offset_s - line.slope * device_s
    residual_s = float(np.median(np.abs(late_s)))
    blocks = max(1, min(int(host_s[-1] / BLOCK_S), len(late_s) // DEVICE_FRAMES))
    spread_s = float(np.ptp([block.min() for block in np.array_split(late_s, blocks)]))
    if spread_s > LARGEST_RESIDUAL_S:
        return f"the device's clock steps or wanders against the host's stamps, by {spread_s:.3f} s"
    stamps_s = device_s + line.offset_s + line.slope * device_s + float(np.quantile(late_s, EARLY_SHARE))
    clock = StreamClock(
        stream=origin,
        method="device_clock",
        offset_s=float(np.median(host_s - stamps_s)),
        drift_ppm=-line.slope * 1e6,
        residual_s=residual_s,
    )
    return clock, host_ns[0] + np.round(stamps_s * 1e9).astype(np.int64)


def _motion_clock(reference: RecordedStream, origin: str, members: Sequence[RecordedStream]) -> StreamClock | str:
    """Return the clock of an origin by its motion; why not, where that does not tell."""
    joint_speed = _speeds(reference)[0]
    results = [
        _fit(origin, window_lags(joint_speed, speed, int(reference.time_ns[0])))
        for stream in members
        if stream.channel in _MOVING
        for speed in _speeds(stream)
    ]
    clocks = [result for result in results if isinstance(result, StreamClock)]
    if clocks:
        return max(clocks, key=lambda clock: clock.correlation or 0.0)
    return str(results[0]) if results else "it shows no motion"


def _fit(origin: str, lags: Sequence[Lag | LagRefusal]) -> StreamClock | str:
    """Return the clock by the lags of all windows; why not, where they do not tell."""
    kept = [lag for lag in lags if isinstance(lag, Lag)]
    refusals = [refusal for refusal in lags if isinstance(refusal, LagRefusal)]
    moving = [refusal for refusal in refusals if not refusal.is_still]
    if not kept or len(kept) < LEAST_WINDOWS_SHARE * (len(kept) + len(moving)):
        reasons = [refusal.reason for refusal in moving or refusals]
        return max(reasons, key=reasons.count) if reasons else "too little of both streams overlaps"
    at_s, lag_s = np.array([lag.at_s for lag in kept]), np.array([lag.lag_s for lag in kept])
    line = _significant(at_s, lag_s)
    if line.residual_s > LARGEST_RESIDUAL_S:
        return f"windows disagree by {line.residual_s:.3f} s: the clock stepped, or it is no common motion"
    return StreamClock(
        stream=origin,
        method="motion",
        offset_s=line.offset_s,
        drift_ppm=line.slope * 1e6,
        correlation=float(np.median([lag.correlation for lag in kept])),
        sharpness=float(np.median([lag.sharpness for lag in kept])),
        windows=len(kept),
        residual_s=line.residual_s,
    )


def _significant(at_s: NDArray[np.float64], lag_s: NDArray[np.float64]) -> _Line:
    """Return the line through lags, a level one where the slope may be chance."""
    level = _Line(float(np.median(lag_s)), 0.0, float(np.abs(lag_s - np.median(lag_s)).max()))
    if len(at_s) < DRIFT_WINDOWS:
        return level
    line = _theil_sen(at_s, lag_s)
    spread_s = float(np.std(lag_s - line.offset_s - line.slope * at_s, ddof=2))
    error = spread_s / (np.sqrt(len(at_s)) * float(np.std(at_s)))
    return line if abs(line.slope) > DRIFT_ERRORS * error else level


#: Points of which all pairs are taken: more are thinned, which costs little of what a median knows.
_THEIL_SEN_POINTS = 300


def _theil_sen(at_s: NDArray[np.float64], value_s: NDArray[np.float64]) -> _Line:
    """Return the line with the median slope of all pairs and the median level.

    Source: Sen, "Estimates of the regression coefficient based on Kendall's tau", JASA 63 (1968).
    """
    rows = np.unique(np.linspace(0, len(at_s) - 1, min(len(at_s), _THEIL_SEN_POINTS)).astype(int))
    first, second = np.triu_indices(len(rows), 1)
    run_s = at_s[rows][second] - at_s[rows][first]
    rise_s = value_s[rows][second] - value_s[rows][first]
    slope = float(np.median(rise_s[run_s > 0] / run_s[run_s > 0]))
    offset_s = float(np.median(value_s - slope * at_s))
    return _Line(offset_s, slope, float(np.abs(value_s - offset_s - slope * at_s).max()))


def _shifted(time_ns: NDArray[np.int64], clock: StreamClock, start_ns: int) -> NDArray[np.int64]:
    """Return stamps with offset and drift taken off."""
    since_s = (time_ns - start_ns) * 1e-9
    return time_ns - np.round((clock.offset_s + clock.drift_ppm * 1e-6 * since_s) * 1e9).astype(np.int64)


def _speeds(stream: RecordedStream) -> list[Speed]:
    """Return how fast a stream moves: all joints together; of a pose, its place and its turn apart."""
    is_read = np.isfinite(stream.values).all(axis=1) & np.append(np.diff(stream.time_ns) > 0, True)
    time_ns, values = stream.time_ns[is_read], stream.values[is_read]
    if len(time_ns) < 2:
        return [Speed(np.zeros(0, np.int64), np.zeros(0), np.inf)]
    step_s = np.diff(time_ns) * 1e-9
    middle_ns = time_ns[:-1] + np.diff(time_ns) // 2
    quaternion = QUATERNION.get(stream.channel)
    if quaternion is None:
        moves = [np.linalg.norm(np.diff(values, axis=0), axis=1)]
    else:
        turn = rotation.difference(values[1:, quaternion], values[:-1, quaternion])
        moves = [np.linalg.norm(np.diff(values[:, :3], axis=0), axis=1), np.linalg.norm(turn, axis=1)]
    period_s = align.period_ns(time_ns) * 1e-9
    is_gap = step_s > align.MAX_GAP_PERIODS * period_s
    return [Speed(middle_ns, np.where(is_gap, np.nan, move / step_s), period_s) for move in moves]


def clock_notes(clocks: Sequence[StreamClock]) -> list[str]:
    """Return how each clock was found, a line each."""
    return [f"clock of {clock.stream}: {_found_text(clock)}" for clock in clocks]


def _found_text(clock: StreamClock) -> str:
    """Return how a clock was found."""
    if clock.method == "stamps":
        return f"not fitted, its stamps are taken as they are: {clock.reason}"
    size = f"late by {clock.offset_s * 1e3:+.1f} ms, drift {clock.drift_ppm:+.0f} ppm"
    if clock.method == "device_clock":
        return f"{size}, by its own clock; stamps lie {(clock.residual_s or 0.0) * 1e3:.1f} ms from the line"
    return (
        f"{size}, by motion in {clock.windows} windows (correlation {clock.correlation:.2f}, sharpness "
        f"{clock.sharpness:.2f}, within {(clock.residual_s or 0.0) * 1e3:.1f} ms of the line)"
    )
