"""Pulling a dataset: everything is checked by its contents, and the version is published last."""

from __future__ import annotations

import hashlib
import os
import shutil
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from candata.datasets import durable
from candata.datasets.arrivals import (
    arrival_folder,
    check,
    diverged_error,
    keep,
    leave_nothing,
    missing_part_ids,
    other_split,
    split_path,
)
from candata.datasets.names import require_name
from candata.datasets.parts import RawPart, part_folder
from candata.datasets.pull_plan import PullPlan, number_of, plan_of
from candata.datasets.remotes import Bar, corrupted_error, move, no_bar, object_key, read_remote_version, remote_numbers
from candata.datasets.store import Store
from candata.datasets.versions import DATASET, newest_version, numbers, read_dataset_file, read_version, refuse_foreign
from candata.errors import DataError, SetupError, UsageError, Where
from candata.schema.manifest import VersionFile

#: Room that is left on the disk.
_SPARE_BYTES = 64 * 2**20


@dataclass(frozen=True)
class PullResult:
    """What a pull did.

    Attributes
    ----------
    path : Path
        Dataset.
    version : int
        Version that now stands there.
    digest : str
        Its digest.
    episodes : int
        Its episodes.
    objects, bytes : int
        Files that were fetched, and their size.
    standing : int
        Files that were there already.
    splits, tags : tuple of str
        Those of the remote that stand there now.
    notes : tuple of str
        What a person should know.
    """

    path: Path
    version: int
    digest: str
    episodes: int
    objects: int
    bytes: int
    standing: int
    splits: tuple[str, ...]
    tags: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _File:
    """A file to fetch: its path in the dataset, and where it waits until its part is whole."""

    target: Path
    bytes: int
    sha256: str


def pull(
    store: Store,
    name: str,
    out: str | Path,
    version: int | str | None = None,
    bar: Bar = no_bar,
    check_bar: Bar = no_bar,
) -> PullResult:
    """Return what was fetched so that `out` holds a version of a dataset, by default the newest.

    Nothing is believed that the remote claims: each file is hashed as it arrives, each episode of a part that arrives
    is decoded and hashed anew, and what does not fit is refused before anything but `staging` is written. A pull that
    was killed goes on where it stopped. Nothing is written outside `out`, whatever the remote holds.

    Parameters
    ----------
    store : Store
        Remote, from `open_remote`.
    name : str
        What the dataset is called there.
    out : str or Path
        Folder: missing, empty, or one that this dataset was pulled to before.
    version : int or str, optional
        Number, start of the digest, or tag.
    bar, check_bar : callable
        Show the progress in bytes of fetching and of checking.

    Raises
    ------
    UnknownNameError
        When the remote has no such dataset; lists those it has.
    UsageError
        When there is no such version, or the folder holds something else.
    DataError
        When a file of the remote is damaged, claims what is not so, or has a name that cannot be kept; when `out` has
        another history.
    SetupError
        When the remote cannot be used, or the disk has no room.
    """
    root = Path(out)
    require_name("dataset", name)
    plan = plan_of(store, name, number_of(store, name, version))
    _require_fits(root, store, name, plan)
    is_new_folder = not root.exists()
    durable.ensure_folder(root)
    with durable.exclusive_lock(root):  # a second pull waits, and finds what the first has fetched
        todo = [entry for entry in _missing_files(root, plan) if not _stands(entry)]
        _require_room(root, sum(entry.bytes for entry in todo))
        _fetch(store, name, root, todo, bar)
        try:
            check(store, name, root, plan, check_bar)
        except DataError:
            leave_nothing(root, is_new_folder)
            raise
        notes = keep(root, plan)
    pulled_version = plan.record.version
    return PullResult(
        path=root,
        version=pulled_version.number,
        digest=pulled_version.digest,
        episodes=plan.episodes,
        objects=len(todo),
        bytes=sum(entry.bytes for entry in todo),
        standing=_count(plan) - len(todo),
        splits=tuple(plan.splits),
        tags=tuple(sorted(plan.tags)),
        notes=notes,
    )


def _require_fits(root: Path, store: Store, name: str, plan: PullPlan) -> None:
    """Refuse a folder that holds something else, another history, or another split of a name that is asked for."""
    refuse_foreign(root)
    for folder in ("parts", "versions", "objects", "splits", "tags", durable.STAGING_FOLDER):
        if (root / folder).is_symlink():
            raise UsageError("a folder of the dataset leads out of it", where=Where(path=str(root / folder)))
    if (root / DATASET).exists():
        read_dataset_file(root)
    _require_history(root, store, name, plan.record.version)
    for entry in plan.record.version.parts:
        if part_folder(root, entry.id).is_dir():
            part = RawPart(root, entry)
            problem = part.size_problem(part.manifest())
            if problem:
                raise problem
    for split, file in plan.splits.items():
        path = split_path(root, split)
        if path.exists() and durable.file_sha256(path) != file.sha256:
            raise other_split(path)


def _require_history(root: Path, store: Store, name: str, version: VersionFile) -> None:
    """Refuse a folder whose versions are not those of the remote."""
    local_numbers, their_numbers = numbers(root), remote_numbers(store, name)
    common_numbers = sorted(set(local_numbers) & set(their_numbers))
    if common_numbers:
        expected_version = (
            version
            if version.number == common_numbers[-1]
            else read_remote_version(store, name, common_numbers[-1]).version
        )
        if read_version(root, common_numbers[-1]) != expected_version:
            raise diverged_error(root, expected_version, read_version(root, common_numbers[-1]))
    newest_local = newest_version(root)
    if (
        newest_local
        and not common_numbers
        and (newest_local.number + 1, newest_local.digest) != (version.number, version.parent)
    ):
        raise diverged_error(root, version, newest_local)


def _missing_files(root: Path, plan: PullPlan) -> list[_File]:
    """Return the files that the folder lacks."""
    wait = arrival_folder(root)
    files = [
        _File(part_folder(wait, part_id) / file.path, file.bytes, file.sha256)
        for part_id in missing_part_ids(root, plan)
        for file in plan.parts[part_id][1].files
    ]
    files += [_File(wait / c.path, c.bytes, c.sha256) for c in plan.record.clouds if not (root / c.path).is_file()]
    missing_splits = {name: file for name, file in plan.splits.items() if not split_path(root, name).exists()}
    return files + [_File(split_path(wait, name), file.bytes, file.sha256) for name, file in missing_splits.items()]


def _count(plan: PullPlan) -> int:
    """Return how many files the version has, manifests left out."""
    return sum(len(part.files) for _, part in plan.parts.values()) + len(plan.record.clouds) + len(plan.splits)


def _stands(entry: _File) -> bool:
    """Return whether an earlier pull has fetched a file whole."""
    target = entry.target
    if target.is_symlink() or not target.is_file() or target.stat().st_size != entry.bytes:
        return False
    return durable.file_sha256(target) == entry.sha256


def _require_room(root: Path, size: int) -> None:
    """Refuse what the disk cannot hold."""
    free = shutil.disk_usage(root).free
    if size + _SPARE_BYTES > free:
        raise SetupError(
            "the disk has no room for this",
            expected=f"{(size + _SPARE_BYTES) / 1e6:.0f} MB",
            found=f"{free / 1e6:.0f} MB free",
            where=Where(path=str(root)),
            fix="make room, or choose another folder",
        )


def _fetch(store: Store, name: str, root: Path, todo: list[_File], bar: Bar) -> None:
    """Fetch files, a few at a time."""
    move(
        lambda advance: (
            partial(_fetch_one, store, object_key(name, entry.sha256), root, entry, advance) for entry in todo
        ),
        sum(entry.bytes for entry in todo),
        bar,
    )


def _fetch_one(store: Store, key: str, root: Path, entry: _File, advance: Callable[[int], None]) -> None:
    """Fetch one file; it appears under its name only when it has its hash."""
    entry.target.parent.mkdir(parents=True, exist_ok=True)
    if not entry.target.parent.resolve().is_relative_to(root.resolve()):
        raise UsageError("a folder of the dataset leads out of it", where=Where(path=str(entry.target.parent)))
    draft = (
        durable.ensure_below(root, arrival_folder(root)) / uuid.uuid4().hex
    )  # no part can take what a killed pull left
    try:
        with draft.open("xb") as file:
            digest = _copy(store, key, entry.bytes, file.write, advance)
            file.flush()
            os.fsync(file.fileno())
        if digest != entry.sha256:
            raise corrupted_error(store, key, f"sha256 {digest[:12]}")
        draft.replace(entry.target)
    finally:
        draft.unlink(missing_ok=True)


def _copy(store: Store, key: str, size: int, write: Callable[[bytes], int], advance: Callable[[int], None]) -> str:
    """Return the sha256 of an object that was written out; refuse one of another size."""
    digest, byte_count = hashlib.sha256(), 0
    try:
        for chunk in store.read(key):
            byte_count += len(chunk)
            if byte_count > size:
                break
            digest.update(chunk)
            write(chunk)
            advance(len(chunk))
    except FileNotFoundError:
        raise corrupted_error(store, key, "no such object") from None
    if byte_count != size:
        raise corrupted_error(
            store, key, f"{'more than ' if byte_count > size else ''}{min(byte_count, size)} bytes of {size}"
        )
    return digest.hexdigest()
