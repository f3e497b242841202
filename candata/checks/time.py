"""Rule: time increases strictly, at about the rate that the episode states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.datasets import RawEpisode
from candata.errors import UsageError

#: Beyond this factor between median and nominal step, the unit or the rate is wrong, not the clock.
WRONG_FACTOR = 2.0
#: Beyond this relative difference the stated rate misleads whoever resamples by it.
DOUBTFUL_SHARE = 0.1
#: A step this many times the median is a gap that should be marked invalid.
GAP_STEPS = 5.0


def _time(episode: RawEpisode) -> Iterator[Finding]:
    """Yield a clock that runs back, a rate that the record does not state, and gaps."""
    time_ns = episode.arrays.get("time_ns")
    if time_ns is None or time_ns.ndim != 1 or time_ns.dtype.kind != "i" or len(time_ns) < 2:
        return
    stamps = time_ns.astype(np.int64)
    steps = stamps[1:] - stamps[:-1]
    back = np.flatnonzero(steps <= 0)
    if len(back):
        text = f"time does not increase: step {steps[back[0]]} ns ({len(back)} rows)"
        yield Finding("error", "time", text, episode.id, "time_ns", int(back[0]) + 1)
        return
    yield from _rate(episode, steps)


def _rate(episode: RawEpisode, steps: NDArray[np.int64]) -> Iterator[Finding]:
    """Yield a median step far from the nominal one, and steps that are gaps."""
    try:
        rate_hz = episode.meta().rate_hz
    except (UsageError, ValueError):
        return  # the rule on the schema tells
    median = float(np.median(steps))
    ratio = median * 1e-9 * rate_hz
    if not 1 - DOUBTFUL_SHARE <= ratio <= 1 + DOUBTFUL_SHARE:
        level: Level = "warning" if 1 / WRONG_FACTOR <= ratio <= WRONG_FACTOR else "error"
        text = f"median rate {1e9 / median:.4g} Hz, expected rate_hz = {rate_hz:.4g}"
        yield Finding(level, "time", text, episode.id, "time_ns")
    gaps = np.flatnonzero(steps > GAP_STEPS * median)
    if len(gaps):
        text = f"gap of {steps[gaps[0]] * 1e-9:.3g} s ({len(gaps)} gaps over {GAP_STEPS:g} steps)"
        yield Finding("warning", "time", text, episode.id, "time_ns", int(gaps[0]) + 1)


RULE = Rule(meaning="time increases, at the stated rate", episode=_time)
