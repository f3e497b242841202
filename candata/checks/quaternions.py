"""Rule: quaternions are unit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._rows import valid_rows
from candata.datasets import RawEpisode
from candata.schema.channels import QUATERNION
from candata.schema.episode import QUATERNION_TOLERANCE


def _unit(episode: RawEpisode) -> Iterator[Finding]:
    """Yield each pose channel with a quaternion of another norm than 1 in valid rows."""
    for name in QUATERNION.keys() & episode.arrays.keys():
        array = episode.arrays[name]
        if array.ndim != 2 or array.shape[1] < QUATERNION[name].stop:
            continue
        part = array[:, QUATERNION[name]].astype(np.float64)
        finite = np.asarray(np.isfinite(part).all(axis=1))
        norm = np.linalg.norm(np.where(finite[:, None], part, 0.0), axis=1)
        bad = np.flatnonzero(valid_rows(episode, name) & finite & (np.abs(norm - 1) > QUATERNION_TOLERANCE))
        if len(bad):
            text = f"norm {norm[bad[0]]:.6g}, expected 1 +- {QUATERNION_TOLERANCE} ({len(bad)} rows)"
            yield Finding("error", "quaternions", text, episode.id, name, int(bad[0]))


RULE = Rule(meaning="quaternions w x y z have norm 1", episode=_unit)
