"""The robust loss of a normalised residual: Student's t, so that one odd outcome does not outvote the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Compact = NDArray[np.float32]
#: Degrees of freedom of the Student-t loss (Lange, Little & Taylor 1989).
NU = 5.0


def rho(z: Compact) -> Compact:
    """Return the Student-t loss of each normalised residual, `(nu + 1) / 2 log(1 + z^2 / nu)`.

    A logarithm of single precision takes a quarter of the time of `log1p`; residuals that it takes for zero are.
    """
    out = z * z
    out *= 1 / NU
    out += 1
    np.log(out, out=out)
    out *= (NU + 1) / 2
    return out


def weights(z: Compact) -> Compact:
    """Return the weights of iteratively reweighted least squares, `(nu + 1) / (nu + z^2)`."""
    return (np.float32(NU + 1) / (np.float32(NU) + z * z)).astype(np.float32)
