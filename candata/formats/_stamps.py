"""The one rule for stamps of foreign formats: there in every row, in a unit that fits the rate, within int64 ns.

Unix time is taken as it is: the first stamp of an episode may be any.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from candata import align
from candata.errors import DataError, Where

#: A median step further than this factor from 1 / rate_hz is taken for a mistaken unit of time. Chosen: stamps are
#: a thousandfold off by a unit, and recordings thinned to a hundredth of their rate stay below.
RATE_FACTOR = 300.0
#: Beyond it a time in ns is no int64.
LATEST_NS = float(2**63)
_UNITS = dict(zip(align.TIME_UNITS, ("ms", "us", "ns"), strict=True))


def times_ns(stamps: NDArray, rate_hz: float, location: Where, say_unit: Callable[[str], str]) -> NDArray[np.int64]:
    """Return the times of an episode.

    Parameters
    ----------
    stamps : (T,) ndarray [s]
        As the file has them.
    rate_hz : float
        Nominal rate.
    location : Where
        File and episode, for messages.
    say_unit : callable
        What a user writes to say that the stamps are in a unit: "`units: {t: ms}`".

    Returns
    -------
    (T,) int64 [ns]

    Raises
    ------
    DataError
        When one is missing, they are too coarse, their unit must be another, or they lie further away than ns can
        say; names the row.
    """
    seconds = stamps.astype(np.float64)
    missing_rows = np.flatnonzero(~np.isfinite(seconds))
    if len(missing_rows):
        raise DataError(
            "time is missing",
            expected="a number in every row",
            found=f"{stamps[missing_rows[0]]} ({len(missing_rows)} such rows)",
            where=dataclasses.replace(location, index=int(missing_rows[0])),
            fix="drop the rows that have no time",
        )
    require_resolution(stamps, rate_hz, location)
    require_rate(stamps, rate_hz, location, say_unit)
    far_rows = np.flatnonzero(np.abs(seconds) >= LATEST_NS * 1e-9)
    if len(far_rows):
        raise DataError(
            "time lies further away than ns can say",
            expected="within 292 years of zero",
            found=f"{stamps[far_rows[0]]} s",
            where=dataclasses.replace(location, index=int(far_rows[0])),
            fix=f"give the unit of the stamps, such as {say_unit(likely_unit(stamps, rate_hz))}",
        )
    return np.rint(seconds * 1e9).astype(np.int64)


def unit_of(ratio: float) -> str | None:
    """Return the unit that stamps are in if they were taken for seconds and their steps are `ratio` times too long."""
    return next((name for times, name in _UNITS.items() if abs(ratio / times - 1) < align.NEAR_FACTOR), None)


def likely_unit(stamps: NDArray, rate_hz: float) -> str:
    """Return the unit of stamps `(T,)` that lie too far away to be seconds: the one whose steps fit the rate, or ns."""
    steps = np.abs(np.diff(stamps.astype(np.float64)))
    return (unit_of(float(np.median(steps)) * rate_hz) if len(steps) else None) or "ns"


def require_resolution(stamps: NDArray, rate_hz: float, location: Where) -> None:
    """Raise when stamps `(T,)` [s] are float32 and so far from zero that it cannot tell two rows apart.

    Raises
    ------
    DataError
        Says how far apart the times are that it tells.
    """
    if stamps.dtype != np.float32 or not len(stamps):
        return
    farthest = np.abs(stamps).max()
    coarse_s = float(np.spacing(farthest))
    if coarse_s * rate_hz > 1:
        raise DataError(
            "time is too coarse",
            expected=f"steps of {1 / rate_hz:g} s (rate_hz: {rate_hz:g})",
            found=f"float32, which tells times near {farthest:g} s {coarse_s:g} s apart",
            where=dataclasses.replace(location, channel="time_ns"),
            fix="write the stamps as float64, or from the start of each episode",
        )


def require_rate(
    stamps: NDArray, rate_hz: float, location: Where, say_unit: Callable[[str], str], factor: float = RATE_FACTOR
) -> None:
    """Raise when the median step of stamps `(T,)` [s] is further than `factor` from the rate: their unit is another.

    Raises
    ------
    DataError
        Names the unit that fits the rate, where one does.
    """
    if len(stamps) < 2:
        return
    step_s = float(np.median(np.diff(stamps.astype(np.float64))))
    ratio = step_s * rate_hz
    if 1 / factor < ratio < factor:
        return
    unit = unit_of(ratio)
    fix = f"give the unit of the stamps, such as {say_unit('ms')}, or correct rate_hz"
    if unit is not None:
        fix = f"the steps fit the rate if the stamps are in {unit}: say {say_unit(unit)}"
    raise DataError(
        "time does not fit the rate",
        expected=f"steps near {1 / rate_hz:g} s (rate_hz: {rate_hz:g})",
        found=f"steps of {step_s:g} s",
        where=dataclasses.replace(location, channel="time_ns"),
        fix=fix,
    )
