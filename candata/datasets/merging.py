"""One dataset from several: parts linked, equal episodes counted once."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from candata.datasets.adding import write_parts
from candata.datasets.dataset import Dataset, changed_error, open_dataset
from candata.datasets.deriving import Finish, link_clouds, link_part, new_dataset, nothing_more, publish_first
from candata.datasets.diff import ids_to_read
from candata.datasets.history import derived_lineage
from candata.datasets.parts import RawPart, entry_of, write_part
from candata.datasets.versions import advance, digest_of, index_of, newest_version, publish, read_dataset_file
from candata.errors import DataError, UsageError, Where
from candata.schema.episode import Episode
from candata.schema.manifest import Lineage, PartEntry, VersionFile

_OPERATION = "merge"
_LISTED_CLASHES = 10


def merge(datasets: Sequence[Dataset], out: Path, prefix: bool = False, finish: Finish = nothing_more) -> VersionFile:
    """Return the version of a new dataset `out` that holds the episodes of all of `datasets`.

    Parts are shared with them, not rewritten. The lineage names all of them and keeps theirs. Episodes of one id that
    lie in different files are read, and compared by what they hold.

    Parameters
    ----------
    datasets : sequence of Dataset
        Two or more versions.
    out : Path
        Folder of the new dataset.
    prefix : bool
        Put the dataset's name before each id, `NAME-ID`: every episode is written anew.
    finish : callable
        Takes the new dataset before it appears; `candata.loaders.carry_splits` makes one.

    Raises
    ------
    DataError
        When an id stands for different content in two of them; lists them. When a part is damaged.
    UsageError
        When there are fewer than two, `out` stands, or `prefix` is given two datasets of one name.
    """
    if len(datasets) < 2:
        raise UsageError("nothing to merge", expected="two datasets or more", found=str(len(datasets)))
    lineage = derived_lineage(_OPERATION, datasets, {"prefix": True} if prefix else {})
    if prefix:
        return _merge_prefixed(datasets, out, lineage, finish)
    _require_as_claimed(datasets)
    members = _members(datasets)
    with new_dataset(out, finish) as root:
        entries = {entry.id: entry for dataset in datasets for entry in _entries(dataset, members, root)}
        for dataset in datasets:
            link_clouds(dataset, root)
        hidden_ids = index_of(root, entries.values()).keys() - members.keys()
        return publish_first(root, entries.values(), hidden_ids, lineage)


def merge_into(datasets: Sequence[Dataset], out: Path) -> VersionFile:
    """Return a new version of the dataset `out` with the episodes of `datasets`; the newest if they add nothing.

    An episode that `out` had left out and that one of `datasets` holds comes back.

    Raises
    ------
    DataError
        When an id stands for different content; when a part is damaged.
    UsageError
        When `out` is no dataset, or there is nothing to add.
    """
    read_dataset_file(out)
    if not datasets:
        raise UsageError("nothing to merge", expected="a dataset or more", found="0")
    current = newest_version(out)
    _require_as_claimed([*([open_dataset(out)] if current else []), *datasets])
    _members(datasets, index_of(out, current.parts) if current else None)
    entries = {entry.id: entry for dataset in datasets for entry in _entries(dataset, None, out)}
    for dataset in datasets:
        link_clouds(dataset, out)
    lineage = derived_lineage(_OPERATION, datasets, {})
    return advance(out, lambda base: _merged_version(datasets, out, base, list(entries.values()), lineage))


def _merged_version(
    datasets: Sequence[Dataset], out: Path, base: VersionFile | None, entries: Sequence[PartEntry], lineage: Lineage
) -> VersionFile:
    """Return the version after `base` with what `datasets` add; `base` itself if they add nothing."""
    standing_hashes = index_of(out, base.parts) if base else {}
    excluded_ids = frozenset(base.exclusions if base else ())
    members = _members(datasets, standing_hashes)
    new_entries = [entry for entry in entries if index_of(out, [entry]).keys() - standing_hashes.keys()]
    restored_ids = excluded_ids & _members(datasets).keys()
    if base and not new_entries and not restored_ids:
        return base
    left_out = excluded_ids - restored_ids
    return VersionFile(
        number=base.number + 1 if base else 1,
        parent=base.digest if base else None,
        parts=(*(base.parts if base else ()), *new_entries),
        exclusions=tuple(sorted(left_out)),
        digest=digest_of({name: digest for name, digest in members.items() if name not in left_out}),
        lineage=(*(base.lineage if base else ()), lineage),
    )


def _require_as_claimed(datasets: Sequence[Dataset]) -> None:
    """Refuse episodes whose content is not what manifests claim, among ids that stand in different files of several."""
    doubtful: list[set[str]] = [set() for _ in datasets]
    for (i, first_dataset), (j, second_dataset) in itertools.combinations(enumerate(datasets), 2):
        ids = ids_to_read(first_dataset, second_dataset)
        doubtful[i] |= ids
        doubtful[j] |= ids
    for dataset, ids in zip(datasets, doubtful, strict=True):
        for name, digest in dataset.contents(ids):
            if digest != dataset.places[name].content_hash:
                raise changed_error(dataset.places[name], name, digest)


def _members(datasets: Sequence[Dataset], known_hashes: dict[str, str] | None = None) -> dict[str, str]:
    """Return id to content hash of all; refuse ids that stand for different content."""
    members: dict[str, str] = dict(known_hashes or {})
    clashes: dict[str, None] = {}
    for dataset in datasets:
        for name, place in dataset.places.items():
            if members.setdefault(name, place.content_hash) != place.content_hash:
                clashes[name] = None
    if clashes:
        clash_list = ", ".join(list(clashes)[:_LISTED_CLASHES]) + (", ..." if len(clashes) > _LISTED_CLASHES else "")
        raise DataError(
            "one id stands for different episodes",
            expected="different ids, or equal content",
            found=f"{len(clashes)} ids: {clash_list}",
            where=Where(path=", ".join(str(dataset.path) for dataset in datasets)),
            fix="look at them with `candata registry diff`; --prefix puts the dataset's name before every id",
        )
    return members


def _entries(dataset: Dataset, members: dict[str, str] | None, root: Path) -> Iterator[PartEntry]:
    """Yield the parts of a version as they stand in `root`.

    A part is written anew where it holds an episode that its version leaves out and the merged one cannot, as an
    exclusion goes by id: another dataset has that id in `members`, or (None) the merged version takes no exclusions.
    """
    excluded_ids = frozenset(dataset.file.exclusions)
    for part in dataset.raw_parts():
        part_hashes = dict(part.manifest().episodes)
        hidden_ids = part_hashes.keys() & excluded_ids
        if hidden_ids and (
            members is None or any(members.get(name, part_hashes[name]) != part_hashes[name] for name in hidden_ids)
        ):
            yield _rewrite_part(dataset, part, [name for name in part_hashes if name not in excluded_ids], root)
        else:
            yield link_part(part, root)


def _rewrite_part(dataset: Dataset, part: RawPart, names: list[str], root: Path) -> PartEntry:
    """Return a new part with some episodes of an old one."""
    producer = {**part.manifest().producer, "rewritten": _OPERATION}
    return entry_of(root, write_part(root, dataset.episodes(names), producer).id)


def _merge_prefixed(datasets: Sequence[Dataset], out: Path, lineage: Lineage, finish: Finish) -> VersionFile:
    """Return the merged version whose ids begin with the dataset's name."""
    repeated_names = [name for name, count in Counter(dataset.name for dataset in datasets).items() if count > 1]
    if repeated_names:
        raise UsageError(
            f"two datasets are called {repeated_names[0]}",
            expected="different names",
            fix="merge without --prefix",
        )
    with new_dataset(out, finish) as root:
        for dataset in datasets:
            link_clouds(dataset, root)
        return publish(root, write_parts(root, _prefix_ids(datasets), _OPERATION), lineage)


def _prefix_ids(datasets: Sequence[Dataset]) -> Iterator[Episode]:
    """Yield all episodes, `NAME-` before their ids."""
    for dataset in datasets:
        for episode in dataset.episodes():
            meta = episode.meta.model_copy(update={"id": f"{dataset.name}-{episode.meta.id}"})
            yield Episode(meta, episode.arrays)
