"""Other words for some episodes: object, task, outcome, scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from candata.datasets.dataset import Dataset
from candata.datasets.deriving import Finish, link_clouds, link_part, new_dataset, nothing_more, publish_first
from candata.datasets.filtering import matching
from candata.datasets.history import derived
from candata.datasets.parts import entry_of, write_part
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.schema.episode import Episode
from candata.schema.manifest import PartEntry, VersionFile

#: What may be relabelled: words that people choose, nothing that was measured.
LABELS = ("object", "task", "outcome", "scene")

_OPERATION = "relabel"


def relabel(
    dataset: Dataset, labels: Mapping[str, str | None], where: str | None, out: Path, finish: Finish = nothing_more
) -> VersionFile:
    """Return the version of a new dataset `out` in which some episodes bear other labels.

    Parts that hold one of them are written anew, the others are shared. The content hash covers the labels, so
    the episodes count as changed; their arrays are the same.

    Parameters
    ----------
    dataset : Dataset
        Version to start from.
    labels : mapping of str to str or None
        New values of `LABELS`; None takes a label away.
    where : str, optional
        Expression as for `matching`; by default all episodes.
    out : Path
        Folder of the new dataset.
    finish : callable
        Takes the new dataset before it appears; `candata.loaders.carry_splits` makes one.

    Raises
    ------
    UnknownNameError
        When a label has another name, or the expression names no column.
    UsageError
        When there are no labels, the expression is none, or `out` stands.
    DataError
        When no episode is meant, or a part is damaged.
    """
    for name in labels:
        if name not in LABELS:
            raise UnknownNameError("label", name, LABELS)
    if not labels:
        raise UsageError("nothing to set", expected="at least 1 label", fix=f"--set {LABELS[0]}=VALUE")
    chosen = frozenset(dataset.ids if where is None else matching(dataset, where))
    if not chosen:
        raise DataError("no episode is meant", found=f"0 of {len(dataset)}", where=Where(path=f"where {where}"))
    details = {"set": dict(labels), "where": where, "episodes": len(chosen)}
    with new_dataset(out, finish) as root:
        link_clouds(dataset, root)
        entries = list(_entries(dataset, labels, chosen, root))
        kept = {entry.id for entry in entries}
        held = {n for part in dataset.raw_parts() if part.entry.id in kept for n, _ in part.manifest().episodes}
        hidden = held - frozenset(dataset.ids)
        return publish_first(root, entries, hidden, derived(_OPERATION, [dataset], details))


def _entries(
    dataset: Dataset, labels: Mapping[str, str | None], chosen: frozenset[str], root: Path
) -> Iterator[PartEntry]:
    """Yield the parts as they stand in `root`: linked, or written anew where they hold a chosen episode."""
    written: set[str] = set()
    visible = frozenset(dataset.ids)
    for part in dataset.raw_parts():
        names = [name for name, _ in part.manifest().episodes if name in visible]
        if not chosen.intersection(names):
            yield link_part(part, root)
            continue
        fresh = [name for name in names if name not in written]
        written.update(fresh)
        if fresh:
            yield entry_of(
                root, write_part(root, _labelled(dataset, fresh, labels, chosen), {"operation": _OPERATION}).id
            )


def _labelled(
    dataset: Dataset, names: list[str], labels: Mapping[str, str | None], chosen: frozenset[str]
) -> Iterator[Episode]:
    """Yield episodes, the chosen ones with their new labels."""
    for episode in dataset.episodes(names):
        meta = episode.meta.model_copy(update=dict(labels)) if episode.meta.id in chosen else episode.meta
        yield Episode(meta, episode.arrays)
