"""Readings of a sensor slower than the log: between two of its own, the last one is repeated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
#: Fewest changes from which a channel is judged, the share of them that must come at the usual interval, give or take a
#: row, and the share that may come at once. Chosen: what rests or is rounded changes at random, what is held by clock.
FEWEST, REGULAR, AT_ONCE = 20, 0.8, 0.05


def sources(readings: dict[str, Array], rate_hz: float) -> tuple[dict[str, Rows], tuple[str, ...]]:
    """Return, for each channel that is held, the row `(E, T)` in which each reading was new, and a note on each.

    Parameters
    ----------
    readings : dict of str to ndarray
        Channels `(E, T, ...)`; NaN where not valid.
    rate_hz : float
        Rows a second.
    """
    found, notes = {}, []
    for channel, values in readings.items():
        new = _changes(values.reshape(*values.shape[:2], -1))
        gaps = np.concatenate([np.diff(np.flatnonzero(one)) for one in new])
        if not _is_held(gaps):
            continue
        rows = np.broadcast_to(np.arange(new.shape[1]), new.shape)
        found[channel] = np.maximum.accumulate(np.where(new, rows, 0), axis=1)
        mean = float(gaps.mean())
        notes.append(f"{channel} is new only every {mean:.1f} rows ({1e3 * mean / rate_hz:.0f} ms), and compared then")
    return found, tuple(notes)


def _changes(values: Array) -> NDArray[np.bool_]:
    """Return `(E, T)` where any column of values `(E, T, D)` is another than in the row before; missing is no other."""
    seen = np.isfinite(values[:, 1:]) & np.isfinite(values[:, :-1])
    new = (seen & (values[:, 1:] != values[:, :-1])).any(2)
    return np.concatenate([np.zeros((len(values), 1), bool), new], axis=1)


def _is_held(gaps: Rows) -> bool:
    """Tell whether rows between changes are as many every time, and more than one."""
    if len(gaps) < FEWEST:
        return False
    usual = np.median(gaps)
    regular = float((np.abs(gaps - usual) <= 1).mean())
    return bool(usual >= 2 and regular >= REGULAR and (gaps == 1).mean() <= AT_ONCE)


def held_readings(values: Array, rows: Rows | None) -> Array:
    """Return values `(E, T, ...)` as a sensor holds them that is new only in `rows (E, T)`; as they are for None."""
    if rows is None:
        return values
    return values[np.arange(len(values))[:, None], rows]


def only_new(values: Array, rows: Rows | None) -> Array:
    """Return the rows `(E, N, ...)` of values in which they are new: as many of each episode as the shortest has."""
    if rows is None:
        return values
    new = rows == np.arange(rows.shape[1])
    count = int(new.sum(1).min())
    index = np.argsort(~new, axis=1, kind="stable")[:, :count]
    return values[np.arange(len(values))[:, None], index]
