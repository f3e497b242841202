"""What a pull is going to do: read from the remote and checked whole, before anything is written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from candata.datasets.names import is_name, require_files, require_hash, require_name, require_part
from candata.datasets.parts import EPISODES, MANIFEST, STEPS, part_id_of
from candata.datasets.remotes import (
    corrupted,
    object_key,
    parse,
    read_key,
    read_object,
    read_remote_version,
    remote_numbers,
    version_key,
)
from candata.datasets.store import Store
from candata.datasets.versions import DATASET, digest_of
from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.schema.json_text import parse_json
from candata.schema.manifest import FORMAT_VERSION, DatasetFile, FileEntry, PartEntry, PartFile, TagFile, VersionFile
from candata.schema.registry import RemoteVersion

#: Splits and tags that are looked at; a remote with more is not one of candata's.
_MANY = 10_000
_SMALL_BYTES = 2**20


@dataclass(frozen=True)
class Plan:
    """Everything that a version needs, checked before anything is written.

    Attributes
    ----------
    head : bytes
        `dataset.json`.
    record : RemoteVersion
        The version.
    parts : mapping of str to (bytes, PartFile)
        Part id to its manifest.
    splits : mapping of str to FileEntry
        Hash and size of each split.
    tags : mapping of str to TagFile
        Those that name this version.
    episodes : int
        Episodes of the version.
    """

    head: bytes
    record: RemoteVersion
    parts: dict[str, tuple[bytes, PartFile]]
    splits: dict[str, FileEntry]
    tags: dict[str, TagFile]
    episodes: int


def number_of(store: Store, name: str, version: int | str | None) -> int:
    """Return the number of the version that is meant: a number, the start of a digest, or a tag.

    Raises
    ------
    UnknownNameError
        When the remote has no such dataset; lists those it has.
    UsageError
        When there is no such version.
    """
    there = remote_numbers(store, name)
    if not there:
        raise UnknownNameError("dataset on the remote", name, store.folders(), Where(path=store.url))
    if version is None or version in there:
        return there[-1] if version is None else int(version)
    if isinstance(version, str) and is_name(version):
        data = read_key(store, f"{name}/tags/{version}.json", _SMALL_BYTES)
        if data is not None:
            return parse(TagFile, store, f"{name}/tags/{version}.json", data).version
    if isinstance(version, str) and len(version) >= 6:
        for number in reversed(there):
            if read_remote_version(store, name, number).version.digest.startswith(version):
                return number
    raise UsageError(
        f"no version {version} on the remote",
        expected=f"a number from {there[0]} to {there[-1]}, the start of a digest, or a tag",
        where=Where(path=f"{store.url}/{name}"),
    )


def plan_of(store: Store, name: str, number: int) -> Plan:
    """Return what a version needs; everything that names a file is checked here.

    Raises
    ------
    DataError
        When a file is damaged, of another format, has a name or size that cannot be, or claims what others deny.
    """
    head = _head(store, name)
    record = read_remote_version(store, name, number)
    where = f"{store.url}/{version_key(name, number)}"
    parts: dict[str, tuple[bytes, PartFile]] = {}
    for entry in record.version.parts:
        require_part(entry.id, where)
        require_hash("a part", entry.sha256, where)
        if entry.id in parts:
            raise corrupted(store, version_key(name, number), f"the part {entry.id} twice")
        parts[entry.id] = _part(store, name, entry)
    for cloud in record.clouds:
        _require_cloud(cloud, where)
    _require_parent(store, name, record.version)
    members = _members(store, name, record.version, [part for _, part in parts.values()])
    splits = _splits(store, name)
    _require_sizes(store, name, [*(file for _, part in parts.values() for file in part.files), *record.clouds,
                                 *splits.values()])  # fmt: skip
    tags = {tag: one for tag, one in _tags(store, name).items() if one.version == number}
    for tag, one in tags.items():
        if one.digest != record.version.digest:
            raise corrupted(store, f"{name}/tags/{tag}.json", f"digest {one.digest[:12]!r} of version {number}")
    return Plan(head, record, parts, splits, tags, len(members))


def _members(store: Store, name: str, version: VersionFile, parts: Sequence[PartFile]) -> dict[str, str]:
    """Return id to content hash of a version's episodes, whose digest and exclusions fit its parts."""
    key = version_key(name, version.number)
    excluded = set(version.exclusions)
    unknown = excluded - {episode for part in parts for episode, _ in part.episodes}
    if unknown or len(excluded) < len(version.exclusions):
        raise corrupted(store, key, f"exclusions of {len(unknown)} unknown episodes, or one twice")
    members: dict[str, str] = {}
    for episode, digest in (pair for part in parts for pair in part.episodes if pair[0] not in excluded):
        if members.setdefault(episode, digest) != digest:
            raise corrupted(store, key, f"two contents of one episode {episode!r}"[:200])
    found = digest_of(members)
    if found != version.digest:
        raise corrupted(store, key, f"digest {found[:12]} of its episodes")
    return members


def _require_parent(store: Store, name: str, version: VersionFile) -> None:
    """Refuse a version that names another one than stands before it."""
    key, before = version_key(name, version.number), version.number - 1
    if (version.parent is None) != (before == 0):
        raise corrupted(store, key, f"parent {version.parent!r} of version {version.number}"[:200])
    if before in remote_numbers(store, name):
        parent = read_remote_version(store, name, before).version.digest
        if version.parent != parent:
            raise corrupted(store, key, f"parent {version.parent!r}; version {before} is {parent[:12]}"[:200])


def _require_sizes(store: Store, name: str, files: Iterable[FileEntry]) -> None:
    """Refuse sizes that are not those of the remote's files."""
    there = store.sizes(f"{name}/objects")
    for file in files:
        if there.get(file.sha256) != file.bytes:
            size = there.get(file.sha256)
            found = "no such object" if size is None else f"{size} bytes, not {file.bytes}"
            raise corrupted(store, object_key(name, file.sha256), found)


def _head(store: Store, name: str) -> bytes:
    """Return `dataset.json` of the remote, of a format that is known."""
    key = f"{name}/{DATASET}"
    data = read_key(store, key, _SMALL_BYTES * 4)
    if data is None:
        raise corrupted(store, key, "no such file")
    try:
        found = parse_json(data)["format_version"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise corrupted(store, key, "no format version") from None
    if not isinstance(found, int) or isinstance(found, bool):
        raise corrupted(store, key, f"format version {found!r}"[:200])
    if found != FORMAT_VERSION:
        newer = found > FORMAT_VERSION
        raise DataError(
            f"the dataset has {'a newer' if newer else 'an older'} format",
            expected=f"format {FORMAT_VERSION}", found=f"format {found}"[:200], where=Where(path=f"{store.url}/{key}"),
            fix="install a newer candata" if newer else "push it again from a copy that candata migrate made",
        )  # fmt: skip
    parse(DatasetFile, store, key, data)
    return data


def _part(store: Store, name: str, entry: PartEntry) -> tuple[bytes, PartFile]:
    """Return the manifest of a part, whose files have plain names, hashes and sizes, and whose counts add up."""
    data = read_object(store, name, entry.sha256)
    key = object_key(name, entry.sha256)
    part = parse(PartFile, store, key, data)
    if part.id != entry.id:
        raise corrupted(store, key, f"part {part.id!r}"[:200])
    where = f"{store.url}/{key}"
    require_files([MANIFEST, *(file.path for file in part.files)], where)
    lacking = {STEPS, EPISODES} - {file.path for file in part.files}
    if lacking:
        raise corrupted(store, key, f"a part without {', '.join(sorted(lacking))}")
    for file in part.files:
        require_hash("a file", file.sha256, where)
        _require_size(file, where)
    for _, digest in part.episodes:
        require_hash("an episode", digest, where)
    counts, held = (entry.rows, entry.episodes), (part.rows, len(part.episodes))
    if counts != held:
        raise corrupted(store, key, f"{held[0]} rows, {held[1]} episodes; its version claims {counts[0]}, {counts[1]}")
    if len(dict(part.episodes)) < len(part.episodes):
        raise corrupted(store, key, "an episode twice")
    if part_id_of(list(part.episodes)) != part.id:
        raise corrupted(store, key, f"other episodes than those of part {part.id}")
    return data, part


def _require_cloud(cloud: FileEntry, where: str) -> None:
    """Refuse a point cloud that is not kept as `objects/<sha256>.parquet`."""
    folder, _, file = cloud.path.partition("/")
    if folder != "objects" or not file.endswith(".parquet"):
        raise DataError(
            "a point cloud has a name that cannot be kept", expected="objects/<sha256>.parquet",
            found=repr(cloud.path)[:200], where=Where(path=where),
        )  # fmt: skip
    require_hash("a point cloud", file.removesuffix(".parquet"), where)
    require_hash("a file", cloud.sha256, where)
    _require_size(cloud, where)


def _require_size(file: FileEntry, where: str) -> None:
    """Refuse a size below zero."""
    if file.bytes < 0:
        raise DataError("a file has no size", found=f"{file.bytes} bytes", where=Where(path=where))


def _small(store: Store, name: str, folder: str) -> Iterator[tuple[str, str, bytes]]:
    """Yield name, key and bytes of the JSON files of a folder of the remote, whose names are plain."""
    listed = sorted(store.sizes(f"{name}/{folder}"))
    if len(listed) > _MANY:
        raise DataError(f"too many {folder} on the remote", expected=f"{_MANY} at most", found=str(len(listed)))
    require_files(listed, f"{store.url}/{name}/{folder}")
    for file in (file for file in listed if file.endswith(".json")):
        key = f"{name}/{folder}/{file}"
        yield require_name(folder[:-1], file.removesuffix(".json")), key, read_key(store, key, _SMALL_BYTES) or b""


def _splits(store: Store, name: str) -> dict[str, FileEntry]:
    """Return hash and size of the splits, by name."""
    found = {split: parse(FileEntry, store, key, data) for split, key, data in _small(store, name, "splits")}
    for split, entry in found.items():
        require_hash("a split", entry.sha256, f"{store.url}/{name}/splits/{split}.json")
    return found


def _tags(store: Store, name: str) -> dict[str, TagFile]:
    """Return the tags, by name."""
    found = {tag: (key, parse(TagFile, store, key, data)) for tag, key, data in _small(store, name, "tags")}
    for tag, (key, one) in found.items():
        if one.name != tag:
            raise corrupted(store, key, f"a tag {one.name!r}"[:200])
    return {tag: one for tag, (_, one) in found.items()}
