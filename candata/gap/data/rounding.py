"""Rounding of readings to whole steps: the steps are found in the data, and noise is told through them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import norm

from candata.gap.run.streams import Streams

Array = NDArray[np.float64]
Readings = dict[str, Array]
#: Significant digits to which an encoder's step is known. Chosen: 4096 steps a turn are 1.53 mrad.
STEP_DIGITS = 3
#: Smallest resolution of a force that is looked for [N], and how far from whole multiples of it readings may lie.
RESOLUTION, WHOLE = 1e-6, 1e-3
#: Share of a joint's changes from row to row that must be whole multiples of the smallest for it to be the encoder's
#: step, how far from whole they may lie, and the fewest changes that tell. Chosen: units exist that repeat every other
#: sample or jump by a part of a turn now and then; changes that are not rounded are whole to 0.1 a fifth of the time.
STEPPED, STEP_WHOLE, FEWEST_CHANGES = 0.95, 0.1, 20
#: Noise in resolutions below which rounding hides it, and multiples of the resolution that noise reaches.
HIDDEN, REACH = 0.1, 20


def dithered(readings: Readings, step: float, joint_steps: Array | None = None) -> Readings:
    """Return readings as uneven as before they were rounded, forces to a step and joints to `(J,)`, by fixed numbers.

    A window in which no rounded reading changes would show no noise at all. Dither of one step's width adds the
    variance of a uniform error, step^2 / 12 (Widrow & Kollar 2008).
    """
    steps = {"fingertip_force": step, "joint_position": 0.0 if joint_steps is None else joint_steps}
    out = dict(readings)
    for channel, size in steps.items():
        if np.any(size):
            width = Streams().of("dither", channel).uniform(-0.5, 0.5, readings[channel].shape)
            out[channel] = readings[channel] + size * width
    return out


def joint_step(readings: Readings) -> Array:
    """Return `(J,)` the step of each joint's encoder [rad or m]: what most changes are multiples of, else 0."""
    joints = readings.get("joint_position", np.zeros((0, 0, 0)))
    out = np.zeros(joints.shape[2])
    for j in range(len(out)):
        changes = np.abs(np.diff(joints[..., j], axis=1)).ravel()
        changes = changes[np.isfinite(changes)]
        steps = changes[changes > RESOLUTION]
        if len(steps) < FEWEST_CHANGES or len(steps) == len(changes):
            continue  # what is rounded repeats a reading now and then
        for candidate in (steps.min(), np.quantile(steps, 1 - STEPPED)):
            multiples = steps / candidate
            whole = np.abs(multiples - np.round(multiples)) < STEP_WHOLE
            if out[j] == 0 and whole.mean() >= STEPPED:
                out[j] = float(f"{np.median(steps[whole] / np.round(multiples[whole])):.{STEP_DIGITS}g}")
    return out


def force_step(readings: Readings) -> float:
    """Return the resolution of the forces [N]: what all of them are whole multiples of; 0 where there is nothing."""
    sizes = np.abs(readings.get("fingertip_force", np.zeros(0)))
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    step = float(sizes.min()) if sizes.size else 0.0
    is_whole = step > RESOLUTION and bool((np.abs(sizes / step - np.round(sizes / step)) < WHOLE).all())
    return round(step, 6) if is_whole else 0.0


def before_rounding(variance: float, step: float) -> float:
    """Return the noise (1 sd) that, rounded to whole steps around zero, has a variance; 0 where rounding hides it."""
    if step == 0:
        return float(np.sqrt(variance))
    if variance >= _rounded(1.0) * step**2:
        # Far beyond the resolution, rounding too adds the variance of a uniform error.
        return float(np.sqrt(variance - step**2 / 12))
    if variance <= _rounded(HIDDEN) * step**2:
        return 0.0
    return step * float(brentq(lambda s: _rounded(s) - variance / step**2, HIDDEN, 1.0))


def _rounded(size: float) -> float:
    """Return the variance of normal noise of a size, in steps, rounded to whole ones.

    Of k^2 = 1 + 3 + ... + (2k - 1), the sum over k of (2k - 1) P(|n| > k - 1/2).
    """
    k = np.arange(1, REACH)
    return float(((2 * k - 1) * 2 * norm.sf((k - 0.5) / size)).sum())
