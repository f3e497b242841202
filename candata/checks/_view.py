"""Stored episodes as rules look at them: values in float64, NaN for what is missing, whatever lies on the disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from candata.checks._evidence import Evidence, Finding, Level
from candata.datasets import RawEpisode
from candata.errors import UsageError
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import EpisodeMeta

if TYPE_CHECKING:
    from candata.scenes import Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Time ranges that a finding lists; what comes later is in the last one.
RANGES = 20


def valid_rows(episode: RawEpisode, channel: str) -> Mask:
    """Return `(T,) bool`: the rows that count; all where the flags are missing or of another length."""
    rows = len(episode.arrays[channel])
    flags = episode.arrays.get(channel + VALID_SUFFIX)
    if flags is None or flags.shape != (rows,):
        return np.ones(rows, bool)
    return flags.astype(bool)


@dataclass(frozen=True, eq=False)
class EpisodeView:
    """A stored episode as rules look at it.

    Attributes
    ----------
    raw : RawEpisode
        As it lies on the disk, unchecked.
    scene : Scene, optional
        The world it was recorded in, as far as the user gave one.
    deep : bool
        Whether slow checks were asked for.
    """

    raw: RawEpisode
    scene: Scene | None = None
    deep: bool = False

    @property
    def id(self) -> str:
        """Episode id."""
        return self.raw.id

    @cached_property
    def meta(self) -> EpisodeMeta | None:
        """Record of the episode; None where it cannot be read."""
        try:
            return self.raw.meta()
        except (UsageError, ValueError):
            return None

    @cached_property
    def stamps(self) -> NDArray[np.int64] | None:
        """`(T,) int64 [ns]`; None where they are missing, fewer than two or no whole numbers."""
        stamps = self.raw.arrays.get("time_ns")
        if stamps is None or stamps.ndim != 1 or stamps.dtype.kind != "i" or len(stamps) < 2:
            return None
        return stamps.astype(np.int64)

    @cached_property
    def time_s(self) -> Array | None:
        """`(T,) float64 [s]` from the first row; None where time does not increase."""
        if self.stamps is None or (np.diff(self.stamps) <= 0).any():
            return None
        return (self.stamps - self.stamps[0]) * 1e-9

    @cached_property
    def rate_hz(self) -> float:
        """Rows a second by the median step; 0 where time does not increase."""
        return 0.0 if self.time_s is None else float(1 / np.median(np.diff(self.time_s)))

    def values(self, channel: str) -> Array | None:
        """Return `(T, ...) float64`, NaN where a value is invalid or not finite.

        None where the channel is missing, has no rows or not the schema's shape, or where time does not increase.
        """
        array = self.raw.arrays.get(channel)
        if array is None or self.time_s is None or array.dtype.kind not in "fiub":
            return None
        shape = CHANNELS[channel].shape
        wrong_sizes = [n for n, d in zip(array.shape[1:], shape[1:], strict=False) if isinstance(d, int) and d != n]
        if len(array) != len(self.time_s) or array.ndim != len(shape) or wrong_sizes or 0 in array.shape:
            return None
        out = array.astype(np.float64)
        out[~np.isfinite(out) | (np.abs(out) > 1e30)] = np.nan
        out[~valid_rows(self.raw, channel)] = np.nan
        return out

    def complete_values(self, channel: str) -> Array | None:
        """Return `values`, with NaN in every element of a row that lacks one; None as there, or without any row."""
        values = self.values(channel)
        if values is None:
            return None
        columns = values.reshape(len(values), -1)
        values[~np.isfinite(columns).all(axis=1)] = np.nan
        return values if np.isfinite(values).any() else None

    def elements(self, channel: str) -> tuple[str, ...]:
        """Return the names of a channel's elements; their numbers where the record has none."""
        symbol = CHANNELS[channel].shape[1] if len(CHANNELS[channel].shape) > 1 else ""
        count = self.raw.arrays[channel].shape[1] if symbol else 0
        names_by_symbol: Mapping[str | int, tuple[str, ...]] = (
            {}
            if self.meta is None
            else {
                "J": self.meta.joint_names,
                "A": self.meta.actuator_names,
                "F": self.meta.fingertip_names,
            }
        )
        names = names_by_symbol.get(symbol, ())
        return names if len(names) == count else tuple(str(k) for k in range(count))

    def ranges(self, rows: Mask) -> tuple[tuple[float, float], ...]:
        """Return from when to when rows are true [s]; runs less than two rows apart are one."""
        if self.time_s is None or len(rows) != len(self.time_s) or not rows.any():
            return ()
        at = np.flatnonzero(rows)
        breaks = np.flatnonzero(np.diff(at) > 2)
        starts, ends = at[np.r_[0, breaks + 1]], at[np.r_[breaks, len(at) - 1]]
        if len(starts) > RANGES:
            starts, ends = starts[:RANGES], np.r_[ends[: RANGES - 1], ends[-1]]
        return tuple(
            (round(float(self.time_s[a]), 6), round(float(self.time_s[b]), 6))
            for a, b in zip(starts, ends, strict=True)
        )

    def finding(
        self,
        level: Level,
        rule: str,
        problem: str,
        detail: str = "",
        channel: str | None = None,
        at: Mask | None = None,
        remedy: str = "",
        **evidence: Evidence,
    ) -> Finding:
        """Return a finding in this episode.

        Parameters
        ----------
        level, rule, problem, channel, remedy
            As in `Finding`.
        detail : str
            Numbers; the message is `problem: detail`.
        at : (T,) bool, optional
            Rows that show it; the whole episode when omitted.
        **evidence : number or str
            What was measured.
        """
        first_row = None if at is None or not at.any() else int(np.argmax(at))
        return Finding(
            level,
            rule,
            f"{problem}: {detail}" if detail else problem,
            episode=self.id,
            channel=channel,
            index=first_row,
            problem=problem,
            ranges=() if at is None else self.ranges(at),
            evidence=round_evidence(evidence),
            remedy=remedy,
        )


def round_evidence(evidence: Mapping[str, Evidence]) -> dict[str, Evidence]:
    """Return plain numbers with six digits, and text as it is; a number that is not finite as its name."""
    out: dict[str, Evidence] = {}
    for name, value in evidence.items():
        if isinstance(value, str):
            out[name] = value
        elif isinstance(value, int | np.integer):
            out[name] = int(value)
        else:
            number = float(value)
            out[name] = float(f"{number:.6g}") if np.isfinite(number) else str(number)
    return out
