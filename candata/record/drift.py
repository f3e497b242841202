"""The drift of the forces: what an untouched, resting hand reads after a session against what it read before."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from candata.errors import SetupError
from candata.record.calibration import Calibration, CalibrationLimits, calibrate
from candata.record.devices._contract import States
from candata.record.logs import LogMeta
from candata.record.recorder_tally import join_states
from candata.schema.session import DriftCheck

#: How many standard errors of the difference of two means pass for noise: of a thousand axes without drift, three
#: exceed it (normal distribution).
NOISE_ERRORS = 3.0
#: A constant signal is read to half a count: so far two means may differ by rounding alone.
ROUNDING_COUNTS = 0.5
#: How long a hand may take to come to rest after the session [s]. Chosen: hands off, and a little.
PATIENCE_S = 10.0


def resting_hand(states: States, duration_s: float, meta: LogMeta, limits: CalibrationLimits) -> Calibration:
    """Return the mean reading of a window of a log in which the hand rested untouched.

    Raises
    ------
    SetupError
        As `calibrate`.
    """
    return calibrate(
        states,
        duration_s,
        joint_names=meta.joint_names,
        fingertip_names=meta.fingertip_names,
        newton_per_count=meta.newton_per_count,
        rate_hz=meta.rate_hz,
        limits=limits,
    )


def drift_check(
    before: Calibration, states: States, duration_s: float, meta: LogMeta, limits: CalibrationLimits
) -> DriftCheck:
    """Return how far the forces drifted, or the problem that kept it from being measured.

    A fingertip that is pressed steadily cannot be told from one that drifted.

    Parameters
    ----------
    before : Calibration
        What the resting hand read before the session.
    states : States
        All states of a window after it.
    duration_s : float
        Length of that window [s].
    meta : LogMeta
        Names and scale.
    limits : CalibrationLimits
        What still counts as rest; its level does not count.
    """
    try:
        after = resting_hand(states, duration_s, meta, replace(limits, force_level_N=np.inf))
    except SetupError as error:
        return DriftCheck(problem=f"{error.problem} ({error.found})")
    change = np.abs(after.force_bias_counts - before.force_bias_counts)
    noise = np.maximum(NOISE_ERRORS * np.hypot(_error_counts(before), _error_counts(after)), ROUNDING_COUNTS)
    sums_N = change.sum(axis=1) * meta.newton_per_count, noise.sum(axis=1) * meta.newton_per_count
    names = meta.fingertip_names
    change_N, noise_N = (dict(zip(names, np.round(sums, 6).tolist(), strict=True)) for sums in sums_N)
    is_beyond = (change > noise).any(axis=1)
    return DriftCheck(
        change_N=change_N,
        noise_N=noise_N,
        beyond_noise=tuple(name for name, flag in zip(names, is_beyond, strict=True) if flag),
    )


class DriftWindow:
    """Windows of states after a session, each a quarter later than the one before, until the hand rested in one."""

    def __init__(self, duration_s: float) -> None:
        """Begin closed; a window lasts so long [s]."""
        self._duration_s = duration_s
        self._opened_ns: int | None = None
        self._parts: list[tuple[int, States]] = []

    @property
    def is_open(self) -> bool:
        """Whether states are taken."""
        return self._opened_ns is not None

    def open(self, now_ns: int) -> None:
        """Take states from now on [ns]."""
        self._opened_ns = now_ns

    def add(self, stamps_ns: Sequence[int], states: States) -> None:
        """Take n states with their stamps [ns], if open."""
        if self.is_open:
            self._parts.append((stamps_ns[0], states))

    def result(self, before: Calibration, meta: LogMeta, limits: CalibrationLimits) -> DriftCheck | None:
        """Return the drift once the hand rested; the problem after `PATIENCE_S`; None while states are awaited."""
        is_late = time.monotonic_ns() - (self._opened_ns or 0) > 1e9 * (PATIENCE_S + self._duration_s)
        if self._parts and self._parts[-1][0] - self._parts[0][0] >= 1e9 * self._duration_s:
            drift = drift_check(before, join_states([s for _, s in self._parts]), self._duration_s, meta, limits)
            if not drift.problem or is_late:
                return drift
            next_ns = self._parts[0][0] + 1e9 * self._duration_s / 4
            self._parts = [part for part in self._parts if part[0] >= next_ns]
        return DriftCheck(problem="too few states came") if is_late else None


def _error_counts(calibration: Calibration) -> np.ndarray:
    """Return the largest standard error `(F, 3)` of the means in counts.

    A reading that travels by `r` has a standard deviation of at most `r / 2` (Popoviciu's inequality on variances).
    """
    return calibration.force_spread_counts / 2 / np.sqrt(calibration.rows)


def drift_text(drift: DriftCheck) -> str:
    """Return a drift check in words, a line."""
    if drift.problem:
        return f"drift not measured: {drift.problem}"
    sizes = ", ".join(f"{name} {size:.2f} N" for name, size in drift.change_N.items())
    if not drift.beyond_noise:
        return f"no drift beyond the noise: {sizes}"
    return f"the forces drifted at {', '.join(drift.beyond_noise)}: {sizes}; contact near the threshold may be wrong"
