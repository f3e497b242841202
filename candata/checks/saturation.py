"""Rule: forces do not stand at one largest value, as a sensor at its limit does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._forces import FingertipForces, forces
from candata.checks._view import EpisodeView

Array = NDArray[np.float64]
#: Fewest equal rows that make a plateau.
ROWS = 3
#: Probability that as many rows equal their neighbours by chance, below which they do not.
CHANCE = 1e-6
#: By how many grains (smallest steps of the readings) the force would have gone on rising over the plateau. The top of
#: a smooth hump rounded to grains stands still too: there it is four, whatever the hump (its parabola falls by one
#: grain half a plateau away, so its slope there times the plateau's length is four grains).
OVERSHOOT = 12.0
#: Rows before and after a plateau over which the slope is read.
SLOPE_ROWS = 4
#: Relative rounding of float32 components that a constant norm keeps.
RELATIVE_ROUNDING = 1e-6
#: Full scale [N] below which a plateau is doubtful: no fingertip sensor ends there (BioTac SP manual: 50 N; ATI Nano17
#: data sheet: 17 N and more), while a constant bias of a sensor without noise stands as still.
SMALLEST_N = 1.0
REMEDY = "the sensor's full scale was reached: use a larger range, or mark these rows invalid"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield fingertips whose force stands at its largest value."""
    force = forces(view)
    if force is None:
        return
    equal_share = _equal_share(force)
    for tip, name in enumerate(force.names):
        xyz = np.nan_to_num(force.xyz[:, tip])
        plateau_rows, limit = np.zeros(len(xyz), bool), 0.0
        for series in (*xyz.T, *(-xyz.T), np.sqrt((xyz**2).sum(axis=1))):
            rows = _plateaus(series, force.threshold_n, equal_share)
            if rows.sum() > plateau_rows.sum():
                plateau_rows, limit = rows, float(series.max())
        if plateau_rows.any():
            text = f"{name} stands at {limit:.4g} N in {plateau_rows.sum()} rows"
            level: Level = "error" if limit > SMALLEST_N else "warning"
            yield view.finding(
                level,
                "saturation",
                "a force saturates",
                text,
                "fingertip_force",
                plateau_rows,
                REMEDY,
                fingertip=name,
                limit_N=limit,
                rows=int(plateau_rows.sum()),
                equal_neighbours_share=equal_share,
            )


def _equal_share(force: FingertipForces) -> float:
    """Return how often a reading in contact equals the next, away from each series' ends: how rare plateaus are."""
    readings, next_readings = force.xyz[:-1], force.xyz[1:]
    is_touching = (force.touch[:-1] & force.touch[1:])[..., None]
    high, low = np.nanmax(force.xyz, axis=0), np.nanmin(force.xyz, axis=0)
    is_counted = is_touching & (readings < high) & (readings > low) & np.isfinite(next_readings)
    return float(((readings == next_readings) & is_counted).sum() + 1) / float(is_counted.sum() + 2)


def _plateaus(series: Array, threshold_n: float, equal_share: float) -> NDArray[np.bool_]:
    """Return `(T,) bool`: rows at the largest value, where they are too many for chance and the force would go on."""
    rows, top = np.zeros(len(series), bool), float(series.max())
    if top <= threshold_n:
        return rows
    at = series >= top * (1 - RELATIVE_ROUNDING)
    edges = np.flatnonzero(np.diff(np.r_[False, at, False].astype(np.int8))).reshape(-1, 2)
    steps = np.diff(np.unique(series))
    grain = max(
        float(np.quantile(steps[steps > RELATIVE_ROUNDING * top], 0.1))
        if (steps > RELATIVE_ROUNDING * top).any()
        else 0.0,
        RELATIVE_ROUNDING * top,
    )
    repeats = 0
    for start, end in edges:
        if end - start >= ROWS and _goes_on(series, start, end) * (end - start) > OVERSHOOT * grain:
            rows[start:end] = True
            repeats += end - start - 1
    return rows if repeats * np.log(equal_share) < np.log(CHANCE) else np.zeros(len(series), bool)


def _goes_on(series: Array, start: int, end: int) -> float:
    """Return how fast the force rises before a plateau or falls after it, the faster [N a row]."""
    readings_before, readings_after = series[max(0, start - SLOPE_ROWS) : start + 1], series[end - 1 : end + SLOPE_ROWS]
    slopes = [
        (side[-1] - side[0]) / (len(side) - 1) * sign
        for side, sign in ((readings_before, 1), (readings_after, -1))
        if len(side) > 1
    ]
    return max(slopes, default=0.0)


RULE = Rule(meaning="forces do not stand at a limit", episode=_episode, needs=("fingertip_force",))
