"""Pushing a dataset: what the remote lacks, by hash; versions last, each created once."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from candata.datasets import durable
from candata.datasets.clouds import cloud_path
from candata.datasets.dataset import open_dataset
from candata.datasets.deriving import clouds_of
from candata.datasets.names import require_files, require_name
from candata.datasets.parts import MANIFEST, RawPart
from candata.datasets.remotes import (
    Bar,
    move,
    no_bar,
    object_key,
    parse,
    read_key,
    read_remote_version,
    remote_numbers,
    version_key,
)
from candata.datasets.store import CHUNK_BYTES, Store
from candata.datasets.tags import read_tags
from candata.datasets.versions import DATASET, numbers, read_dataset_file, read_version
from candata.errors import DataError, UsageError, Where
from candata.schema.manifest import FileEntry, TagFile, VersionFile
from candata.schema.registry import RemoteVersion


@dataclass(frozen=True)
class PushResult:
    """What a push did.

    Attributes
    ----------
    versions, splits, tags : tuple
        What is new on the remote.
    objects, bytes : int
        Files that were sent, and their size.
    standing : int
        Files that the remote had already.
    newest : VersionFile
        Newest version of the dataset.
    """

    versions: tuple[int, ...]
    splits: tuple[str, ...]
    tags: tuple[str, ...]
    objects: int
    bytes: int
    standing: int
    newest: VersionFile


@dataclass(frozen=True)
class _Object:
    """A file to send, and the hash it must have."""

    path: Path
    bytes: int
    sha256: str


def push(path: str | Path, store: Store, name: str, bar: Bar = no_bar, move_tags: bool = False) -> PushResult:
    """Return what was sent so that the remote holds every version, split and tag of a dataset.

    A push that was killed is invisible, and goes on where it stopped when it is started again.

    Parameters
    ----------
    path : str or Path
        Dataset.
    store : Store
        Remote, from `open_remote`.
    name : str
        What it is called there.
    bar : callable
        Shows the progress in bytes.
    move_tags : bool
        Let tags of the remote name other versions than they do.

    Raises
    ------
    DataError
        When the remote has another history, split or tag under this name; when a file of the dataset is damaged.
    UsageError
        When there is no dataset, or `name` cannot be one.
    SetupError
        When the remote cannot be used.
    """
    root = Path(path)
    require_name("dataset", name)
    head = durable.encode_record(read_dataset_file(root))
    open_dataset(root)  # refuses an empty or incomplete one in its own words
    versions = {number: read_version(root, number) for number in numbers(root)}
    missing_numbers = _missing_versions(store, name, versions, root)
    records = {number: _record(root, versions[number]) for number in missing_numbers}
    objects = _objects(root, versions.values(), records.values()) | _splits(root)
    remote_sizes = store.sizes(f"{name}/objects")
    todo = [entry for entry in objects.values() if remote_sizes.get(entry.sha256) != entry.bytes]
    store.tidy(name)
    _send(store, name, todo, bar)
    store.create(f"{name}/{DATASET}", head)
    for number, record in records.items():
        _publish(store, name, number, record, root)
    return PushResult(
        versions=tuple(missing_numbers),
        splits=tuple(_push_splits(root, store, name)),
        tags=tuple(_push_tags(root, store, name, move_tags)),
        objects=len(todo),
        bytes=sum(entry.bytes for entry in todo),
        standing=len(objects) - len(todo),
        newest=versions[max(versions)],
    )


def _missing_versions(store: Store, name: str, versions: dict[int, VersionFile], root: Path) -> list[int]:
    """Return the versions that the remote lacks, ascending; refuse a remote with another history."""
    their_numbers = remote_numbers(store, name)
    missing_numbers = sorted(versions.keys() - set(their_numbers))
    common_numbers = sorted(versions.keys() & set(their_numbers))
    if common_numbers:
        _require_same(store, name, versions[common_numbers[-1]], root)
    elif their_numbers and not _follows(store, name, versions[missing_numbers[0]], their_numbers):
        raise _diverged_error(
            store, name, root, f"versions {their_numbers[0]} to {their_numbers[-1]}", f"version {missing_numbers[0]}"
        )
    return missing_numbers


def _follows(store: Store, name: str, version: VersionFile, their_numbers: list[int]) -> bool:
    """Return whether a version comes right after the newest of the remote."""
    if version.number != their_numbers[-1] + 1:
        return False
    return read_remote_version(store, name, their_numbers[-1]).version.digest == version.parent


def _require_same(store: Store, name: str, version: VersionFile, root: Path) -> None:
    """Refuse a remote whose version of this number is another."""
    remote_version = read_remote_version(store, name, version.number).version
    if remote_version != version:
        label = f"version {version.number}, digest"
        raise _diverged_error(
            store, name, root, f"{label} {remote_version.digest[:12]}", f"{label} {version.digest[:12]}"
        )


def _diverged_error(store: Store, name: str, root: Path, remote_text: str, local_text: str) -> DataError:
    """Return the error for two histories under one name, with the way out."""
    return DataError(
        "the remote has another history of this dataset: nothing was published",
        expected=f"{remote_text} (on the remote)",
        found=f"{local_text} (in {root})",
        where=Where(path=f"{store.url}/{name}"),
        fix=f"pull {name} to a copy, add yours to it (`candata registry merge {root} --out COPY --append`) and push "
        "the copy; or push under another name with --name",
    )


def _record(root: Path, version: VersionFile) -> RemoteVersion:
    """Return what the remote keeps of a version."""
    entries = []
    for sha in clouds_of(open_dataset(root, version.number)):
        path = cloud_path(root, sha)
        if not path.is_file():
            raise durable.damaged_error(path, "no such file")
        relative = path.relative_to(root).as_posix()
        entries.append(FileEntry(path=relative, bytes=path.stat().st_size, sha256=durable.file_sha256(path)))
    return RemoteVersion(version=version, clouds=tuple(entries))


def _objects(root: Path, versions: Iterable[VersionFile], records: Iterable[RemoteVersion]) -> dict[str, _Object]:
    """Return every file of all versions, those the remote has too: one that lost bytes there is sent again."""
    parts = {entry.sha256: entry for version in versions for entry in version.parts}
    objects = {file.sha256: file for entry in parts.values() for file in _part_objects(RawPart(root, entry))}
    clouds = {cloud.sha256: cloud for record in records for cloud in record.clouds}
    return objects | {sha: _Object(root / cloud.path, cloud.bytes, sha) for sha, cloud in clouds.items()}


def _part_objects(part: RawPart) -> Iterator[_Object]:
    """Yield the files of a part."""
    manifest = part.manifest()
    require_files([file.path for file in manifest.files], str(part.folder / MANIFEST))
    path = part.folder / MANIFEST
    yield _Object(path, path.stat().st_size, part.entry.sha256)
    for file in manifest.files:
        yield _Object(part.folder / file.path, file.bytes, file.sha256)


def _splits(root: Path) -> dict[str, _Object]:
    """Return the files of the splits, by their hash."""
    paths = sorted((root / "splits").glob("*.json"))
    files = [_Object(path, path.stat().st_size, durable.file_sha256(path)) for path in paths]
    return {file.sha256: file for file in files}


def _send(store: Store, name: str, todo: list[_Object], bar: Bar) -> None:
    """Send files, a few at a time."""
    move(
        lambda advance: (
            partial(store.write, object_key(name, entry.sha256), _checked_bytes(entry, advance), entry.bytes)
            for entry in todo
        ),
        sum(entry.bytes for entry in todo),
        bar,
    )


def _checked_bytes(entry: _Object, advance: Callable[[int], None]) -> Iterator[bytes]:
    """Yield a file's bytes; raise at its end when they are not what the dataset promises, so that nothing is kept."""
    digest = hashlib.sha256()
    try:
        with entry.path.open("rb") as file:
            while chunk := file.read(CHUNK_BYTES):
                digest.update(chunk)
                yield chunk
                advance(len(chunk))
    except OSError as error:
        raise durable.damaged_error(entry.path, durable.reason(error)) from None
    if digest.hexdigest() != entry.sha256:
        raise durable.damaged_error(entry.path, f"sha256 {digest.hexdigest()[:12]}", f"sha256 {entry.sha256[:12]}")


def _publish(store: Store, name: str, number: int, record: RemoteVersion, root: Path) -> None:
    """Create a version on the remote; one that came first must be the same."""
    if not store.create(version_key(name, number), durable.encode_record(record)):
        _require_same(store, name, record.version, root)


def _push_splits(root: Path, store: Store, name: str) -> Iterator[str]:
    """Create the splits that the remote lacks; yield their names."""
    for path in sorted((root / "splits").glob("*.json")):
        key = f"{name}/splits/{require_name('split', path.stem)}.json"
        entry = FileEntry(path=path.name, bytes=path.stat().st_size, sha256=durable.file_sha256(path))
        if store.create(key, durable.encode_record(entry)):
            yield path.stem
        elif read_key(store, key) != durable.encode_record(entry):
            raise DataError(
                f"another split is called {path.stem} on the remote",
                where=Where(path=f"{store.url}/{key}"),
                fix="save yours under another name: a split that models were trained on must not change",
            )


def _push_tags(root: Path, store: Store, name: str, move: bool) -> Iterator[str]:
    """Create, or move, the tags that the remote lacks; yield their names."""
    for tag_name, tag in read_tags(root).items():
        key = f"{name}/tags/{require_name('tag', tag_name)}.json"
        data = durable.encode_record(tag)
        if store.create(key, data):
            yield tag_name
            continue
        remote_tag = parse(TagFile, store, key, read_key(store, key) or b"")
        if remote_tag == tag:
            continue
        if not move:
            raise UsageError(
                f"the tag {tag_name} names another version on the remote",
                expected=f"version {remote_tag.version}, digest {remote_tag.digest[:12]}",
                found=f"version {tag.version}, digest {tag.digest[:12]}",
                where=Where(path=f"{store.url}/{key}"),
                fix="push with --move-tags",
            )
        store.write(key, [data], len(data))
        yield tag_name
