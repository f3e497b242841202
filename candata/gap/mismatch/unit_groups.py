"""Forces of some episodes in another unit than those of the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.sensors import TOUCH_N, free_spread, tare
from candata.gap.mismatch.swaps import AT_LEAST, in_episodes
from candata.units import TO_SI

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Units that forces are recorded in by mistake.
UNITS = ("mN", "gf", "kgf")
#: Rows of touch that let an episode tell its factor. Chosen.
TELLING_ROWS = 8
#: A reading is a touch at this many times the spread of a free fingertip's.
ABOVE_NOISE = 5.0
#: How far the ratio of two groups of episodes may lie from a unit's factor where the noise of free fingertips has it
#: too, and where no noise tells. Chosen: worlds of one gain, motions of several kinds.
WITH_NOISE, ALONE = 2.0, 1.15
#: How far the ratio of their noise may lie from it.
NOISE = 1.5
#: Ratio that no slip and no weak motor makes between episodes: forces that differ by more are in two units. Chosen:
#: five times the largest `tactile_gain`.
RATIO = 30.0


@dataclass(frozen=True)
class _Groups:
    """Two groups of episodes by how their forces compare with the scene's.

    Attributes
    ----------
    high : (E,) bool
        Those of the larger factors; the others that tell are low.
    low : (E,) bool
    times : float
        Ratio of the medians of both.
    tight : bool
        Whether either group has one factor, but for `ALONE`.
    """

    high: Mask
    low: Mask
    times: float
    tight: bool


def mixed_findings(recs: Recordings, force: Array) -> list[RecordingMismatch]:
    """Return that some episodes read their forces in another unit than the others, told by the scene's own forces.

    Parameters
    ----------
    force : (E, T, F, 3) float64
        Forces of a nominal replay [N].
    """
    real = recs.readings["fingertip_force"]
    groups = _groups(_factors(real, force))
    if groups is None:
        return []
    unit = min(UNITS, key=lambda u: abs(np.log(groups.times / _factor(u))))
    off = max(groups.times / _factor(unit), _factor(unit) / groups.times)
    high, low = (free_spread(real[g], force[g]) for g in (groups.high, groups.low))
    loud = high / low if high > 0 and low > 0 else None
    told = loud is not None and 1 / NOISE < loud / groups.times < NOISE
    near = off < WITH_NOISE if told else loud is None and off < (WITH_NOISE if groups.times > RATIO else ALONE)
    if not near or not (told or groups.times > RATIO or groups.tight):
        return []
    some = groups.low if TO_SI[unit] > 1 else groups.high
    return [
        RecordingMismatch(
            "force_unit",
            True,
            "fingertip_force of some episodes is not in newton",
            "one unit in all episodes, N",
            f"forces {'below' if TO_SI[unit] > 1 else 'above'} those of the others by {groups.times:.3g} "
            f"({unit}: {_factor(unit):.4g}), beside the scene's, {in_episodes(recs, some)}",
            f"give their unit in the map of these episodes: `units: {{fingertip_force: {unit}}}`",
            "fingertip_force",
        )
    ]


def _factor(unit: str) -> float:
    """Return by how much numbers in a unit and in newtons differ, above 1."""
    return max(TO_SI[unit], 1 / TO_SI[unit])


def _factors(real: Array, force: Array) -> Array:
    """Return `(E,)` the usual ratio of recorded to simulated forces where both touch; NaN where few rows do."""
    size, own = np.linalg.norm(real - tare(real, force), axis=-1), np.linalg.norm(force, axis=-1)
    out = np.full(len(real), np.nan)
    for e in range(len(real)):
        both = (own[e] > TOUCH_N) & (np.nan_to_num(size[e]) > ABOVE_NOISE * free_spread(real[[e]], force[[e]]))
        if both.sum() >= TELLING_ROWS:
            out[e] = np.median(size[e][both] / own[e][both])
    return out


def _groups(factors: Array) -> _Groups | None:
    """Return the episodes on either side of the widest gap between their factors; None where one side has too few."""
    telling = np.flatnonzero(np.isfinite(factors) & (factors > 0))
    if len(telling) < 2 * AT_LEAST:
        return None
    order = telling[np.argsort(factors[telling])]
    logs = np.log(factors[order])
    cut = int(np.diff(logs).argmax()) + 1
    if min(cut, len(order) - cut) < AT_LEAST:
        return None
    low, high = np.zeros(len(factors), bool), np.zeros(len(factors), bool)
    low[order[:cut]], high[order[cut:]] = True, True
    tight = max(np.ptp(logs[:cut]), np.ptp(logs[cut:])) < 2 * np.log(ALONE)
    return _Groups(high, low, float(np.exp(np.median(logs[cut:]) - np.median(logs[:cut]))), bool(tight))
