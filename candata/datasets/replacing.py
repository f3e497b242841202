"""Episodes made again: they take the place of those with their ids in a new version; the older versions stand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from candata.datasets import encode
from candata.datasets.dataset import open_dataset
from candata.datasets.parts import RawPart, entry_of, write_part
from candata.datasets.versions import advance, digest_of, index_of, read_dataset_file
from candata.errors import DataError, Where
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage, PartEntry, VersionFile


def replace(path: str | Path, episodes: Iterable[Episode], lineage: Lineage) -> VersionFile:
    """Return the version in which `episodes` stand, in place of those with their ids; the current one if none changed.

    Episodes of other ids are added. What the newest version excludes stays excluded.

    Parameters
    ----------
    path : str or Path
        Dataset.
    episodes : iterable of Episode
        Episodes; one is held at a time.
    lineage : Lineage
        How they came to be.

    Raises
    ------
    DataError
        When an id comes twice, or a part is damaged.
    UsageError
        When there is no dataset.
    """
    return publish_replacing(path, write_each(path, episodes, lineage.operation), lineage)


def write_each(path: str | Path, episodes: Iterable[Episode], operation: str) -> list[str]:
    """Return the ids of the parts that hold one episode each; they belong to no version until published.

    Raises
    ------
    DataError
        When an id comes twice.
    UsageError
        When there is no dataset.
    """
    root = Path(path)
    read_dataset_file(root)
    return [write_part(root, [episode], {"operation": operation}).id for episode in _each_once(root, episodes)]


def _each_once(root: Path, episodes: Iterable[Episode]) -> Iterator[Episode]:
    """Yield the episodes; refuse one that comes twice."""
    hashes: dict[str, str] = {}
    for episode in episodes:
        name = episode.meta.id
        if hashes.setdefault(name, encode.content_hash(episode)) != encode.content_hash(episode):
            raise DataError(
                "an episode comes twice, with different content",
                where=Where(path=str(root), episode=name),
                fix="import the sources one by one, or give their episodes other ids",
            )
        yield episode


def publish_replacing(path: str | Path, part_ids: Iterable[str], lineage: Lineage) -> VersionFile:
    """Return the version that holds these parts in place of the episodes with their ids.

    Raises
    ------
    DataError
        When a part is missing or damaged.
    UsageError
        When there is no dataset.
    """
    root = Path(path)
    read_dataset_file(root)
    new_entries = [entry_of(root, part_id) for part_id in dict.fromkeys(part_ids)]
    return advance(root, lambda base: _next_version(root, base, new_entries, lineage))


def _next_version(root: Path, base: VersionFile | None, new_entries: list[PartEntry], lineage: Lineage) -> VersionFile:
    """Return the version after `base`; `base` itself where all the episodes stand as they are."""
    earlier_hashes = index_of(root, base.parts) if base else {}
    new_hashes = index_of(root, new_entries)
    if base and new_hashes.items() <= earlier_hashes.items():
        return base
    new_ids = {entry.id for entry in new_entries}
    old_entries = [entry for entry in base.parts if entry.id not in new_ids] if base else []
    kept_entries = [entry for old in old_entries for entry in _without(root, base, old, set(new_hashes))]
    parts = tuple(dict.fromkeys((*kept_entries, *new_entries)))
    index = index_of(root, parts)
    exclusions = tuple(name for name in base.exclusions if name in index) if base else ()
    earlier = base.lineage if base else ()
    return VersionFile(
        number=base.number + 1 if base else 1,
        parent=base.digest if base else None,
        parts=parts,
        exclusions=exclusions,
        digest=digest_of({name: digest for name, digest in index.items() if name not in exclusions}),
        lineage=(*earlier, lineage),
    )


def _without(root: Path, base: VersionFile | None, entry: PartEntry, ids: set[str]) -> Iterator[PartEntry]:
    """Yield the part as it stands without the episodes `ids`: itself, one with the others, or none."""
    names = [name for name, _ in RawPart(root, entry).manifest().episodes]
    if ids.isdisjoint(names):
        yield entry
        return
    data = open_dataset(root, base.number if base else None)
    visible = frozenset(data.ids)
    other_names = [name for name in names if name not in ids and name in visible]
    if other_names:
        yield entry_of(root, write_part(root, data.episodes(other_names), {"operation": "replace"}).id)
