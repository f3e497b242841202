"""What a recording counts: frames, gaps, losses by kind, requests without reply, saturated readings."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.record import bursts
from candata.record.devices._contract import Frame, Framer, States
from candata.record.logs import LogMeta

#: An interval of more than this many periods is a gap.
GAP_PERIODS = 1.5
_LOSSES = ("crc_failures", "garbage_bytes", "oversize")


class Beat:
    """When frames came: how many, at what rate, with what gaps.

    Attributes
    ----------
    count : int
        Frames so far.
    first_ns, last_ns : int or None
        Stamps of the first and the newest [ns].
    gaps : int
        Intervals of more than `GAP_PERIODS` periods.
    longest_gap_s : float
        The longest of them [s].
    """

    def __init__(self, rate_hz: float) -> None:
        """Start at nothing; `rate_hz` is the nominal rate."""
        self.count = 0
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.gaps, self.longest_gap_s = 0, 0.0
        self._period_ns = 1e9 / rate_hz
        self._recent: deque[int] = deque(maxlen=4096)

    @property
    def duration_s(self) -> float:
        """Seconds from the first frame to the last."""
        return (self.last_ns - self.first_ns) / 1e9 if self.first_ns is not None and self.last_ns is not None else 0.0

    @property
    def rate_hz(self) -> float:
        """Mean rate of the frames over the whole recording."""
        return (self.count - 1) / self.duration_s if self.duration_s > 0 else 0.0

    def recent_rate_hz(self, now_ns: int) -> float:
        """Return the rate of the frames over the last second, or over what there was of it."""
        if self.first_ns is None or now_ns <= self.first_ns:
            return 0.0
        span_ns = min(1_000_000_000, now_ns - self.first_ns)
        return 1e9 * sum(stamp > now_ns - span_ns for stamp in self._recent) / span_ns

    def frame_at(self, stamp_ns: int) -> None:
        """Count one frame."""
        self.count += 1
        if self.first_ns is None:
            self.first_ns = stamp_ns
        if self.last_ns is not None:
            interval = stamp_ns - self.last_ns
            if interval > GAP_PERIODS * self._period_ns:
                self.gaps += 1
                self.longest_gap_s = max(self.longest_gap_s, interval / 1e9)
        self.last_ns = stamp_ns
        self._recent.append(stamp_ns)


class RecorderTally(Beat):
    """Running counts of a hand's recording; feed it what was received, ask it for the numbers."""

    def __init__(self, meta: LogMeta) -> None:
        """Start at nothing."""
        super().__init__(meta.rate_hz)
        self.bytes = 0
        self.frames = {"state": 0, "command": 0, "other": 0}
        self.unanswered = 0
        self.saturated_forces, self.saturated_taxels = 0, 0
        self.unplugs: list[dict[str, int | None]] = []
        self._bursts_told = False
        self._offset_ns = meta.wall_offset_ns
        # Zero at the end of an unsigned axis is rest, not saturation: only what lies beyond zero tells.
        self._low = np.array([low if low < 0 else np.iinfo(np.int16).min for low in meta.count_low])
        self._high = np.array(meta.count_high)
        self._past = dict.fromkeys(_LOSSES, 0)
        self._framer: Framer | None = None
        self._asked = False
        self._rhythm = bursts.Rhythm()
        self._nominal_hz = meta.rate_hz

    @property
    def in_bursts(self) -> bool:
        """Whether bytes come at the beat of a USB adapter's latency timer."""
        return self._rhythm.is_in_bursts((self._nominal_hz, self.rate_hz))

    def read(self, data: bytes, stamp_ns: int) -> None:
        """Count what was read at once."""
        self.bytes += len(data)
        self._rhythm.read(stamp_ns)

    def use(self, framer: Framer) -> None:
        """Count the losses of `framer` from now on, beside those of the ones before."""
        self._past, self._framer, self._asked = self._losses(), framer, False

    def frame(self, frame: Frame) -> None:
        """Count one frame."""
        self.frames[frame.kind] += 1
        if frame.kind == "command":
            self.unanswered += self._asked
            self._asked = True
        elif frame.kind == "state":
            self._asked = False
            self.frame_at(frame.stamp_ns)

    def states(self, states: States) -> None:
        """Count the saturated readings of n states."""
        self.saturated_forces += self._saturated_count(states.force_counts)
        self.saturated_taxels += self._saturated_count(states.taxel_counts)

    def note_lost(self, stamp_ns: int) -> None:
        """Note that the port was lost."""
        self.unplugs.append({"lost_ns": stamp_ns + self._offset_ns, "back_ns": None})

    def note_back(self, stamp_ns: int) -> None:
        """Note that the port came back."""
        self.unplugs[-1]["back_ns"] = stamp_ns + self._offset_ns

    def losses(self) -> dict[str, int]:
        """Return what was lost on the wire, by kind."""
        return {**self._losses(), "requests_without_reply": self.unanswered}

    def bursts_note(self, port: str) -> str:
        """Return, once, that an adapter hands bytes over in bursts; else nothing."""
        if self._bursts_told or not self.in_bursts:
            return ""
        self._bursts_told = True
        return f"bytes {bursts.WORDS}; do: {bursts.remedy(port)}"

    def facts(self, port: str) -> dict[str, Any]:
        """Return what was counted, as plain data for the report."""
        return {
            "rows": self.frames["state"],
            "commands": self.frames["command"],
            "other_frames": self.frames["other"],
            "duration_s": round(self.duration_s, 6),
            "rate_hz": round(self.rate_hz, 3),
            "gaps": self.gaps,
            "longest_gap_s": round(self.longest_gap_s, 6),
            "bursts": bursts.remedy(port) if self.in_bursts else None,
            "losses": self.losses(),
            "saturated": self.saturated(),
            "unplugs": self.unplugs,
        }

    def statistics(self, now_ns: int) -> dict[str, Any]:
        """Return what the statistics channel says each second; times in it are unix nanoseconds but for `clock`."""
        return {
            "rate_hz": self.recent_rate_hz(now_ns),
            "frames": dict(self.frames),
            "bytes": self.bytes,
            "gaps": self.gaps,
            "longest_gap_s": self.longest_gap_s,
            "losses": self.losses(),
            "saturated": self.saturated(),
            "unplugs": [dict(unplug) for unplug in self.unplugs],
            "clock": {"monotonic_ns": time.monotonic_ns(), "wall_ns": time.time_ns()},
        }

    def saturated(self) -> dict[str, int]:
        """Return the number of readings with an axis at an end of its range."""
        return {"forces": self.saturated_forces, "taxels": self.saturated_taxels}

    def _losses(self) -> dict[str, int]:
        counts = self._framer.counts if self._framer else {}
        return {kind: self._past[kind] + int(counts.get(kind, 0)) for kind in _LOSSES}

    def _saturated_count(self, counts: NDArray[np.int16]) -> int:
        at_end = (counts <= self._low) | (counts >= self._high)
        return int(np.count_nonzero(at_end.any(axis=-1)))


def join_states(parts: Sequence[States]) -> States:
    """Return several batches of states as one."""
    return States(*(np.concatenate([getattr(part, name) for part in parts]) for name in States.__dataclass_fields__))
