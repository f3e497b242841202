"""Velocity of joints as their servos report it, put on the clock of their encoders.

A servo derives its velocity from its own encoder, filtered and late. So a replay's velocity is derived from its joint
positions, and how well the reported one is known shows against the recorded positions, without a simulation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Latest a reported velocity may be [s], by steps of how many rows, at least how many seconds, it is looked for, and
#: how near one its ratio to the encoder's own rate must lie. Chosen: firmware averages over some 10 to 50 ms; a unit
#: mistaken is off by more.
LATEST_S, LAG_ROWS, LAG_S, RATIO = 0.1, 0.5, 0.0025, 0.2
#: Least correlation of a reported velocity with the encoder's own rate. Chosen: rounded to zero in slow motion it tells
#: nothing.
FOLLOWS = 0.5


def joint_velocity(position: Array, rate_hz: float) -> Array:
    """Return the velocity of joints `(..., T, J)` [rad/s; m/s of slides] by central differences."""
    if position.shape[-2] < 2:
        return np.zeros_like(position)
    return np.asarray(np.gradient(position, axis=-2)) * rate_hz


def with_aligned_velocity(
    readings: dict[str, Array], rate_hz: float, joints: Sequence[str]
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return readings with what their `joint_velocity` tells on the clock of `joint_position`, or without it."""
    if "joint_velocity" not in readings:
        return readings, ()
    velocity, notes = aligned_velocity(readings["joint_velocity"], readings["joint_position"], rate_hz, joints)
    others = {channel: values for channel, values in readings.items() if channel != "joint_velocity"}
    return others | ({"joint_velocity": velocity} if np.isfinite(velocity).any() else {}), notes


def aligned_velocity(
    reported: Array, position: Array, rate_hz: float, joints: Sequence[str]
) -> tuple[Array, tuple[str, ...]]:
    """Return reported velocities `(E, T, J)` on the clock of the positions, NaN for joints of which they tell nothing.

    Parameters
    ----------
    reported, position : (E, T, J) float64
        As recorded [rad/s and rad; m/s and m]; NaN where missing.
    rate_hz : float
        Rows a second.
    joints : sequence of str
        Names of the joints, for the notes.

    Returns
    -------
    (E, T, J) float64, tuple of str
        The velocities, and notes on how late they are and which are not compared.
    """
    rate, out = joint_velocity(position, rate_hz), np.full(reported.shape, np.nan)
    step = max(LAG_ROWS, LAG_S * rate_hz)
    lags = np.arange(0, LATEST_S * rate_hz + step / 2, step)
    late, unusable = {}, []
    for j, name in enumerate(joints):
        earlier = [_earlier(reported[..., j], lag) for lag in lags]
        fits = [_fit(each, rate[..., j]) for each in earlier]
        best = int(np.argmax([correlation for correlation, _ in fits]))
        correlation, ratio = fits[best]
        if correlation < FOLLOWS or abs(ratio - 1) > RATIO:
            unusable.append(name)
            continue
        out[..., j] = earlier[best] / ratio
        late[name] = 1e3 * lags[best] / rate_hz
    notes = []
    if any(late.values()):
        latest_ms = max(late.values())
        notes.append(f"joint_velocity is up to {latest_ms:.0f} ms later than joint_position: compared in time")
    if unusable:
        notes.append(f"joint_velocity of {', '.join(unusable)} is not the rate of joint_position: it is not compared")
    return out, tuple(notes)


def _earlier(values: Array, lag: float) -> Array:
    """Return values `(E, T)` as many rows earlier, read between rows; NaN at the end."""
    rows = np.arange(values.shape[1]) + lag
    first = np.floor(rows).astype(int)
    part = rows - first
    padded = np.concatenate([values, np.full((len(values), int(np.ceil(lag)) + 1), np.nan)], axis=1)
    return np.where(part == 0, padded[:, first], (1 - part) * padded[:, first] + part * padded[:, first + 1])


def _fit(values: Array, rate: Array) -> tuple[float, float]:
    """Return the correlation of values `(E, T)` with a rate, and by how many times they are larger."""
    known = np.isfinite(values) & np.isfinite(rate)
    x, y = rate[known], values[known]
    squares = float((x**2).sum() * (y**2).sum())
    product = float((x * y).sum())
    return (product / np.sqrt(squares), product / float((x**2).sum())) if squares > 0 else (0.0, 0.0)
