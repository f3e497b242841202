"""Contact flags from forces: the one rule by which contact is derived."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Added to the threshold so that 3 counts of 0.1 N do not pass 0.3 N by float rounding alone.
THRESHOLD_MARGIN_N = 1e-6


def fingertip_contact(force: NDArray, threshold_n: float = 0.3) -> NDArray[np.bool_]:
    """Return `(T, F) bool`: where |Fx| + |Fy| + |Fz| exceeds the threshold.

    Parameters
    ----------
    force : ndarray
        `(T, F, 3) float [N]`, the force on each fingertip; a force that is not finite is no contact.
    threshold_n : float
        Threshold in newton.
    """
    total = np.abs(np.asarray(force, dtype=np.float64)).sum(axis=-1)
    return np.isfinite(total) & (total > threshold_n + THRESHOLD_MARGIN_N)
