"""White noise of readings: what a parabola leaves of short windows, told by those in which it leaves least."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from candata.gap.data.recordings import Recordings
from candata.gap.data.rounding import Readings
from candata.gap.data.sample_hold import only_new
from candata.rotation import difference

Array = NDArray[np.float64]
#: What is read, with its unit; noise is an array of these, one standard deviation each.
QUANTITIES = (
    ("object position", "m"),
    ("object rotation", "rad"),
    ("joint position", "rad"),
    ("sliding joint position", "m"),
    ("fingertip force", "N"),
)
#: Rows of a window, and the degree of the polynomial that is taken for motion in it. Chosen: of a 1 Hz sine of 0.5 rad
#: at 100 Hz, a parabola leaves 0.2 mrad.
WINDOW, DEGREE = 8, 2
#: Quantile over windows, and over a quantity's columns, at which noise is read: noise is in all of them, what shakes a
#: slipping fingertip is not. Record 43.
QUIET, LOW = 0.1, 0.25
#: Share of pure noise's windows by which an estimate is refined, and how often. Chosen on white noise of 12 episodes
#: and three columns, half of which also move half of the time: 1.002 +- 0.023 of the truth (1.007 +- 0.040 unrefined).
CALMER, ROUNDS = 0.9, 6
_BASIS = np.linalg.qr(np.vander(np.arange(WINDOW) - (WINDOW - 1) / 2, DEGREE + 1, increasing=True))[0]


def variances(recs: Recordings, other: Readings | None = None, slides: NDArray[np.bool_] | None = None) -> Array:
    """Return `(5,)` variances of white noise in readings, or in what they differ by from others; 0 where none are.

    What a parabola leaves of short windows is noise, read off those where it leaves least.
    """
    return white_estimates(recs, other, _turning(recs) if slides is None else slides)[0]


def white_estimates(recs: Recordings, other: Readings | None, slides: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return variances `(5,)` as `variances` does, and from how many windows of columns each is read."""
    windows = [_windows(q, recs, other, slides) for q, _ in QUANTITIES]
    count = [0 if w is None else int(np.isfinite(w).all(2).sum()) for w in windows]
    return np.array([0.0 if w is None else white_variance(w) for w in windows]), np.array(count, float)


def _turning(recs: Recordings) -> NDArray[np.bool_]:
    """Return `(J,)` that no recorded joint slides."""
    joints = recs.readings.get("joint_position")
    return np.zeros(0 if joints is None else joints.shape[2], bool)


def columns_of(quantity: str, recs: Recordings, slides: NDArray[np.bool_]) -> slice | NDArray[np.int64] | None:
    """Return the columns of a quantity in its channel; None where it was not recorded."""
    channel = _channel(quantity)
    if channel not in recs.readings:
        return None
    if channel != "joint_position":
        return slice(None)
    columns = np.flatnonzero(slides == quantity.startswith("sliding"))
    return columns if len(columns) else None


def _windows(quantity: str, recs: Recordings, other: Readings | None, slides: NDArray[np.bool_]) -> Array | None:
    """Return windows `(E, N, WINDOW, D)` of a quantity, or of its difference; None where it was not recorded."""
    channel, columns = _channel(quantity), columns_of(quantity, recs, slides)
    if columns is None:
        return None
    slow = recs.sources.get(channel)
    values = windows_of(only_new(recs.readings[channel], slow))
    others = (
        np.repeat(values[:, :, :1], WINDOW, axis=2) if other is None else windows_of(only_new(other[channel], slow))
    )
    if quantity == "object rotation":
        return difference(values[..., 3:], others[..., 3:])
    apart = (values - others)[..., columns]
    return apart[..., :3] if channel == "object_pose" else apart


def _channel(quantity: str) -> str:
    """Return the channel that a quantity is read from."""
    return "object_pose" if quantity.startswith("object") else quantity.removeprefix("sliding ").replace(" ", "_")


def windows_of(values: Array) -> Array:
    """Return `(E, T, ...)` values as windows `(E, N, WINDOW, D)`; a first row holds no force yet."""
    count = (values.shape[1] - 1) // WINDOW
    return values[:, 1 : 1 + count * WINDOW].reshape(len(values), count, WINDOW, -1)


def white_variance(windows: Array) -> float:
    """Return the variance of white noise in windows `(E, N, WINDOW, D)`; 0 without any that is whole.

    Of n numbers, what a polynomial of k terms leaves is chi-squared with n - k degrees of freedom.
    """
    free = WINDOW - DEGREE - 1
    left = (windows**2).sum(2) - (np.einsum("tk,entd->ekdn", _BASIS, windows) ** 2).sum(1).swapaxes(1, 2)
    left = np.maximum(left, 0.0)  # of what lies on a parabola exactly, rounding leaves less than nothing
    columns = left.reshape(-1, windows.shape[-1]).T
    quiet = [np.quantile(c[np.isfinite(c)], QUIET) for c in columns if np.isfinite(c).any()]
    if not quiet:
        return 0.0
    first = max(float(np.quantile(quiet, LOW)), 0.0) / float(chi2.ppf(QUIET, free))
    return _refined(left[np.isfinite(left)], first, free)


def _refined(remainders: Array, variance: float, free: int) -> float:
    """Return the variance of white noise from the calmer windows of all columns, near a first estimate.

    The mean of chi-squared with n degrees of freedom below a cut c is n F_{n+2}(c) / F_n(c), by its density.
    """
    cut = float(chi2.ppf(CALMER, free))
    typical = free * float(chi2.cdf(cut, free + 2)) / CALMER
    for _ in range(ROUNDS):
        calm = remainders[remainders < cut * variance]
        if len(calm):
            variance = float(calm.mean()) / typical
    return variance
