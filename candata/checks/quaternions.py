"""Rule: quaternions are unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView, valid_rows
from candata.schema.channels import QUATERNION
from candata.schema.episode import QUATERNION_TOLERANCE

REMEDY = "normalise them at the source, and check which columns of the map are the quaternion's"


def _unit(view: EpisodeView) -> Iterator[Finding]:
    """Yield each pose channel with a quaternion of another norm than 1 in valid rows."""
    for name in sorted(QUATERNION.keys() & view.raw.arrays.keys()):
        array = view.raw.arrays[name]
        if array.ndim != 2 or array.shape[1] < QUATERNION[name].stop:
            continue
        part = array[:, QUATERNION[name]].astype(np.float64)
        finite = np.asarray(np.isfinite(part).all(axis=1))
        norm = np.linalg.norm(np.where(finite[:, None], part, 0.0), axis=1)
        is_wrong = valid_rows(view.raw, name) & finite & (np.abs(norm - 1) > QUATERNION_TOLERANCE)
        if is_wrong.any():
            text = f"norm {norm[np.argmax(is_wrong)]:.6g}, expected 1 +- {QUATERNION_TOLERANCE} ({is_wrong.sum()} rows)"
            yield view.finding(
                "error",
                "quaternions",
                "a quaternion is not unit",
                text,
                name,
                is_wrong,
                REMEDY,
                rows=int(is_wrong.sum()),
                median_norm=float(np.median(norm[is_wrong])),
            )


RULE = Rule(meaning="quaternions w x y z have norm 1", episode=_unit)
