"""Contact flags from forces: the one rule by which contact is derived."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Added to the threshold so that 3 counts of 0.1 N do not pass 0.3 N by float rounding alone.
THRESHOLD_MARGIN_N = 1e-6


def fingertip_contact(
    force: NDArray,
    threshold_n: float = 0.3,
    release_n: float | None = None,
    before: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Return `(T, F) bool`: where |Fx| + |Fy| + |Fz| exceeds the threshold, or has not fallen below the release since.

    Parameters
    ----------
    force : ndarray
        `(T, F, 3) float [N]`, the force on each fingertip in the order of time; a force that is not finite is no
        contact, and ends one.
    threshold_n : float
        Above it contact begins [N].
    release_n : float, optional
        Below it contact ends [N]; without one, contact ends where the threshold is no longer exceeded.
    before : ndarray, optional
        `(F,) bool`, the flags before the first row; none by default. It counts with a release alone.
    """
    total = np.abs(np.asarray(force, dtype=np.float64)).sum(axis=-1)
    return contact_of_totals(total, threshold_n, release_n, before)


def contact_of_totals(
    total: NDArray, threshold_n: float, release_n: float | None = None, before: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Return the flags of `fingertip_contact` from `total`, `(T, F) float [N]`: |Fx| + |Fy| + |Fz|."""
    exceeds = np.isfinite(total) & (total > threshold_n + THRESHOLD_MARGIN_N)
    if release_n is None:
        return exceeds
    is_held = np.isfinite(total) & ~exceeds & (total >= release_n - THRESHOLD_MARGIN_N)
    # Each held row bears the flag of the last row that decides; row 0 of the extended flags stands before the first.
    first = np.zeros((1, *total.shape[1:]), bool) if before is None else np.asarray(before, bool)[None]
    flags, is_held = np.concatenate([first, exceeds]), np.concatenate([np.zeros_like(first), is_held])
    index = np.arange(len(flags)).reshape(-1, *[1] * (flags.ndim - 1))
    decided = np.maximum.accumulate(np.where(is_held, 0, index), axis=0)
    return np.take_along_axis(flags, decided, axis=0)[1:]
