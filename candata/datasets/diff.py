"""What two versions differ in: episodes by id, equal where their contents are."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from candata.datasets.dataset import Dataset, Place


@dataclass(frozen=True)
class Difference:
    """Episode ids, sorted, by what happened to them from the first version to the second.

    `changed` ids stand in both with different content; `same` counts those that are equal. `misstated` ids have a
    content that is not what the manifests of one of the two claim.
    """

    added: tuple[str, ...]
    removed: tuple[str, ...]
    changed: tuple[str, ...]
    same: int
    misstated: tuple[str, ...] = ()

    @property
    def equal(self) -> bool:
        """Whether both hold the same episodes."""
        return not (self.added or self.removed or self.changed)


def diff(
    first: Dataset, second: Dataset, quick: bool = False, progress: Callable[[int], None] = lambda count: None
) -> Difference:
    """Return what leads from one version to another, of one dataset or two.

    Episodes of one id are read and hashed anew in both, but for those that lie in the same files.

    Parameters
    ----------
    first, second : Dataset
        The versions.
    quick : bool
        Believe the hashes that manifests claim; no episode is read.
    progress : callable
        Called with the number of ids just compared.

    Raises
    ------
    DataError
        When a part is damaged.
    """
    claims = [{name: place.content_hash for name, place in dataset.places.items()} for dataset in (first, second)]
    if quick:
        return _difference(*claims)
    doubtful = sorted(apart(first, second))
    progress(len(first.places.keys() & second.places.keys()) - len(doubtful))
    misstated: set[str] = set()
    for dataset, claim, step in zip((first, second), claims, (0, 1), strict=True):
        for name, digest in dataset.contents(doubtful):
            misstated |= {name} if digest != claim[name] else set()
            claim[name] = digest
            progress(step)
    found = _difference(*claims)
    return Difference(found.added, found.removed, found.changed, found.same, tuple(sorted(misstated)))


def apart(first: Dataset, second: Dataset) -> set[str]:
    """Return the ids of both versions that lie in other files, or elsewhere in them: only reading can compare these."""
    same_files = lru_cache(maxsize=None)(_same_files)

    def shared(one: Place, other: Place) -> bool:
        return one.position == other.position and same_files(one.part.folder, other.part.folder)

    both = first.places.keys() & second.places.keys()
    return {name for name in both if not shared(first.places[name], second.places[name])}


def _same_files(one: Path, other: Path) -> bool:
    """Tell whether two folders of parts are one, or hold the same files under two names."""
    held = [{str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()} for folder in (one, other)]
    return held[0].keys() == held[1].keys() and all(os.path.samefile(p, held[1][name]) for name, p in held[0].items())


def _difference(first: Mapping[str, str], second: Mapping[str, str]) -> Difference:
    """Return what leads from one mapping of id to content hash to another."""
    both = first.keys() & second.keys()
    changed = {name for name in both if first[name] != second[name]}
    return Difference(
        added=tuple(sorted(second.keys() - both)),
        removed=tuple(sorted(first.keys() - both)),
        changed=tuple(sorted(changed)),
        same=len(both) - len(changed),
    )
