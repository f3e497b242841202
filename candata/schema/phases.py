"""Phases of a contact: free, onset, sustained, release."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Length of onset (from the touch on) and of release (centred on the loss). Chosen: several control
#: periods at 80 Hz, and longer than the impact transient of a fingertip.
TRANSITION_S = 0.1

CONTACT_PHASES = ("free", "onset", "sustained", "release")


def contact_phases(contact: ArrayLike, rate_hz: float) -> NDArray[np.str_]:
    """Return the phase of each row, `(T,)`: free, onset, sustained or release.

    A touch is the first row in contact after one without, a loss the first row without contact after one
    with. Onset is the first 100 ms from the touch, while in contact; release the 100 ms around the loss.
    A row in contact that both claim is onset. A contact that stands in the first row has no onset.

    Parameters
    ----------
    contact : (T,) bool
        Touch in each row.
    rate_hz : float
        Rows a second.

    Raises
    ------
    ValueError
        When `contact` is not `(T,)` or the rate not positive.
    """
    touch = np.asarray(contact, bool)
    if touch.ndim != 1 or not rate_hz > 0:
        raise ValueError(f"expected contact (T,) and rate_hz > 0, found {touch.shape} and {rate_hz}")
    change = np.diff(touch.astype(np.int8), prepend=touch[:1].astype(np.int8))
    rows = max(1, round(TRANSITION_S * rate_hz))
    rows_before = rows // 2
    release = _spread(change == -1, rows_before, rows - rows_before)
    onset = _spread(change == 1, 0, rows) & touch
    phases = np.where(touch, "sustained", "free").astype("<U9")
    phases[release] = "release"
    phases[onset] = "onset"
    return phases


def _spread(events: NDArray[np.bool_], rows_before: int, rows_after: int) -> NDArray[np.bool_]:
    """Return `(T,) bool`: rows from `rows_before` rows ahead of an event to `rows_after - 1` rows behind it."""
    is_near = np.zeros(len(events), bool)
    for row in np.flatnonzero(events):
        is_near[max(0, row - rows_before) : row + rows_after] = True
    return is_near
