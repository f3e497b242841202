"""Rule: time increases strictly, at about the rate that the episode states, without rows that are missing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.align import GAP_STEPS, time_factor
from candata.checks._finding import Finding, Level, Rule
from candata.checks._view import EpisodeView

#: Said where rows come together and then not for a while: gaps between them are no gaps of the recording.
BURSTS = "rows come in bursts"
#: Beyond this factor between median and nominal step, the unit or the rate is wrong, not the clock: twice and half, as
#: jitter leaves them. Chosen.
WRONG_FACTOR = 1.75
#: Beyond this relative difference the stated rate misleads whoever resamples by it.
DOUBTFUL_SHARE = 0.1
#: A step this many times the median lacks a row, where the steps around it do not make up for it.
LACKING_STEPS = 1.6
#: Share of lacking rows that is worth more than a remark.
LACKING_SHARE = 0.01


def _time(view: EpisodeView) -> Iterator[Finding]:
    """Yield a clock that runs back, a rate that the record does not state, gaps and lacking rows."""
    if view.stamps is None:
        return
    steps = np.diff(view.stamps)
    is_backward = np.r_[False, steps <= 0]
    if is_backward.any():
        text = f"step {steps[np.argmax(is_backward) - 1]} ns ({is_backward.sum()} rows)"
        yield view.finding(
            "error",
            "time",
            "time does not increase",
            text,
            "time_ns",
            is_backward,
            "sort the rows by time and drop repeated stamps",
            backward_rows=int(is_backward.sum()),
        )
        return
    median = float(np.median(steps))
    rate_findings = list(_rate(view, median))
    yield from rate_findings
    if not any(finding.problem == BURSTS for finding in rate_findings):
        yield from _gaps(view, steps, median)


def _rate(view: EpisodeView, median: float) -> Iterator[Finding]:
    """Yield a median step far from the nominal one."""
    if view.stamps is None or view.meta is None or not view.meta.rate_hz > 0:
        return  # the rule on the schema tells
    rate_hz = view.meta.rate_hz
    ratio = median * 1e-9 * rate_hz
    if 1 - DOUBTFUL_SHARE <= ratio <= 1 + DOUBTFUL_SHARE:
        return
    mean = float(view.stamps[-1] - view.stamps[0]) / (len(view.stamps) - 1) * 1e-9 * rate_hz
    if 1 / WRONG_FACTOR <= mean <= WRONG_FACTOR and not 1 / WRONG_FACTOR <= ratio <= WRONG_FACTOR:
        text = f"most steps are {median * 1e-9:.3g} s, their mean {mean / rate_hz:.3g} s, stated {1 / rate_hz:.3g} s"
        yield view.finding(
            "warning",
            "time",
            BURSTS,
            text,
            "time_ns",
            remedy="take the stamps of the source, not those of arrival; resample",
            mean_hz=rate_hz / mean,
            median_hz=1e9 / median,
            stated_hz=rate_hz,
        )
        return
    level: Level = "warning" if 1 / WRONG_FACTOR <= ratio <= WRONG_FACTOR else "error"
    text = f"median rate {1e9 / median:.4g} Hz, expected rate_hz = {rate_hz:.4g}"
    yield view.finding(
        level,
        "time",
        "the rate is another than the stated one",
        text + time_factor(ratio),
        "time_ns",
        remedy="correct rate_hz, or the unit of the time column",
        rate_hz=1e9 / median,
        stated_hz=rate_hz,
    )


def _gaps(view: EpisodeView, steps: NDArray[np.int64], median: float) -> Iterator[Finding]:
    """Yield steps that are gaps, and single rows that lack."""
    is_gap = steps > GAP_STEPS * median
    if is_gap.any():
        text = f"gap of {steps[np.argmax(is_gap)] * 1e-9:.3g} s ({is_gap.sum()} gaps over {GAP_STEPS:g} steps)"
        yield view.finding(
            "warning",
            "time",
            "time jumps ahead",
            text,
            "time_ns",
            np.r_[False, is_gap],
            "cut the episode there: nothing is known of the time between",
            gaps=int(is_gap.sum()),
            longest_s=float(steps.max() * 1e-9),
        )
    is_lacking = _lacking_steps(steps, median) & ~is_gap
    if is_lacking.any():
        missing_rows = int(np.round(steps[is_lacking] / median - 1).sum())
        share = missing_rows / (len(steps) + 1)
        level: Level = "warning" if share > LACKING_SHARE and missing_rows > 2 else "info"
        yield view.finding(
            level,
            "time",
            "rows are lacking",
            f"{missing_rows} rows, by the steps of time ({share:.1%})",
            "time_ns",
            np.r_[False, is_lacking],
            "look for what the recorder dropped; windows go over these places",
            lacking_rows=missing_rows,
            share=share,
        )


def _lacking_steps(steps: NDArray[np.int64], median: float) -> NDArray[np.bool_]:
    """Return `(T - 1,) bool`: long steps that are no jitter, which the steps beside them would make up for."""
    padded_steps = np.r_[median, steps, median]
    excess = padded_steps[:-2] + padded_steps[1:-1] + padded_steps[2:] - 3 * median
    return np.asarray((steps > LACKING_STEPS * median) & (excess > (LACKING_STEPS - 1) * median))


RULE = Rule(meaning="time increases, at the stated rate, and no rows are lacking", episode=_time)
