"""Rule: forces do not stand at one largest value, the same again and again, as a sensor at its limit does."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

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
#: A full scale is one value: so many arrivals at it, of any fingertip in any episode, and this share of a fingertip's
#: own. A force limit that a controller holds ends a little elsewhere each time. Chosen.
ARRIVALS, LIMIT_SHARE = 2, 0.5
REMEDY = "the sensor's full scale was reached: use a larger range, or mark these rows invalid"


@dataclass(frozen=True)
class _Plateau:
    """A fingertip's largest force of an episode, at which it stands: how often it comes there, and what to say."""

    fingertip: str
    limit_n: float
    arrivals: int
    finding: Finding


def _gather(view: EpisodeView) -> tuple[_Plateau, ...] | None:
    """Return the plateaus of an episode, one a fingertip; None where there are none."""
    force = forces(view)
    if force is None:
        return None
    equal_share = _equal_share(force)
    plateaus = []
    for tip, name in enumerate(force.names):
        xyz = np.nan_to_num(force.xyz[:, tip])
        runs: list[tuple[int, int]] = []
        series, rows = xyz[:, 0], 0
        for candidate in (*xyz.T, *(-xyz.T), np.sqrt((xyz**2).sum(axis=1))):
            candidate_runs = _plateaus(candidate, force.threshold_n, equal_share)
            if (count := sum(end - start for start, end in candidate_runs)) > rows:
                runs, series, rows = candidate_runs, candidate, count
        if runs:
            plateaus.append(_plateau(view, name, series, runs, equal_share))
    return tuple(plateaus) or None


def _plateau(
    view: EpisodeView, name: str, series: Array, runs: Sequence[tuple[int, int]], equal_share: float
) -> _Plateau:
    """Return a fingertip's plateau with the finding that it is a sensor's limit."""
    limit, rows = float(series.max()), np.zeros(len(series), bool)
    for start, end in runs:
        rows[start:end] = True
    level: Level = "error" if limit > SMALLEST_N else "warning"
    finding = view.finding(
        level,
        "saturation",
        "a force saturates",
        f"{name} stands at {limit:.4g} N in {rows.sum()} rows",
        "fingertip_force",
        rows,
        REMEDY,
        fingertip=name,
        limit_N=limit,
        rows=int(rows.sum()),
        equal_neighbours_share=equal_share,
    )
    return _Plateau(name, limit, _arrivals(series, runs), finding)


def _judge(episodes: Sequence[tuple[_Plateau, ...]]) -> Iterator[Finding]:
    """Yield the plateaus at a value that forces come to again and again."""
    plateaus = [plateau for episode in episodes for plateau in episode]
    limits = np.sort([plateau.limit_n for plateau in plateaus])
    starts = limits[np.r_[True, np.diff(limits) > RELATIVE_ROUNDING * limits[1:]]]
    kind_of = [int(np.searchsorted(starts, plateau.limit_n, side="right")) for plateau in plateaus]
    by_limit: dict[int, int] = defaultdict(int)
    by_tip: dict[str, int] = defaultdict(int)
    by_both: dict[tuple[str, int], int] = defaultdict(int)
    for plateau, kind in zip(plateaus, kind_of, strict=True):
        by_limit[kind] += plateau.arrivals
        by_tip[plateau.fingertip] += plateau.arrivals
        by_both[plateau.fingertip, kind] += plateau.arrivals
    for plateau, kind in zip(plateaus, kind_of, strict=True):
        tip = plateau.fingertip
        if by_limit[kind] >= ARRIVALS and by_both[tip, kind] >= LIMIT_SHARE * by_tip[tip]:
            yield plateau.finding


def _equal_share(force: FingertipForces) -> float:
    """Return how often a reading in contact equals the next, away from each series' ends: how rare plateaus are."""
    readings, next_readings = force.xyz[:-1], force.xyz[1:]
    is_touching = (force.touch[:-1] & force.touch[1:])[..., None]
    high, low = np.nanmax(force.xyz, axis=0), np.nanmin(force.xyz, axis=0)
    is_counted = is_touching & (readings < high) & (readings > low) & np.isfinite(next_readings)
    return float(((readings == next_readings) & is_counted).sum() + 1) / float(is_counted.sum() + 2)


def _plateaus(series: Array, threshold_n: float, equal_share: float) -> list[tuple[int, int]]:
    """Return the first row and the row after the last of each run at the largest value at which the force would go on.

    None where the rows are too few to rule out chance.
    """
    top = float(series.max())
    if top <= threshold_n:
        return []
    at = series >= top * (1 - RELATIVE_ROUNDING)
    edges = np.flatnonzero(np.diff(np.r_[False, at, False].astype(np.int8))).reshape(-1, 2).tolist()
    grain = _grain(series, top)
    runs = [
        (start, end)
        for start, end in edges
        if end - start >= ROWS and _goes_on(series, start, end) * (end - start) > OVERSHOOT * grain
    ]
    repeats = sum(end - start - 1 for start, end in runs)
    return runs if repeats * np.log(equal_share) < np.log(CHANCE) else []


def _arrivals(series: Array, runs: Sequence[tuple[int, int]]) -> int:
    """Return how often a force comes to its plateau: from clearly below, not from a flicker of some grains."""
    top = float(series.max())
    below = top - OVERSHOOT * _grain(series, top)
    return 1 + sum(bool(series[end:start].min() < below) for (_, end), (start, _) in pairwise(runs))


def _grain(series: Array, top: float) -> float:
    """Return the smallest step of the readings, but for rounding [N]."""
    steps = np.diff(np.unique(series))
    steps = steps[steps > RELATIVE_ROUNDING * top]
    return max(float(np.quantile(steps, 0.1)) if len(steps) else 0.0, RELATIVE_ROUNDING * top)


def _goes_on(series: Array, start: int, end: int) -> float:
    """Return how fast the force rises before a plateau or falls after it, the faster [N a row]."""
    readings_before, readings_after = series[max(0, start - SLOPE_ROWS) : start + 1], series[end - 1 : end + SLOPE_ROWS]
    slopes = [
        (side[-1] - side[0]) / (len(side) - 1) * sign
        for side, sign in ((readings_before, 1), (readings_after, -1))
        if len(side) > 1
    ]
    return max(slopes, default=0.0)


RULE = Rule(meaning="forces do not stand at a limit", gather=_gather, judge=_judge, needs=("fingertip_force",))
