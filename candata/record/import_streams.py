"""Streams of an import: what the wire carries, what its companions add, and the order of joints and fingertips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from candata import align
from candata.errors import DataError, Where
from candata.record.bursts import TIMER_S, seen_rate_hz
from candata.record.companions import Companion, RecordedStream
from candata.record.logs import Log
from candata.schema.scene import SceneFile

WIRE = "the wire"


#: Frames that waited for a held-up reader bear stamps at the pace of the wire: steps below this share of a period.
BURST_PERIODS = 0.8


def came_late(time_ns: NDArray[np.int64], max_gap_periods: float) -> NDArray[np.bool_]:
    """Return `(n,) bool`: frames read in one burst after a gap.

    They had waited for a reader that was held up, nobody knows for how long, so that their stamps tell nothing.

    Parameters
    ----------
    time_ns : (n,) int64 [ns]
        Stamps of a stream.
    max_gap_periods : float
        Neighbours further apart, in periods of the stream, are the ends of a gap.
    """
    steps, period = np.diff(time_ns), align.period_ns(time_ns)
    is_close = np.append(steps < BURST_PERIODS * period, False)
    is_late = np.zeros(len(time_ns), bool)
    for begin in np.flatnonzero(steps > max_gap_periods * period) + 1:
        end = begin + int(np.argmin(is_close[begin:]))
        is_late[begin : end + 1] = end > begin
    return is_late


def gap_periods(stream: RecordedStream, periods: float, in_bursts: bool) -> float:
    """Return from how many median intervals on neighbours of a stream are the ends of a gap: `periods`.

    Of a wire that is read in bursts (`in_bursts`) that interval is the timer's, not the stream's; so many of its mean
    periods, and one of the timer, are allowed.
    """
    rate_hz, period = seen_rate_hz(stream.time_ns), align.period_ns(stream.time_ns)
    if not in_bursts or stream.origin != WIRE or not rate_hz:
        return periods
    return 1e9 * (periods / rate_hz + TIMER_S) / period


def punctual(log: Log, max_gap_periods: float) -> tuple[Log, str]:
    """Return the log without the frames that came late, and a line for people on how many, empty for none."""
    states, commands = came_late(log.state_time_ns, max_gap_periods), came_late(log.command_time_ns, max_gap_periods)
    if not (states.any() or commands.any()):
        return log, ""
    by_state = ("state_time_ns", "joint_position", "motor_current", "force_counts", "taxel_counts")
    timely_arrays = {name: getattr(log, name)[~states] for name in by_state if getattr(log, name) is not None}
    timely_arrays |= {name: getattr(log, name)[~commands] for name in ("command_time_ns", "joint_target")}
    counts = f"{int(states.sum())} states, {int(commands.sum())} commands"
    return replace(log, **timely_arrays), f"left out, read late in a burst after a gap: {counts}"


def wire_streams(log: Log, newton_per_count: float) -> list[RecordedStream]:
    """Return what the wire carries: joints, targets, calibrated forces [N] and raw taxels."""
    meta, bias = log.meta, 0.0 if log.calibration is None else log.calibration.force_bias_counts
    streams = [RecordedStream("joint_position", meta.joint_names, log.state_time_ns, log.joint_position, WIRE)]
    if len(log.command_time_ns):
        streams.append(RecordedStream("action", meta.joint_names, log.command_time_ns, log.joint_target, WIRE))
    if meta.fingertip_names:
        force = (log.force_counts - bias) * newton_per_count
        streams.append(RecordedStream("fingertip_force", meta.fingertip_names, log.state_time_ns, force, WIRE))
    if log.taxel_counts is not None and log.taxel_counts.size:
        streams.append(RecordedStream("taxels", meta.fingertip_names, log.state_time_ns, log.taxel_counts, WIRE))
    return streams


def merge_streams(
    wire: Sequence[RecordedStream], companions: Sequence[Companion]
) -> tuple[list[RecordedStream], list[str]]:
    """Return the streams of an import, a joint from one place only, and what was not taken, as lines for people.

    The wire comes before its companions, these in the order given.

    Raises
    ------
    DataError
        When two companions hold the same pose.
    """
    streams, notes = list(wire), []
    for companion in companions:
        if companion.left_out:
            notes.append(f"{companion.name}: {', '.join(companion.left_out)} not taken; forces come from the wire")
        for stream in companion.streams:
            new_stream, note = _new_columns(stream, [s for s in streams if s.channel == stream.channel])
            streams += [new_stream] if new_stream else []
            notes += [note] if note else []
    return streams, notes


def _new_columns(
    stream: RecordedStream, present_streams: Sequence[RecordedStream]
) -> tuple[RecordedStream | None, str]:
    """Return the columns that no standing stream has, and a line about the others."""
    if not present_streams:
        return stream, ""
    if not stream.names:
        raise DataError(
            f"two files hold {stream.channel}",
            expected="one",
            found=f"{present_streams[0].origin} and {stream.origin}",
            fix="import with one of them",
        )
    present_names = {name for s in present_streams for name in s.names}
    repeated_names = [name for name in stream.names if name in present_names]
    new_columns = [k for k, name in enumerate(stream.names) if name not in present_names]
    note = (
        f"{stream.origin}: {stream.channel} of {', '.join(repeated_names)} not taken; {WIRE} carries it"
        if repeated_names
        else ""
    )
    if not new_columns:
        return None, note
    names = tuple(stream.names[k] for k in new_columns)
    return replace(stream, names=names, values=stream.values[:, new_columns]), note


def column_order(
    streams: Sequence[RecordedStream], roles: SceneFile | None
) -> tuple[NDArray[np.intp] | None, tuple[str, ...]]:
    """Return the order of the joined columns of one channel and their names; None where they stand in order.

    The scene's order where there is a scene, what it does not name behind; else companions first, then the wire.

    Raises
    ------
    DataError
        When joints or actuators of the scene are in none of the streams, or it has none of their joints.
    """
    names = [name for s in streams for name in s.names]
    if not names:
        return None, ()
    channel = streams[0].channel
    scene_names = _scene_order(channel, roles)
    absent_names = [name for name in scene_names if name not in names]
    if absent_names and channel in ("joint_position", "action"):
        raise DataError(
            f"{channel} lacks joints of the scene",
            expected=", ".join(scene_names),
            found=", ".join(names),
            where=Where(channel=channel),
            fix=f"bring {', '.join(absent_names)} by --with TABLE, or import without --scene",
        )
    if channel == "joint_position" and roles is not None and not set(scene_names) & set(names):
        raise DataError(
            "the scene has none of the hand's joints",
            expected=", ".join(names),
            found=", ".join(scene_names) or "a scene without joints",
            fix="give the scene of this hand, or import without --scene",
        )
    if absent_names or not scene_names:
        scene_names = () if absent_names else tuple(name for s in streams if s.origin != WIRE for name in s.names)
    order = [names.index(name) for name in scene_names] + [k for k, name in enumerate(names) if name not in scene_names]
    in_place = order == list(range(len(names)))
    return None if in_place else np.array(order, np.intp), tuple(names[k] for k in order)


def _scene_order(channel: str, roles: SceneFile | None) -> tuple[str, ...]:
    """Return the scene's names of a channel's columns."""
    if roles is None:
        return ()
    tips = roles.fingertips
    by_channel = {
        "joint_position": roles.joints,
        "action": roles.actuator_names,
        "fingertip_force": tips,
        "taxels": tips,
    }
    return by_channel.get(channel, ())


def require_overlap(path: str, streams: Sequence[RecordedStream]) -> None:
    """Refuse a stream that ends before the wire's states begin, or begins after they end.

    Raises
    ------
    DataError
        Names both spans.
    """
    states = streams[0].time_ns
    for stream in streams[1:]:
        time_ns = stream.time_ns
        if not len(time_ns) or time_ns[-1] < states[0] or time_ns[0] > states[-1]:
            raise DataError(
                f"{stream.channel} of {stream.origin} was not recorded while the log was",
                expected=f"stamps within {span(states)}",
                found=span(time_ns),
                where=Where(path=path, channel=stream.channel),
                fix="give its stamps in seconds of unix time, of the machine that wrote the log",
            )


def span(time_ns: NDArray[np.int64]) -> str:
    """Return first and last time of a stream, in UTC and in unix seconds."""
    if not len(time_ns):
        return "no stamps"
    return " to ".join(f"{utc(int(t))} ({t * 1e-9:.3f} s)" for t in (time_ns[0], time_ns[-1]))


def utc(time_ns: int) -> str:
    """Return a time in UTC to the millisecond, `no date` for a number that is none."""
    try:
        return datetime.fromtimestamp(time_ns * 1e-9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    except (ValueError, OverflowError, OSError):
        return "no date"
