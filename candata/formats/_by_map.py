"""One episode from named arrays, as a feature map says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.errors import Where
from candata.formats import Reading
from candata.formats._assemble import checked_episode, gather
from candata.formats._features import Pick, blocks, names_of
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.exchange import FeatureMap


def mapped_episode(
    identity: str,
    time_ns: NDArray[np.int64],
    arrays: Mapping[str, NDArray],
    channel_picks: Sequence[Pick],
    mapping: FeatureMap,
    reading: Reading,
    path: Path,
    **file_facts: Any,
) -> Episode:
    """Return one checked episode.

    Parameters
    ----------
    identity : str
        Its id.
    time_ns : ndarray
        `(T,) int64 [ns]`.
    arrays : mapping of str to ndarray
        Each feature as `(T, width)`.
    channel_picks : sequence of Pick
        How each channel is made.
    mapping : FeatureMap
        The map that `channel_picks` comes from.
    reading : Reading
        What the import was told; comes before the map.
    path : Path
        File, for messages.
    **file_facts
        What the file itself says: `rate_hz`, and `task` where it names one.

    Raises
    ------
    DataError
        When a value is not finite, or the arrays make no episode.
    """
    location = Where(path=str(path), episode=identity)
    episode_arrays = gather(
        time_ns, blocks(channel_picks, arrays), np.arange(len(time_ns)), location, reading.allow_gaps
    )
    stated_facts = {
        name: getattr(reading, name) or getattr(mapping, name) or file_facts.get(name)
        for name in ("scene", "object", "task")
    }
    fields: dict[str, Any] = {
        "id": identity,
        "source": reading.source,
        "force": mapping.force,
        "action": mapping.action,
    }
    fields |= {"contact_rule": episode_arrays.rule, "invalid_counts": episode_arrays.invalid}
    meta = EpisodeMeta.model_validate(file_facts | stated_facts | fields | names_of(channel_picks))
    return checked_episode(meta, episode_arrays.arrays, path)


def even_time_ns(rows: int, rate_hz: float) -> NDArray[np.int64]:
    """Return `(rows,) int64 [ns]`: the beat of a rate, from zero."""
    return np.rint(np.arange(rows) * 1e9 / rate_hz).astype(np.int64)
