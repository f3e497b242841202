"""Migration: a dataset of an older format, brought to the present one in a new folder.

A format version changes when older code would misread what newer code writes. Then `FORMAT_VERSION` is raised, and
`STEPS` takes one function that brings a copy of the version before to the new one. There is no older one yet.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from candata.datasets import durable
from candata.datasets.dataset import open_dataset
from candata.datasets.drafts import draft_beside, place, refuse_standing
from candata.datasets.versions import DATASET, format_of, numbers, version_path
from candata.errors import CandataError, DataError, UsageError, Where
from candata.schema.manifest import FORMAT_VERSION

#: Changes a copy of a dataset in place, from the format that is its key to the next.
Step = Callable[[Path], None]

#: Format version to the step that leaves it.
STEPS: Mapping[int, Step] = {}

#: What a dataset consists of; catalogs, caches and staging are made again.
_DATASET_ENTRIES = (DATASET, "parts", "objects", "versions", "splits", "tags")


@dataclass(frozen=True)
class Migration:
    """Format versions before and after; `done` is false where there was nothing to do."""

    old: int
    new: int
    done: bool


def migrate_dataset(
    path: str | Path, out: str | Path, *, steps: Mapping[int, Step] = STEPS, target: int = FORMAT_VERSION
) -> Migration:
    """Return what was done: a dataset of an older format stands at `out` in the present one; the old stays.

    It is copied beside `out`, changed step by step, opened version by version, and given its name last, so that a
    killed migration leaves nothing under that name. Where the dataset has the present format already, nothing is
    written.

    Parameters
    ----------
    path : str or Path
        Dataset of this or an older format.
    out : str or Path
        New folder.
    steps : mapping of int to callable
        Format version to the step that leaves it.
    target : int
        Format to reach.

    Raises
    ------
    UsageError
        When there is no dataset, or `out` exists.
    DataError
        When the format is newer, no step leads on from it, or the migrated dataset does not open.
    SetupError
        When `out` cannot be written.
    """
    root, home = Path(path), Path(out)
    old_format = format_of(root)
    if old_format > target:
        raise DataError(
            "the dataset has a newer format",
            expected=f"format {target} or an older one",
            found=f"format {old_format}",
            where=Where(path=str(root / DATASET)),
            fix="install a newer candata",
        )
    if old_format == target:
        return Migration(old_format, target, False)
    _refuse(root, home, old_format, target, steps)
    with durable.writing(home), draft_beside(home) as folder:
        draft = folder / "dataset"
        _copy(root, draft)
        for version in range(old_format, target):
            steps[version](draft)
        _check(draft, root, target)
        durable.sync_tree(draft)
        place(draft, home)
    return Migration(old_format, target, True)


def _refuse(root: Path, home: Path, old_format: int, target: int, steps: Mapping[int, Step]) -> None:
    """Refuse a target that exists or lies in the source, and a format from which no step leads on."""
    refuse_standing(home)
    if home.resolve().is_relative_to(root.resolve()):
        raise UsageError("the new dataset would lie inside the old one", where=Where(path=str(home)))
    missing_format = next((version for version in range(old_format, target) if version not in steps), None)
    if missing_format is not None:
        raise DataError(
            "no migration leads on from this format",
            expected=f"one of {', '.join(map(str, sorted(steps))) or 'none'}, or {target}",
            found=f"format {missing_format}",
            where=Where(path=str(root / DATASET)),
        )


def _copy(root: Path, draft: Path) -> None:
    """Copy what a dataset consists of; links are refused, as they may lead anywhere."""
    draft.mkdir()
    for name in _DATASET_ENTRIES:
        source = root / name
        for path in [source, *(source.rglob("*") if source.is_dir() else ())]:
            if path.is_symlink():
                raise DataError("a link in the dataset", expected="files and folders", where=Where(path=str(path)))
        if source.is_dir():
            shutil.copytree(source, draft / name)
        elif source.exists():
            shutil.copy2(source, draft / name)


def _check(draft: Path, root: Path, target: int) -> None:
    """Refuse a result that is not of the target's format, or of which a version does not open."""
    try:
        new_format = format_of(draft)
        if new_format == FORMAT_VERSION:
            for number in numbers(draft):
                open_dataset(draft, number)
    except CandataError as error:
        raise DataError("the migration failed", found=error.problem, where=Where(path=str(root))) from None
    if new_format != target or (numbers(root) and not version_path(draft, numbers(root)[-1]).is_file()):
        raise DataError("the migration failed", expected=f"format {target}", found=f"format {new_format}")
