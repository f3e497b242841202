"""Rule: values that count as valid are finite."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._rows import valid_rows
from candata.datasets import RawEpisode


def _finite(episode: RawEpisode) -> Iterator[Finding]:
    """Yield each channel with NaN or infinity in valid rows."""
    for name, array in episode.arrays.items():
        if array.dtype.kind != "f":
            continue
        finite = np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
        bad = np.flatnonzero(valid_rows(episode, name) & ~finite)
        if len(bad):
            text = f"{len(bad)} of {len(array)} rows are not finite"
            yield Finding("error", "finite", text, episode.id, name, int(bad[0]))


RULE = Rule(meaning="valid values are finite", episode=_finite)
