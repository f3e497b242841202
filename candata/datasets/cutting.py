"""Long episodes cut into pieces of one length."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from candata.datasets.adding import append
from candata.datasets.dataset import Dataset
from candata.datasets.deriving import link_clouds, new_dataset
from candata.datasets.history import derived_lineage
from candata.errors import DataError, UsageError
from candata.schema.channels import VALID_SUFFIX
from candata.schema.episode import Episode
from candata.schema.manifest import VersionFile

_OPERATION = "cut"


def pieces(episode: Episode, length_s: float) -> Iterator[Episode]:
    """Yield the pieces of an episode that are `length_s` [s] long, each with its time from zero.

    A piece is a motion of its own: its number ends its id and its task. The rest at the end, shorter than a piece, is
    left out.
    """
    rows = max(2, round(length_s * episode.meta.rate_hz))
    for k in range(len(episode) // rows):
        names = {"id": f"{episode.meta.id}-{k}", "task": f"{episode.meta.task or ''}-{k}"}
        yield piece(episode, k * rows, (k + 1) * rows, **names)


def piece(episode: Episode, begin: int, end: int, **meta: str) -> Episode:
    """Return the rows from `begin` to `end` of an episode as an episode, its time from zero; `meta` replaces fields."""
    arrays = {name: np.asarray(values)[begin:end] for name, values in episode.arrays.items()}
    arrays["time_ns"] = arrays["time_ns"] - arrays["time_ns"][:1]
    invalid = {
        name.removesuffix(VALID_SUFFIX): int((~values).sum())
        for name, values in arrays.items()
        if name.endswith(VALID_SUFFIX) and not values.all()
    }
    return Episode(episode.meta.model_copy(update={**meta, "invalid_counts": invalid}), arrays)


def cut(dataset: Dataset, length_s: float, out: Path) -> VersionFile:
    """Return the version of a new dataset `out` that holds the pieces of all episodes, as `pieces` makes them.

    Parameters
    ----------
    dataset : Dataset
        Version to start from.
    length_s : float
        Length of a piece [s].
    out : Path
        Folder of the new dataset.

    Raises
    ------
    UsageError
        When the length is none, or `out` stands.
    DataError
        When every episode is shorter, or a part is damaged.
    """
    if not (np.isfinite(length_s) and length_s > 0):
        raise UsageError("a piece has no length", expected="seconds above 0", found=f"{length_s:g}")
    sizes = dataset.catalog(["rows", "rate_hz"]).to_pylist()
    longest_s = max((size["rows"] / size["rate_hz"] for size in sizes), default=0.0)
    if longest_s < length_s:
        raise DataError(
            "every episode is shorter than a piece",
            expected=f"at least {length_s:g} s",
            found=f"at most {longest_s:.3g} s",
            fix="cut into shorter pieces",
        )
    with new_dataset(out) as root:
        link_clouds(dataset, root)
        made = (piece for episode in dataset.episodes() for piece in pieces(episode, length_s))
        return append(root, made, derived_lineage(_OPERATION, [dataset], {"length_s": length_s}))
