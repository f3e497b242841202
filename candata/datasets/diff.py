"""What two versions differ in: a set difference of (episode id, content hash)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from candata.datasets.dataset import Dataset
from candata.datasets.versions import members_of


@dataclass(frozen=True)
class Difference:
    """Episode ids, sorted, by what happened to them from the first version to the second.

    `changed` ids stand in both with different content; `same` counts those that are equal.
    """

    added: tuple[str, ...]
    removed: tuple[str, ...]
    changed: tuple[str, ...]
    same: int

    @property
    def equal(self) -> bool:
        """Whether both hold the same episodes."""
        return not (self.added or self.removed or self.changed)


def diff(first: Dataset, second: Dataset) -> Difference:
    """Return what leads from one version to another, of one dataset or two; no episode is read.

    Raises
    ------
    DataError
        When a part is damaged.
    """
    return difference(members_of(first.path, first.file), members_of(second.path, second.file))


def difference(first: Mapping[str, str], second: Mapping[str, str]) -> Difference:
    """Return what leads from one mapping of id to content hash to another."""
    both = first.keys() & second.keys()
    changed = {name for name in both if first[name] != second[name]}
    return Difference(
        added=tuple(sorted(second.keys() - both)),
        removed=tuple(sorted(first.keys() - both)),
        changed=tuple(sorted(changed)),
        same=len(both) - len(changed),
    )
