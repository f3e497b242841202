"""Pulling a dataset: everything is checked by hash, and the version is published last."""

from __future__ import annotations

import hashlib
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from candata.datasets import durable
from candata.datasets.names import require_name
from candata.datasets.parts import MANIFEST, RawPart, part_folder
from candata.datasets.pull_plan import Plan, number_of, plan_of
from candata.datasets.remotes import (
    Bar,
    Store,
    corrupted,
    move,
    no_bar,
    object_key,
    read_object,
    read_remote_version,
    remote_numbers,
)
from candata.datasets.tags import read_tags, tag_path
from candata.datasets.versions import (
    DATASET,
    newest,
    numbers,
    read_dataset_file,
    read_version,
    refuse_foreign,
    version_path,
)
from candata.errors import DataError, SetupError, UsageError, Where
from candata.schema.manifest import VersionFile

#: Room that is left on the disk.
_SPARE_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Pulled:
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


def pull(store: Store, name: str, out: str | Path, version: int | str | None = None, bar: Bar = no_bar) -> Pulled:
    """Return what was fetched so that `out` holds a version of a dataset, by default the newest.

    A pull that was killed goes on where it stopped. Nothing is written outside `out`, whatever the remote holds.

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
    bar : callable
        Shows the progress in bytes.

    Raises
    ------
    UnknownNameError
        When the remote has no such dataset; lists those it has.
    UsageError
        When there is no such version, or the folder holds something else.
    DataError
        When a file of the remote is damaged or has a name that cannot be kept; when `out` has another history.
    SetupError
        When the remote cannot be used, or the disk has no room.
    """
    root = Path(out)
    require_name("dataset", name)
    plan = plan_of(store, name, number_of(store, name, version))
    _prepare(root, store, name, plan)
    with durable.alone(root):  # a second pull waits, and finds what the first has fetched
        return _pull(store, name, root, plan, bar)


def _pull(store: Store, name: str, root: Path, plan: Plan, bar: Bar) -> Pulled:
    """Fetch what the folder lacks and publish the version."""
    files = _missing(root, plan)
    todo = [one for one in files if not _stands(one)]
    _require_room(root, sum(one.bytes for one in todo))
    _fetch(store, name, root, todo, bar)
    for entry in plan.record.version.parts:
        _commit(root, entry.id, plan.parts[entry.id][0])
    splits = tuple(_keep_splits(root, store, name, plan))
    _publish(root, plan.record.version)
    tags, notes = _keep_tags(root, plan)
    shutil.rmtree(_waiting(root), ignore_errors=True)
    found = plan.record.version
    return Pulled(
        path=root, version=found.number, digest=found.digest, episodes=plan.episodes, objects=len(todo),
        bytes=sum(one.bytes for one in todo), standing=_count(plan) - len(todo), splits=splits, tags=tags, notes=notes,
    )  # fmt: skip


def _prepare(root: Path, store: Store, name: str, plan: Plan) -> None:
    """Make the folder, or refuse one that holds something else or another history."""
    refuse_foreign(root)
    for folder in ("parts", "versions", "objects", "splits", "tags", durable.STAGING):
        if (root / folder).is_symlink():
            raise UsageError("a folder of the dataset leads out of it", where=Where(path=str(root / folder)))
    _require_history(root, store, name, plan.record.version)
    for entry in plan.record.version.parts:
        if part_folder(root, entry.id).is_dir():
            part = RawPart(root, entry)
            problem = part.size_problem(part.manifest())
            if problem:
                raise problem
    durable.ensure_folder(root)
    durable.create_once(root, root / DATASET, plan.head)
    read_dataset_file(root)


def _require_history(root: Path, store: Store, name: str, version: VersionFile) -> None:
    """Refuse a folder whose versions are not those of the remote."""
    here, there = numbers(root), remote_numbers(store, name)
    common = sorted(set(here) & set(there))
    if common:
        known = version if version.number == common[-1] else read_remote_version(store, name, common[-1]).version
        if read_version(root, common[-1]) != known:
            raise _diverged(root, known, read_version(root, common[-1]))
    last = newest(root)
    if last and not common and (last.number + 1, last.digest) != (version.number, version.parent):
        raise _diverged(root, version, last)


def _diverged(root: Path, there: VersionFile, here: VersionFile) -> DataError:
    """Return the error for a folder with another history."""
    return DataError(
        "the folder has another history of this dataset",
        expected=f"version {there.number}, digest {there.digest[:12]} (on the remote)",
        found=f"version {here.number}, digest {here.digest[:12]}",
        where=Where(path=str(root)),
        fix="pull to another folder; `candata registry merge` joins the two",
    )


def _waiting(root: Path) -> Path:
    """Return the folder where files wait until their part is whole; the same for each pull, so that it goes on."""
    return root / durable.STAGING / durable.PULLING


def _missing(root: Path, plan: Plan) -> list[_File]:
    """Return the files that the folder lacks."""
    files = []
    for entry in plan.record.version.parts:
        if not part_folder(root, entry.id).is_dir():
            folder = _waiting(root) / entry.id
            files += [_File(folder / one.path, one.bytes, one.sha256) for one in plan.parts[entry.id][1].files]
    clouds = [_File(root / one.path, one.bytes, one.sha256) for one in plan.record.clouds]
    return files + [one for one in clouds if not one.target.is_file()]


def _count(plan: Plan) -> int:
    """Return how many files the version has, manifests left out."""
    return sum(len(part.files) for _, part in plan.parts.values()) + len(plan.record.clouds)


def _stands(one: _File) -> bool:
    """Return whether an earlier pull has fetched a file whole."""
    target = one.target
    if target.is_symlink() or not target.is_file() or target.stat().st_size != one.bytes:
        return False
    return durable.file_sha256(target) == one.sha256


def _require_room(root: Path, size: int) -> None:
    """Refuse what the disk cannot hold."""
    free = shutil.disk_usage(root).free
    if size + _SPARE_BYTES > free:
        raise SetupError(
            "the disk has no room for this", expected=f"{(size + _SPARE_BYTES) / 1e6:.0f} MB",
            found=f"{free / 1e6:.0f} MB free", where=Where(path=str(root)), fix="make room, or choose another folder",
        )  # fmt: skip


def _fetch(store: Store, name: str, root: Path, todo: list[_File], bar: Bar) -> None:
    """Fetch files, a few at a time."""
    move(
        lambda advance: (partial(_fetch_one, store, object_key(name, one.sha256), root, one, advance) for one in todo),
        sum(one.bytes for one in todo),
        bar,
    )


def _fetch_one(store: Store, key: str, root: Path, one: _File, advance: Callable[[int], None]) -> None:
    """Fetch one file; it appears under its name only when it has its hash."""
    one.target.parent.mkdir(parents=True, exist_ok=True)
    if not one.target.parent.resolve().is_relative_to(root.resolve()):
        raise UsageError("a folder of the dataset leads out of it", where=Where(path=str(one.target.parent)))
    draft = durable.ensure_folder(_waiting(root)) / uuid.uuid4().hex  # no part can take what a killed pull left
    try:
        with draft.open("xb") as file:
            digest = _copy(store, key, one.bytes, file.write, advance)
            file.flush()
            os.fsync(file.fileno())
        if digest != one.sha256:
            raise corrupted(store, key, f"sha256 {digest[:12]}")
        draft.replace(one.target)
    finally:
        draft.unlink(missing_ok=True)


def _copy(store: Store, key: str, size: int, write: Callable[[bytes], int], advance: Callable[[int], None]) -> str:
    """Return the sha256 of an object that was written out; refuse one of another size."""
    digest, found = hashlib.sha256(), 0
    try:
        for chunk in store.read(key):
            found += len(chunk)
            if found > size:
                break
            digest.update(chunk)
            write(chunk)
            advance(len(chunk))
    except FileNotFoundError:
        raise corrupted(store, key, "no such object") from None
    if found != size:
        raise corrupted(store, key, f"{'more than ' if found > size else ''}{min(found, size)} bytes of {size}")
    return digest.hexdigest()


def _commit(root: Path, part_id: str, manifest: bytes) -> None:
    """Move a part among the others once it is whole, `part.json` written last."""
    folder, target = _waiting(root) / part_id, part_folder(root, part_id)
    if target.is_dir():
        return
    (folder / MANIFEST).write_bytes(manifest)
    durable.sync(folder / MANIFEST)
    for path in [*(p for p in folder.rglob("*") if p.is_dir()), folder]:
        durable.sync(path)
    durable.ensure_folder(target.parent)
    try:
        os.rename(folder, target)
    except OSError:
        if not target.is_dir():
            raise
    durable.sync(target.parent)


def _keep_splits(root: Path, store: Store, name: str, plan: Plan) -> Iterator[str]:
    """Keep the splits, byte for byte; yield their names."""
    for split, entry in plan.splits.items():
        data = read_object(store, name, entry.sha256)
        path = root / "splits" / f"{split}.json"
        if not durable.create_once(root, path, data) and durable.read_bytes(path) != data:
            raise DataError(
                f"another split is called {split}", where=Where(path=str(path)),
                fix="pull to another folder: a split that models were trained on must not change",
            )  # fmt: skip
        yield split


def _publish(root: Path, version: VersionFile) -> None:
    """Create the version's file, the last thing of all."""
    made = durable.create_once(root, version_path(root, version.number), durable.encode_record(version))
    if not made and read_version(root, version.number) != version:
        raise _diverged(root, version, read_version(root, version.number))


def _keep_tags(root: Path, plan: Plan) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Keep the tags of the version that was pulled; one that stands for another version stays, with a note."""
    standing = read_tags(root)
    notes = []
    for name, tag in plan.tags.items():
        if name not in standing:
            durable.create_once(root, tag_path(root, name), durable.encode_record(tag))
        elif standing[name] != tag:
            notes.append(f"the tag {name} stands for version {standing[name].version} here and was left so")
    return tuple(sorted(plan.tags)), tuple(notes)
