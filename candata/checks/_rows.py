"""Rows that the rules look at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candata.datasets import RawEpisode
from candata.schema.channels import VALID_SUFFIX


def valid_rows(episode: RawEpisode, channel: str) -> NDArray[np.bool_]:
    """Return `(T,) bool`: the rows that count; all where the flags are missing or of another length."""
    rows = len(episode.arrays[channel])
    flags = episode.arrays.get(channel + VALID_SUFFIX)
    if flags is None or flags.shape != (rows,):
        return np.ones(rows, bool)
    return flags.astype(bool)
