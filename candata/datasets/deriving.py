"""New datasets from parts that stand: linked, not copied, where the file system can."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from candata.datasets import durable
from candata.datasets.clouds import cloud_path
from candata.datasets.dataset import Dataset
from candata.datasets.drafts import draft_beside, place, refuse_standing
from candata.datasets.names import require_files, require_hash, require_part
from candata.datasets.parts import MANIFEST, RawPart, entry_of, part_folder
from candata.datasets.versions import advance, create_dataset, digest_of, index_of
from candata.schema.manifest import Lineage, PartEntry, VersionFile

_CLOUD = re.compile(r'"point_cloud":"([^"]*)"')


#: Takes a dataset that is whole but for what stands beside its parts, such as splits, and puts that there.
Finish = Callable[[Path], None]


def nothing_more(root: Path) -> None:
    """Put nothing beside the parts."""


@contextmanager
def new_dataset(out: Path, finish: Finish = nothing_more) -> Iterator[Path]:
    """Give an empty dataset beside `out`, which becomes `out` once the block and `finish` end well; else it is removed.

    Raises
    ------
    UsageError
        When `out` stands.
    """
    refuse_standing(out)
    with draft_beside(out) as folder:
        root = create_dataset(folder / "dataset", name=out.resolve().name)
        yield root
        finish(root)
        place(root, out)


def link_part(part: RawPart, root: Path) -> PartEntry:
    """Return the entry of a part that now stands in the dataset `root` too, linked or else copied.

    A part is never changed, so that both datasets may share its files; deleting one leaves the other.

    Raises
    ------
    DataError
        When the part is damaged, or names files outside it.
    """
    manifest = part.manifest()
    require_part(part.entry.id, str(part.folder))
    require_files([file.path for file in manifest.files], str(part.folder / MANIFEST))
    problem = part.size_problem(manifest)
    if problem:
        raise problem
    target = part_folder(root, part.entry.id)
    if not target.is_dir():
        durable.ensure_below(root, target.parent)
        with durable.staging_folder(root) as folder:
            for name in (MANIFEST, *(file.path for file in manifest.files)):
                _link(part.folder / name, folder / name)
            durable.sync(folder)
            _move(folder, target)
        durable.sync(target.parent)
    return entry_of(root, part.entry.id)


def _move(folder: Path, target: Path) -> None:
    """Rename a finished folder, unless another process was first."""
    try:
        os.rename(folder, target)
    except OSError:
        if not target.is_dir():
            raise


def _link(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where that cannot be."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
        durable.sync(target)


def clouds_of(dataset: Dataset) -> tuple[str, ...]:
    """Return the point clouds that the episodes of a version name, sorted.

    Raises
    ------
    DataError
        When one is no sha256.
    """
    records = dataset.catalog(["meta"])["meta"].to_pylist()
    # A quote inside a value is escaped, so that this finds keys alone; parsing 100,000 records takes a second.
    hashes = {match[1] for text in records if (match := _CLOUD.search(text))}
    return tuple(sorted(require_hash("a point cloud", sha, str(dataset.path)) for sha in hashes))


def link_clouds(dataset: Dataset, root: Path) -> None:
    """Link the point clouds of a version into the dataset `root`.

    Raises
    ------
    DataError
        When one is missing.
    """
    for sha in clouds_of(dataset):
        source, target = cloud_path(dataset.path, sha), cloud_path(root, sha)
        if not source.is_file():
            raise durable.damaged_error(source, "no such file")
        if not target.is_file():
            durable.ensure_below(root, target.parent)
            _link(source, target)


def publish_first(root: Path, entries: Iterable[PartEntry], exclusions: Iterable[str], lineage: Lineage) -> VersionFile:
    """Return the first version of a new dataset, of parts that stand.

    Parameters
    ----------
    root : Path
        Dataset without a version.
    entries : iterable of PartEntry
        Its parts.
    exclusions : iterable of str
        Episodes of these parts that the version leaves out.
    lineage : Lineage
        How it came to be.
    """
    parts = tuple(entries)
    excluded_ids = frozenset(exclusions)
    index = {name: digest for name, digest in index_of(root, parts).items() if name not in excluded_ids}
    version = VersionFile(
        number=1, parts=parts, exclusions=tuple(sorted(excluded_ids)), digest=digest_of(index), lineage=(lineage,)
    )
    return advance(root, lambda base: base or version)
