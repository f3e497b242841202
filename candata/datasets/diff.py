"""What two versions differ in: episodes by id, equal where their contents are."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from candata.datasets.dataset import Dataset, EpisodePlace


@dataclass(frozen=True)
class VersionDifference:
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
    def is_equal(self) -> bool:
        """Whether both hold the same episodes."""
        return not (self.added or self.removed or self.changed)


def diff(
    first_version: Dataset,
    second_version: Dataset,
    trust_manifests: bool = False,
    progress: Callable[[int], None] = lambda count: None,
) -> VersionDifference:
    """Return what leads from one version to another, of one dataset or two.

    Episodes of one id are read and hashed anew in both, but for those that lie in the same files.

    Parameters
    ----------
    first_version, second_version : Dataset
        The versions.
    trust_manifests : bool
        Believe the hashes that manifests claim; no episode is read.
    progress : callable
        Called with the number of ids just compared.

    Raises
    ------
    DataError
        When a part is damaged.
    """
    claims = [
        {name: place.content_hash for name, place in dataset.places.items()}
        for dataset in (first_version, second_version)
    ]
    if trust_manifests:
        return _difference(*claims)
    doubtful = sorted(ids_to_read(first_version, second_version))
    progress(len(first_version.places.keys() & second_version.places.keys()) - len(doubtful))
    misstated_ids: set[str] = set()
    for dataset, claim, step in zip((first_version, second_version), claims, (0, 1), strict=True):
        for name, digest in dataset.contents(doubtful):
            misstated_ids |= {name} if digest != claim[name] else set()
            claim[name] = digest
            progress(step)
    difference = _difference(*claims)
    return VersionDifference(
        difference.added, difference.removed, difference.changed, difference.same, tuple(sorted(misstated_ids))
    )


def ids_to_read(first_version: Dataset, second_version: Dataset) -> set[str]:
    """Return the ids of both versions that lie in other files, or elsewhere in them: only reading can compare these."""
    same_files = lru_cache(maxsize=None)(_same_files)

    def lies_in_same_files(first_place: EpisodePlace, second_place: EpisodePlace) -> bool:
        return first_place.position == second_place.position and same_files(
            first_place.part.folder, second_place.part.folder
        )

    common_ids = first_version.places.keys() & second_version.places.keys()
    return {
        name for name in common_ids if not lies_in_same_files(first_version.places[name], second_version.places[name])
    }


def _same_files(first_folder: Path, second_folder: Path) -> bool:
    """Tell whether two folders of parts are one, or hold the same files under two names."""
    files_by_folder = [
        {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()}
        for folder in (first_folder, second_folder)
    ]
    return files_by_folder[0].keys() == files_by_folder[1].keys() and all(
        os.path.samefile(p, files_by_folder[1][name]) for name, p in files_by_folder[0].items()
    )


def _difference(first_hashes: Mapping[str, str], second_hashes: Mapping[str, str]) -> VersionDifference:
    """Return what leads from one mapping of id to content hash to another."""
    common_ids = first_hashes.keys() & second_hashes.keys()
    changed_ids = {name for name in common_ids if first_hashes[name] != second_hashes[name]}
    return VersionDifference(
        added=tuple(sorted(second_hashes.keys() - common_ids)),
        removed=tuple(sorted(first_hashes.keys() - common_ids)),
        changed=tuple(sorted(changed_ids)),
        same=len(common_ids) - len(changed_ids),
    )
