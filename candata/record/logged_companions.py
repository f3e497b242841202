"""Streams that a log holds beside the hand, as an import takes them: joints, targets and poses with their stamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.record.companions import IMPORTED_CHANNELS, Companion, RecordedStream
from candata.record.log_streams import LoggedStream, SignalMeta
from candata.record.logs import Log

#: Channels of an episode whose signal in a stream bears another name.
CHANNELS = {"joint_target": "action"}
#: A quaternion further from unit is no reading; closer, rounding on the wire explains it.
UNIT_TOLERANCE = 0.01
_NAMED = ("joint_position", "action")


def logged_companions(log: Log) -> tuple[list[Companion], list[str]]:
    """Return the streams of a log beside its hand, and what of them is not taken, as lines for people.

    A stream's stamps are those of its arrival. Their origin begins with `/`, as no file's name does.
    """
    companions, notes = [], []
    for stream in log.streams:
        taken: list[RecordedStream] = []
        for signal in stream.meta.signals:
            if signal.name == stream.meta.device_time:
                continue
            reason = _reason_to_leave(stream, signal)
            if reason:
                notes.append(f"/{stream.meta.name}: {signal.name} stays in the log; {reason}")
                continue
            taken.append(_recorded(stream, signal, notes))
        companions.append(Companion(f"/{stream.meta.name}", tuple(taken), ""))
    return companions, notes


def is_logged(stream: RecordedStream) -> bool:
    """Return whether a stream comes from a log's streams beside the hand: its silence is a gap, never an end."""
    return stream.origin.startswith("/")


def _reason_to_leave(stream: LoggedStream, signal: SignalMeta) -> str:
    """Return why a signal is not taken; empty where it is."""
    channel = CHANNELS.get(signal.name, signal.name)
    if channel not in IMPORTED_CHANNELS:
        return "an import takes no such channel from beside the hand"
    if channel in _NAMED and not signal.names:
        return "its joints have no names"
    if not len(stream.time_ns):
        return "it was never heard"
    return ""


def _recorded(stream: LoggedStream, signal: SignalMeta, notes: list[str]) -> RecordedStream:
    """Return one signal as a stream of an import; adds a line to `notes` where readings are no poses."""
    channel = CHANNELS.get(signal.name, signal.name)
    values = np.array(stream.values[signal.name], np.float64)
    if channel.endswith("_pose"):
        bad_rows = _mend_quaternions(values)
        if bad_rows:
            notes.append(f"/{stream.meta.name}: {bad_rows} poses without a unit quaternion are taken for gaps")
    time_ns = np.maximum.accumulate(stream.time_ns) if len(stream.time_ns) else stream.time_ns
    return RecordedStream(channel, signal.names, time_ns, values, f"/{stream.meta.name}", stream.device_time_ns)


def _mend_quaternions(poses: NDArray[np.float64]) -> int:
    """Make quaternions of poses (n, 7) unit in place, rows that hold none NaN; return how many those are."""
    norm = np.linalg.norm(poses[:, 3:], axis=1)
    is_bad = ~(np.abs(norm - 1.0) < UNIT_TOLERANCE)
    poses[is_bad] = np.nan
    poses[~is_bad, 3:] /= norm[~is_bad, None]
    return int((is_bad & np.isfinite(norm)).sum())
