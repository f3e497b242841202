"""Garbage: what no version or tag reaches, removed once it is old enough to belong to nobody."""

from __future__ import annotations

import itertools
import os
import re
import stat
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from candata.datasets import durable
from candata.datasets.parts import MANIFEST, RawPart
from candata.datasets.tags import read_tags
from candata.datasets.versions import numbers, read_dataset_file, read_version, version_path
from candata.errors import DataError, UsageError
from candata.schema.json_text import parse_json
from candata.schema.manifest import PartEntry, VersionFile

Kind = Literal["version", "part", "staging", "catalog", "cloud", "cache"]

#: Age below which nothing is removed: longer than any job between writing a part and publishing it.
GRACE_S = 7 * 86_400.0

_PART, _UUID = re.compile(r"[0-9a-f]{32}"), re.compile(r"[0-9a-f]{32}")
_HASHED_TABLE = re.compile(r"[0-9a-f]{64}\.parquet")


@dataclass(frozen=True)
class Garbage:
    """One thing that is, or would be, removed.

    Attributes
    ----------
    kind : str
        What it is.
    path : str
        Where it lies, as seen from the dataset.
    bytes : int
        What removing it frees; files that another dataset shares free nothing.
    """

    kind: Kind
    path: str
    bytes: int


@dataclass(frozen=True)
class Collection:
    """What `collect_garbage` removed, and what it left because of doubt.

    Attributes
    ----------
    removed : tuple of Garbage
        Removed, or with `dry_run` what would be.
    waiting : tuple of Garbage
        Out of reach, but within the grace period.
    notes : tuple of str
        What was not looked at, and why.
    """

    removed: tuple[Garbage, ...]
    waiting: tuple[Garbage, ...]
    notes: tuple[str, ...] = ()

    @property
    def bytes(self) -> int:
        """Bytes freed."""
        return sum(item.bytes for item in self.removed)


@dataclass(frozen=True)
class _Reach:
    """What the versions that stay need."""

    parts: dict[str, PartEntry]
    digests: frozenset[str]


def collect_garbage(
    path: str | Path, *, grace_s: float = GRACE_S, keep: int | None = None, dry_run: bool = False
) -> Collection:
    """Return what was removed: parts, staging, catalogs, clouds and caches that no version or tag reaches.

    Nothing younger than the grace period goes, by its time of change on that file system: a job may be about to
    publish it. A part is held while it is published, so a grace period longer than the publishing itself loses
    nothing; one shorter than a job makes that job fail at its end. Only what candata itself wrote is touched.

    Parameters
    ----------
    path : str or Path
        Dataset.
    grace_s : float
        Grace period [s].
    keep : int, optional
        Versions to keep: the newest so many, those that are tagged, and those that were the newest within the grace
        period. By default every version stays.
    dry_run : bool
        Remove nothing.

    Raises
    ------
    UsageError
        When there is no dataset, or a number is out of range.
    SetupError
        When the folder cannot be written.
    DataError
        When a version or a tag is damaged: then nobody knows what it reaches.
    """
    root = Path(path)
    read_dataset_file(root)
    if grace_s < 0 or (keep is not None and keep < 1):
        raise UsageError("out of range", expected="grace >= 0, keep >= 1", found=f"grace {grace_s:g} s, keep {keep}")
    with durable.writing(root):
        deadline = _clock(root) - grace_s
        versions = {version_path(root, number).name: read_version(root, number) for number in numbers(root)}
        retired_versions = _retire(root, keep, deadline, dry_run)
        retired_names = {Path(item.path).name for item in retired_versions}
        reach = _reach(version for name, version in versions.items() if name not in retired_names)
        candidates = [*_parts(root, reach), *_staging_leftovers(root), *_catalogs(root, reach), *_caches(root, reach)]
        removed_items = _collect(root, candidates, deadline, dry_run)
        clouds, notes = _clouds(root, reach, {Path(item.path).name for item in removed_items})
        removed_items += _collect(root, clouds, deadline, dry_run)
    waiting_items = [
        item for item in [*candidates, *clouds] if item not in removed_items and (root / item.path).exists()
    ]
    return Collection((*retired_versions, *removed_items), tuple(waiting_items), notes)


def collect_staging(root: Path, grace_s: float = GRACE_S) -> None:
    """Remove what stopped writers left in `root/staging`, once it is older than the grace period [s]."""
    leftovers = list(_staging_leftovers(root))
    if leftovers:
        _collect(root, leftovers, _clock(root) - grace_s, dry_run=False)


def _collect(root: Path, candidates: list[Garbage], deadline: float, dry_run: bool) -> list[Garbage]:
    """Remove what has not changed since `deadline`; return what went."""
    if dry_run:
        return [item for item in candidates if _change_time(root / item.path) < deadline]
    removed_items = []
    for item in candidates:
        with durable.removal_lock(root):  # what is published meanwhile is seen here, or its publishing fails
            if _change_time(root / item.path) < deadline and _remove(root, [item], deadline):
                removed_items.append(item)
    return removed_items


def _clock(root: Path) -> float:
    """Return the time by the clock of the file system, which stamps the files; the host's where it cannot be asked."""
    try:
        with durable.staging_folder(root) as folder:
            return folder.stat().st_mtime
    except OSError:
        return time.time()


def _retire(root: Path, keep: int | None, deadline: float, dry_run: bool) -> list[Garbage]:
    """Return the versions that were, or would be, removed."""
    if dry_run or keep is None:
        return _retired_versions(root, keep, deadline)
    with durable.removal_lock(root):
        retired_versions = _retired_versions(root, keep, deadline)
        _remove(root, retired_versions)
    return retired_versions


def _retired_versions(root: Path, keep: int | None, deadline: float) -> list[Garbage]:
    """Return the versions beyond the newest `keep` that no tag names and that were superseded before that time."""
    version_numbers = numbers(root)
    if keep is None:
        return []
    tagged_numbers = {tag.version for tag in read_tags(root).values()}
    return [
        _garbage(root, "version", version_path(root, number))
        for number, successor in itertools.pairwise(version_numbers[: len(version_numbers) - keep + 1])
        if number not in tagged_numbers and _change_time(version_path(root, successor)) < deadline
    ]


def _reach(versions: Iterable[VersionFile]) -> _Reach:
    """Return what some versions need."""
    kept_versions = list(versions)
    parts = {entry.id: entry for version in kept_versions for entry in version.parts}
    return _Reach(parts, frozenset(version.digest for version in kept_versions))


def _parts(root: Path, reach: _Reach) -> Iterator[Garbage]:
    """Yield parts that no version names."""
    for path in _entries(root / "parts"):
        if _PART.fullmatch(path.name) and path.name not in reach.parts and _own_folder(path):
            yield _garbage(root, "part", path)


def _staging_leftovers(root: Path) -> Iterator[Garbage]:
    """Yield what stopped writers left, in the dataset and in its cache."""
    for home in (root / durable.STAGING_FOLDER, root / "cache" / durable.STAGING_FOLDER):
        for path in _entries(home):
            if (_UUID.fullmatch(path.name) or path.name == durable.PULL_FOLDER) and _own_folder(path):
                yield _garbage(root, "staging", path)


def _catalogs(root: Path, reach: _Reach) -> Iterator[Garbage]:
    """Yield catalogs of no version."""
    for path in _entries(root / "catalog"):
        if _HASHED_TABLE.fullmatch(path.name) and path.stem not in reach.digests:
            yield _garbage(root, "catalog", path)


def _caches(root: Path, reach: _Reach) -> Iterator[Garbage]:
    """Yield training caches of no version, and those that do not say of which they are."""
    for path in _entries(root / "cache"):
        if not path.name.startswith("windows-") or not _own_folder(path):
            continue
        try:
            digest = parse_json((path / "cache.json").read_bytes())["cache"]["digest"]
        except (OSError, ValueError, KeyError, TypeError):
            digest = None
        if digest not in reach.digests:
            yield _garbage(root, "cache", path)


def _clouds(root: Path, reach: _Reach, removed_names: set[str]) -> tuple[list[Garbage], tuple[str, ...]]:
    """Return clouds that no episode of a standing part names; none, and why, where a part cannot be read."""
    clouds = [path for path in _entries(root / "objects") if _HASHED_TABLE.fullmatch(path.name)]
    if not clouds:
        return [], ()
    if (root / "parts").is_symlink():
        return [], ("point clouds stay: the folder of the parts is a link, which is not followed",)
    part_ids = {path.name for path in _entries(root / "parts") if (path / MANIFEST).is_file()} - removed_names
    named_clouds: set[str] = set()
    try:
        for part_id in part_ids | set(reach.parts):
            entry = PartEntry(id=part_id, sha256="", rows=0, episodes=0)
            metas = RawPart(root, entry).table()["meta"].to_pylist()
            named_clouds |= {parse_json(meta).get("point_cloud") for meta in metas}
    except (DataError, ValueError, AttributeError, TypeError) as error:
        reason = str(error).splitlines()[0]
        return [], (f"point clouds stay: a part that may name them cannot be read ({reason})",)
    return [_garbage(root, "cloud", path) for path in clouds if path.stem not in named_clouds], ()


def _entries(folder: Path) -> list[Path]:
    """Return what lies in a folder, sorted; nothing where there is none, or where it is a link to elsewhere."""
    return sorted(folder.iterdir()) if _own_folder(folder) else []


def _own_folder(path: Path) -> bool:
    """Tell whether a path is a folder and no link."""
    return path.is_dir() and not path.is_symlink()


def _tree(path: Path) -> list[os.stat_result]:
    """Return the state of a file or folder and of all in it; what goes meanwhile is left out."""
    inner_paths = [Path(home, name) for home, folders, files in os.walk(path) for name in folders + files]
    states = []
    for entry in [path, *inner_paths]:
        try:
            states.append(entry.lstat())
        except FileNotFoundError:
            continue
    return states


def _change_time(path: Path) -> float:
    """Return the last time at which a file, or anything in a folder, changed; infinity if it is gone."""
    return max((state.st_mtime for state in _tree(path)), default=float("inf"))


def _garbage(root: Path, kind: Kind, path: Path) -> Garbage:
    """Return a file or folder as garbage."""
    files = [state for state in _tree(path) if not stat.S_ISDIR(state.st_mode) and state.st_nlink == 1]
    return Garbage(kind, path.relative_to(root).as_posix(), sum(state.st_size for state in files))


def _remove(root: Path, garbage: Iterable[Garbage], deadline: float = float("inf")) -> bool:
    """Return whether all of the garbage was removed: each item is moved aside first, then deleted.

    A part or cloud that somebody touched since it was judged is put back: it is being published, where folders cannot
    be locked.
    """
    went = True
    with durable.staging_folder(root) as folder:
        for number, item in enumerate(garbage):
            path, moved_path = root / item.path, folder / str(number)
            try:
                os.rename(path, moved_path)
            except FileNotFoundError:
                went = False
                continue
            if _change_time(moved_path) >= deadline:
                os.rename(moved_path, path)
                went = False
    return went
