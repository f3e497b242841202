"""Rule: values that count as valid are finite."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView, valid_rows

REMEDY = "import again with --allow-gaps: such rows are kept and marked invalid"


def _finite(view: EpisodeView) -> Iterator[Finding]:
    """Yield each channel with NaN or infinity in valid rows."""
    for name, array in view.raw.arrays.items():
        if array.dtype.kind != "f" or array.ndim == 0:
            continue
        finite = np.asarray(np.isfinite(array).all(axis=tuple(range(1, array.ndim))))
        is_wrong = valid_rows(view.raw, name) & ~finite
        if is_wrong.any():
            text = f"{is_wrong.sum()} of {len(array)} rows are not finite"
            yield view.finding(
                "error", "finite", "values are not finite", text, name, is_wrong, REMEDY, rows=int(is_wrong.sum())
            )


RULE = Rule(meaning="valid values are finite", episode=_finite)
