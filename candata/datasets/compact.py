"""Compaction: the same episodes in few, full parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from candata.datasets import durable
from candata.datasets.dataset import Dataset, open_dataset
from candata.datasets.parts import RawPart, entry_of, part_folder, part_id_of, write_part
from candata.datasets.versions import advance, digest_of, index_of, version_path
from candata.errors import DataError, Where
from candata.schema.manifest import Lineage, PartEntry, VersionFile

#: Most episodes of a part.
EPISODES_PER_PART = 256

#: How often a compaction begins anew because others changed what it had read.
_ATTEMPTS = 20

#: Called with (episodes done, episodes in all).
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Compaction:
    """What a compaction did.

    Attributes
    ----------
    version : VersionFile
        The newest version, of the same content as before.
    before, after : int
        Parts of the version it began with, and of its own.
    left_out : int
        Excluded or repeated episodes that the new parts no longer hold.
    """

    version: VersionFile
    before: int
    after: int
    left_out: int


@dataclass(frozen=True)
class _Plan:
    """Ids of each new part, and the parts that they replace."""

    parts: tuple[tuple[str, ...], ...]
    replaced_ids: frozenset[str]
    left_out: int


def compact_dataset(
    path: str | Path, *, limit: int = EPISODES_PER_PART, progress: Progress = lambda done_count, total: None
) -> Compaction:
    """Return the newest version rewritten in parts of at most `limit` episodes; the same digest, the same episodes.

    Episodes with equal channels come together, in the order of their ids. Full parts stay as they are. What the
    version excludes is not taken along; it stays in the parts of older versions, which stand until `gc`. Others
    may append meanwhile: their parts stay. Killed, it has changed nothing; run again, it takes up the parts that
    it had finished.

    Parameters
    ----------
    path : str or Path
        Dataset.
    limit : int
        Most episodes of a part.
    progress : callable
        Called with (episodes done, episodes in all) after each new part.

    Raises
    ------
    UsageError
        When there is no dataset.
    SetupError
        When the folder cannot be written.
    DataError
        When the dataset is empty or damaged, or others change it faster than it can be rewritten.
    """
    root = Path(path)
    for _ in range(_ATTEMPTS):
        data = open_dataset(root)
        plan = _plan(data, limit)
        if not plan.replaced_ids:
            return Compaction(data.file, len(data.file.parts), len(data.file.parts), 0)
        with durable.writing(root):
            new_version = _rewrite(data, plan, progress)
        if new_version is not None:
            return Compaction(new_version, len(data.file.parts), len(new_version.parts), plan.left_out)
    raise DataError(
        "others change the dataset faster than it can be compacted",
        where=Where(path=str(root)),
        fix="run candata compact again when nobody compacts or filters it",
    )


def _rewrite(data: Dataset, plan: _Plan, progress: Progress) -> VersionFile | None:
    """Write the new parts and return the version that holds them; None where the plan no longer fits."""
    new_entries = _write(data, plan, progress)
    lineage = _lineage(data, plan, new_entries)
    new_version = advance(data.path, lambda base: _swap(data.path, base, data.file, plan, new_entries, lineage))
    part_ids = {entry.id for entry in new_version.parts}
    return new_version if {entry.id for entry in new_entries} <= part_ids and not plan.replaced_ids & part_ids else None


def _plan(data: Dataset, limit: int) -> _Plan:
    """Return what is to be rewritten: parts that are not full, hold too much, or hold what does not count."""
    ids_by_part: dict[str, list[str]] = {entry.id: [] for entry in data.file.parts}
    for name, place in data.places.items():
        ids_by_part[place.part.entry.id].append(name)
    groups: dict[tuple, list[RawPart]] = {}
    for part in data.raw_parts():
        if not part.entry.episodes == len(ids_by_part[part.entry.id]) == limit:
            groups.setdefault(tuple(part.layout().items()), []).append(part)
    batches: list[tuple[str, ...]] = []
    replaced_ids: set[str] = set()
    for parts in groups.values():
        ids = sorted(name for part in parts for name in ids_by_part[part.entry.id])
        new_batches = [tuple(ids[i : i + limit]) for i in range(0, len(ids), limit)]
        old_ids = {part.entry.id for part in parts}
        if {part_id_of(_pairs(data, batch)) for batch in new_batches} != old_ids:
            batches += new_batches
            replaced_ids |= old_ids
    held_count = sum(entry.episodes for entry in data.file.parts if entry.id in replaced_ids)
    return _Plan(tuple(batches), frozenset(replaced_ids), held_count - sum(map(len, batches)))


def _pairs(data: Dataset, ids: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return (episode id, content hash) of episodes."""
    return [(name, data.places[name].content_hash) for name in ids]


def _write(data: Dataset, plan: _Plan, progress: Progress) -> list[PartEntry]:
    """Write the new parts; one that a stopped compaction had finished is taken as it stands, if it is whole."""
    entries, done_count, total = [], 0, sum(map(len, plan.parts))
    for ids in plan.parts:
        part_id = part_id_of(_pairs(data, ids))
        if not part_folder(data.path, part_id).is_dir():
            write_part(data.path, data.episodes(ids), {"operation": "compact"})
        entry = entry_of(data.path, part_id)
        part = RawPart(data.path, entry)
        problem = part.changed_file(part.manifest())
        if problem:
            raise problem
        entries.append(entry)
        done_count += len(ids)
        progress(done_count, total)
    return entries


def _lineage(data: Dataset, plan: _Plan, new_entries: list[PartEntry]) -> Lineage:
    """Return what the lineage keeps of a compaction."""
    details = {"parts_before": len(plan.replaced_ids), "parts_after": len(new_entries), "left_out": plan.left_out}
    return Lineage(operation="compact", parents=(f"{data.name}@{data.digest}",), details=details)


def _swap(
    root: Path,
    base: VersionFile | None,
    read_version: VersionFile,
    plan: _Plan,
    new_entries: list[PartEntry],
    lineage: Lineage,
) -> VersionFile:
    """Return the version after `base` with the new parts for the old ones; `base` itself if that changed its content.

    Parts appended since stay. Where another compaction or filter came first, the plan no longer fits.
    """
    if base is None:
        raise durable.damaged_error(version_path(root, read_version.number), "no such file")
    if not plan.replaced_ids <= {entry.id for entry in base.parts}:
        return base
    other_entries = [entry for entry in base.parts if entry.id not in plan.replaced_ids]
    parts = (*other_entries, *(entry for entry in new_entries if entry not in other_entries))
    index = index_of(root, parts)
    exclusions = tuple(name for name in base.exclusions if name in index)
    digest = digest_of({name: content for name, content in index.items() if name not in set(exclusions)})
    if digest == base.digest:
        return VersionFile(
            number=base.number + 1,
            parent=base.digest,
            parts=parts,
            exclusions=exclusions,
            digest=digest,
            lineage=(*base.lineage, lineage),
        )
    if base == read_version:
        raise durable.damaged_error(
            version_path(root, base.number), f"digest {base.digest[:12]}", f"digest {digest[:12]}"
        )
    return base
