"""The rows that windows are made of: strides, present rows, padding; numbers only."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.loaders.cache import Cache

#: Which side of a window may reach beyond its episode.
Pad = Literal["history", "both", "none"]
PADS = ("history", "both", "none")

#: Largest relative distance of a ratio of rates from a whole number: rates are written with a few digits.
RATIO_TOLERANCE = 1e-6

Numbers = NDArray[np.int64]


def strides(cache: Cache, episodes: Numbers, rate_hz: float, stride: int | None) -> tuple[Numbers, float]:
    """Return `(E,) int64` native rows a model step, and the model's rate [Hz].

    Parameters
    ----------
    cache : Cache
        All episodes.
    episodes : (n,) int64
        Numbers of those that are used; the others get stride 1.
    rate_hz : float
        Rate of the model.
    stride : int, optional
        Native rows a step instead of a rate.

    Raises
    ------
    UsageError
        When a number is out of range, or a stride is given for episodes of several rates.
    DataError
        When an episode's rate is no whole multiple of the model's.
    """
    native = np.array(cache.file.rate_hz)
    rates = sorted(set(native[episodes].tolist()))
    result = np.ones(len(native), np.int64)
    if stride is not None:
        if stride < 1:
            raise UsageError("stride is too small", expected="at least 1", found=str(stride))
        if len(rates) > 1:
            raise UsageError("a stride needs one rate", found=_rates(rates), fix="give rate_hz instead of stride")
        result[episodes] = stride
        return result, rates[0] / stride
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise UsageError("rate_hz must be positive", found=str(rate_hz))
    ratio = native[episodes] / rate_hz
    native_rows = np.round(ratio)
    misfits = np.flatnonzero((native_rows < 1) | (np.abs(ratio - native_rows) > RATIO_TOLERANCE * ratio))
    if len(misfits):
        nearest_ratio = max(1, round(rates[0] / rate_hz))
        every = "every row" if nearest_ratio == 1 else f"every {nearest_ratio} rows, or resample when importing"
        stride_fix = f"take rate_hz = {rates[0] / nearest_ratio:.10g}, {every}"
        raise DataError(
            "the episodes' rate is no whole multiple of the model's",
            expected=f"a multiple of rate_hz = {rate_hz:g}",
            found=_rates(rates),
            where=Where(episode=cache.file.ids[episodes[misfits[0]]]),
            fix=stride_fix if len(rates) == 1 else "take a rate that divides all of them, or resample when importing",
        )
    result[episodes] = native_rows.astype(np.int64)
    return result, float(rate_hz)


def _rates(rates: list[float]) -> str:
    """Return the rates for people."""
    return ", ".join(f"{rate:g} Hz" for rate in rates)


def present_rows(
    cache: Cache, episodes: Numbers, stride: Numbers, history: int, horizon: int, step: int, pad: Pad
) -> tuple[Numbers, Numbers]:
    """Return rows of the cache that are the present of a window, `(n,) int64`, and their episodes, `(n,) int64`.

    Parameters
    ----------
    cache : Cache
        All episodes.
    episodes : (m,) int64
        Numbers of those that are used.
    stride : (E,) int64
        Native rows a model step, by episode.
    history, horizon : int
        Rows of the past (the present included) and steps of the future.
    step : int
        Every how many native rows a window begins.
    pad : str
        As for `windows`.

    Raises
    ------
    UsageError
        When a size is less than 1.
    UnknownNameError
        When `pad` is unknown.
    DataError
        When no episode holds a window.
    """
    for name, value in (("history", history), ("horizon", horizon), ("step", step)):
        if value < 1:
            raise UsageError(f"{name} is too small", expected="at least 1", found=str(value))
    if pad not in PADS:
        raise UnknownNameError("padding", pad, PADS)
    rows_before = (history - 1) * stride[episodes] if pad == "none" else np.zeros(len(episodes), np.int64)
    rows_after = (1 if pad == "both" else horizon) * stride[episodes]
    first_row, stop_row = cache.begin[episodes] + rows_before, cache.end[episodes] - rows_after
    ranges = [np.arange(a, b, step) for a, b in zip(first_row.tolist(), stop_row.tolist(), strict=True)]
    rows = np.concatenate([*ranges, np.empty(0, np.int64)]).astype(np.int64)
    owner = np.repeat(episodes, [len(r) for r in ranges])
    if len(rows) and not cache.all_valid:
        is_valid = cache.valid[rows]
        rows, owner = rows[is_valid], owner[is_valid]
    if not len(rows):
        raise _no_window_error(cache, episodes, int((rows_before + rows_after).min()) + 1)
    return rows, owner


def _no_window_error(cache: Cache, episodes: Numbers, needed_rows: int) -> DataError:
    """Return the error for episodes that hold no window."""
    lengths = np.array(cache.file.rows)[episodes]
    longest_episode = int(np.argmax(lengths))
    return DataError(
        "no episode is long enough for a window" if lengths.max() < needed_rows else "no window begins at a valid row",
        expected=f"at least {needed_rows} rows",
        found=f"{len(lengths)} episodes of {lengths.min()} to {lengths.max()} rows",
        where=Where(episode=cache.file.ids[episodes[longest_episode]]),
        fix='take a shorter horizon or a higher rate_hz, or pad="both"',
    )
