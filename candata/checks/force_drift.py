"""Rule: out of contact a force reads zero, and does not drift."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._forces import FingertipForces, flags, forces
from candata.checks._signal import SEGMENTS, moving_mean, quiet_noise, spread
from candata.checks._view import EpisodeView

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Rows that are looked at, evenly spread; a drift must run through the `SEGMENTS` of the episode.
LOOKED_AT = 400
#: Segments in which enough readings lie on one line, the share of readings that is enough, and the share over all.
COVERED_SEGMENTS, COVERED_SHARE, LINE_SHARE = 7, 0.2, 0.4
#: Readings out of contact that are needed, as any two lie on a line, and by how much nearer to it than to a constant
#: they lie. Chosen.
FREE_ROWS, FREE_RATIO = 3, 0.7
#: Rows over which a reading is averaged before it is laid on a line: of one out of contact noise is left, and less.
#: A force in contact that crosses the line stays off it as before. Chosen.
OVER_ROWS = 9
#: Smallest drift over the episode [N], also in tolerances of the line.
DRIFT_N, TOLERANCES = 0.25, 6.0
#: Narrowest tolerance of the line [N].
TOLERANCE_N = 0.01
#: Share of the episode that readings must span.
SPAN = 0.6
#: A constant reading out of contact that is told [N].
TARE_N = 0.3
REMEDY = "tare the sensor again; subtract the reading out of contact as a line of time"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield fingertips whose reading runs along one line of time from the first row to the last."""
    force = forces(view)
    if force is None or view.time_s is None or len(force.xyz) < 5 * SEGMENTS:
        return
    flag = flags(view, force.total.shape[1])
    free = ~force.touch if flag is None else flag == 0
    drift_by_tip: dict[str, float] = {}
    for tip, name in enumerate(force.names):
        drifts = [_drift(view.time_s, axis, free[:, tip]) for axis in force.xyz[:, tip].T]
        if flag is not None and not any(drifts):
            out_of_contact = np.where(free[:, tip, None], force.xyz[:, tip], np.nan)
            drifts = [_drift(view.time_s, axis, free[:, tip]) for axis in out_of_contact.T]
        largest_drift = max(drifts, key=abs)
        if largest_drift:
            drift_by_tip[name] = largest_drift
    if drift_by_tip:
        names = ", ".join(f"{name} {drift:+.2g} N" for name, drift in drift_by_tip.items())
        largest_drift = max(map(abs, drift_by_tip.values()))
        yield view.finding(
            "error" if largest_drift > 4 * DRIFT_N else "warning",
            "force_drift",
            "a force drifts",
            names,
            "fingertip_force",
            None,
            REMEDY,
            drift_N=largest_drift,
            fingertips=", ".join(drift_by_tip),
        )
    else:
        yield from _tare(view, force)


def _drift(time_s: Array, series: Array, free: Mask) -> float:
    """Return by how much a reading `(T,)` drifts along one line [N]; 0 where no line runs through the episode.

    What is pressed may rise and fall along a line by itself: the readings out of contact, `free (T,)`, must follow the
    line too, and no constant.
    """
    noise_level, series = _reading_noise(series[np.isfinite(series)]), _average(series)
    keep = np.flatnonzero(np.isfinite(series))
    keep = keep[np.unique(np.linspace(0, len(keep) - 1, min(LOOKED_AT, len(keep))).astype(int))] if len(keep) else keep
    t, x, free = time_s[keep], series[keep], free[keep]
    if free.sum() < FREE_ROWS or len(keep) < 5 * SEGMENTS or np.ptp(x) < DRIFT_N:
        return 0.0
    duration = time_s[-1] - time_s[0]
    if t[-1] - t[0] < SPAN * duration:
        return 0.0
    tolerance = max(TOLERANCE_N, 4 * noise_level / np.sqrt(OVER_ROWS))
    begin_rows, end_rows = (np.flatnonzero(m) for m in (t < t[0] + duration / 3, t > t[-1] - duration / 3))
    line_ends = [rows[np.linspace(0, len(rows) - 1, min(24, len(rows))).astype(int)] for rows in (begin_rows, end_rows)]
    i, j = (a.ravel() for a in np.meshgrid(*line_ends, indexing="ij"))
    slopes = (x[j] - x[i]) / (t[j] - t[i])
    steep = np.abs(slopes) * duration > max(DRIFT_N, TOLERANCES * tolerance)
    if not steep.any():
        return 0.0
    i, slopes = i[steep], slopes[steep]
    distance = np.abs(x - (x[i, None] + slopes[:, None] * (t - t[i, None])))
    is_near = distance < tolerance
    parts = np.array_split(is_near, SEGMENTS, axis=1)
    covered_segments = np.sum([part.mean(axis=1) > COVERED_SHARE for part in parts], axis=0)
    ends = (parts[0].mean(axis=1) > COVERED_SHARE) & (parts[-1].mean(axis=1) > COVERED_SHARE)
    from_line = np.minimum(distance[:, free], tolerance).mean(axis=1)
    from_constant = np.minimum(np.abs(x[free] - np.median(x[free])), tolerance).mean()
    is_drift = (
        (covered_segments >= COVERED_SEGMENTS)
        & ends
        & (from_line < FREE_RATIO * from_constant)
        & (is_near.mean(axis=1) > max(LINE_SHARE, 1.3 * _level(x, tolerance)))
    )
    return float(slopes[np.argmax(np.where(is_drift, is_near.mean(axis=1), 0))] * duration) if is_drift.any() else 0.0


def _average(series: Array) -> Array:
    """Return a reading averaged over `OVER_ROWS` rows, where it was seen."""
    return np.where(np.isfinite(series), moving_mean(series, OVER_ROWS), np.nan)


def _reading_noise(series: Array) -> float:
    """Return the noise of a reading where it is quietest [N]: contact chatters."""
    # Readings rounded to steps hide noise below half a step: one step is then the least that can be told.
    steps = np.diff(np.unique(series))
    grain = float(steps.min()) if 0 < len(steps) < len(series) / 3 else 0.0
    return max(quiet_noise(series), grain / 4)


def _level(x: Array, tolerance: float) -> float:
    """Return the largest share of readings that lie on one constant."""
    sorted_values = np.sort(x)
    ends = np.searchsorted(sorted_values, sorted_values + 2 * tolerance, side="right")
    return float((ends - np.arange(len(x))).max() / len(x))


def _tare(view: EpisodeView, force: FingertipForces) -> Iterator[Finding]:
    """Yield fingertips that read a constant force where their flag says no contact."""
    flag = flags(view, force.total.shape[1])
    if flag is None:
        return
    for tip, name in enumerate(force.names):
        free = force.xyz[(flag[:, tip] == 0) & force.has_value[:, tip], tip]
        size = float(np.linalg.norm(np.median(free, axis=0))) if len(free) >= 5 * SEGMENTS else 0.0
        if size > TARE_N and max(map(spread, free.T)) < 0.3 * size:
            yield view.finding(
                "info",
                "force_drift",
                "a force is not zero out of contact",
                f"{name} reads {size:.2g} N",
                "fingertip_force",
                None,
                "tare the sensor before recording",
                tare_N=size,
                fingertip=name,
            )


RULE = Rule(meaning="forces do not drift", episode=_episode, needs=("fingertip_force",))
