"""Other words for some episodes: object, task, outcome, scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from candata.datasets.dataset import Dataset
from candata.datasets.deriving import Finish, link_clouds, link_part, new_dataset, nothing_more, publish_first
from candata.datasets.filtering import matching_ids
from candata.datasets.history import derived_lineage
from candata.datasets.parts import entry_of, write_part
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.schema.episode import Episode
from candata.schema.manifest import PartEntry, VersionFile

#: What may be relabelled: words that people choose, nothing that was measured.
LABELS = ("object", "task", "outcome", "scene")

_OPERATION = "relabel"


def relabel(
    dataset: Dataset, labels: Mapping[str, str | None], expression: str | None, out: Path, finish: Finish = nothing_more
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
    expression : str, optional
        Expression as for `matching_ids`; by default all episodes.
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
    chosen_ids = frozenset(dataset.ids if expression is None else matching_ids(dataset, expression))
    if not chosen_ids:
        raise DataError("no episode is meant", found=f"0 of {len(dataset)}", where=Where(path=f"where {expression}"))
    details = {"set": dict(labels), "where": expression, "episodes": len(chosen_ids)}
    with new_dataset(out, finish) as root:
        link_clouds(dataset, root)
        entries = list(_entries(dataset, labels, chosen_ids, root))
        part_ids = {entry.id for entry in entries}
        episode_ids = {
            n for part in dataset.raw_parts() if part.entry.id in part_ids for n, _ in part.manifest().episodes
        }
        hidden_ids = episode_ids - frozenset(dataset.ids)
        return publish_first(root, entries, hidden_ids, derived_lineage(_OPERATION, [dataset], details))


def _entries(
    dataset: Dataset, labels: Mapping[str, str | None], chosen_ids: frozenset[str], root: Path
) -> Iterator[PartEntry]:
    """Yield the parts as they stand in `root`: linked, or written anew where they hold a chosen episode."""
    written_ids: set[str] = set()
    visible = frozenset(dataset.ids)
    for part in dataset.raw_parts():
        names = [name for name, _ in part.manifest().episodes if name in visible]
        if not chosen_ids.intersection(names):
            yield link_part(part, root)
            continue
        new_names = [name for name in names if name not in written_ids]
        written_ids.update(new_names)
        if new_names:
            yield entry_of(
                root,
                write_part(
                    root, _relabelled_episodes(dataset, new_names, labels, chosen_ids), {"operation": _OPERATION}
                ).id,
            )


def _relabelled_episodes(
    dataset: Dataset, names: list[str], labels: Mapping[str, str | None], chosen_ids: frozenset[str]
) -> Iterator[Episode]:
    """Yield episodes, the chosen ones with their new labels."""
    for episode in dataset.episodes(names):
        meta = episode.meta.model_copy(update=dict(labels)) if episode.meta.id in chosen_ids else episode.meta
        yield Episode(meta, episode.arrays)
