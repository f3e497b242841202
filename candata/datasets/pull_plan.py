"""What a pull is going to do: read from the remote and checked whole, before anything is written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from candata.datasets.names import is_name, require_files, require_hash, require_name, require_part
from candata.datasets.parts import EPISODES, MANIFEST, STEPS, part_id_of
from candata.datasets.remotes import (
    corrupted_error,
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
_MOST_FILES = 10_000
_SMALL_BYTES = 2**20


@dataclass(frozen=True)
class PullPlan:
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
    version_numbers = remote_numbers(store, name)
    if not version_numbers:
        raise UnknownNameError("dataset on the remote", name, store.folders(), Where(path=store.url))
    if version is None or version in version_numbers:
        return version_numbers[-1] if version is None else int(version)
    if isinstance(version, str) and is_name(version):
        data = read_key(store, f"{name}/tags/{version}.json", _SMALL_BYTES)
        if data is not None:
            return parse(TagFile, store, f"{name}/tags/{version}.json", data).version
    if isinstance(version, str) and len(version) >= 6:
        for number in reversed(version_numbers):
            if read_remote_version(store, name, number).version.digest.startswith(version):
                return number
    raise UsageError(
        f"no version {version} on the remote",
        expected=f"a number from {version_numbers[0]} to {version_numbers[-1]}, the start of a digest, or a tag",
        where=Where(path=f"{store.url}/{name}"),
    )


def plan_of(store: Store, name: str, number: int) -> PullPlan:
    """Return what a version needs; everything that names a file is checked here.

    Raises
    ------
    DataError
        When a file is damaged, of another format, has a name or size that cannot be, or claims what others deny.
    """
    head = _head(store, name)
    record = read_remote_version(store, name, number)
    location = f"{store.url}/{version_key(name, number)}"
    parts: dict[str, tuple[bytes, PartFile]] = {}
    for entry in record.version.parts:
        require_part(entry.id, location)
        require_hash("a part", entry.sha256, location)
        if entry.id in parts:
            raise corrupted_error(store, version_key(name, number), f"the part {entry.id} twice")
        parts[entry.id] = _part(store, name, entry)
    for cloud in record.clouds:
        _require_cloud(cloud, location)
    _require_parent(store, name, record.version)
    members = _members(store, name, record.version, [part for _, part in parts.values()])
    splits = _splits(store, name)
    _require_sizes(
        store, name, [*(file for _, part in parts.values() for file in part.files), *record.clouds, *splits.values()]
    )
    tags = {tag: tag_file for tag, tag_file in _tags(store, name).items() if tag_file.version == number}
    for tag, tag_file in tags.items():
        if tag_file.digest != record.version.digest:
            raise corrupted_error(
                store, f"{name}/tags/{tag}.json", f"digest {tag_file.digest[:12]!r} of version {number}"
            )
    return PullPlan(head, record, parts, splits, tags, len(members))


def _members(store: Store, name: str, version: VersionFile, parts: Sequence[PartFile]) -> dict[str, str]:
    """Return id to content hash of a version's episodes, whose digest and exclusions fit its parts."""
    key = version_key(name, version.number)
    excluded_ids = set(version.exclusions)
    unknown_ids = excluded_ids - {episode for part in parts for episode, _ in part.episodes}
    if unknown_ids or len(excluded_ids) < len(version.exclusions):
        raise corrupted_error(store, key, f"exclusions of {len(unknown_ids)} unknown episodes, or one twice")
    members: dict[str, str] = {}
    for episode, digest in (pair for part in parts for pair in part.episodes if pair[0] not in excluded_ids):
        if members.setdefault(episode, digest) != digest:
            raise corrupted_error(store, key, f"two contents of one episode {episode!r}"[:200])
    version_digest = digest_of(members)
    if version_digest != version.digest:
        raise corrupted_error(store, key, f"digest {version_digest[:12]} of its episodes")
    return members


def _require_parent(store: Store, name: str, version: VersionFile) -> None:
    """Refuse a version that names another one than stands before it."""
    key, previous_number = version_key(name, version.number), version.number - 1
    if (version.parent is None) != (previous_number == 0):
        raise corrupted_error(store, key, f"parent {version.parent!r} of version {version.number}"[:200])
    if previous_number in remote_numbers(store, name):
        parent = read_remote_version(store, name, previous_number).version.digest
        if version.parent != parent:
            raise corrupted_error(
                store, key, f"parent {version.parent!r}; version {previous_number} is {parent[:12]}"[:200]
            )


def _require_sizes(store: Store, name: str, files: Iterable[FileEntry]) -> None:
    """Refuse sizes that are not those of the remote's files."""
    remote_sizes = store.sizes(f"{name}/objects")
    for file in files:
        if remote_sizes.get(file.sha256) != file.bytes:
            size = remote_sizes.get(file.sha256)
            size_text = "no such object" if size is None else f"{size} bytes, not {file.bytes}"
            raise corrupted_error(store, object_key(name, file.sha256), size_text)


def _head(store: Store, name: str) -> bytes:
    """Return `dataset.json` of the remote, of a format that is known."""
    key = f"{name}/{DATASET}"
    data = read_key(store, key, _SMALL_BYTES * 4)
    if data is None:
        raise corrupted_error(store, key, "no such file")
    try:
        format_version = parse_json(data)["format_version"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise corrupted_error(store, key, "no format version") from None
    if not isinstance(format_version, int) or isinstance(format_version, bool):
        raise corrupted_error(store, key, f"format version {format_version!r}"[:200])
    if format_version != FORMAT_VERSION:
        is_newer = format_version > FORMAT_VERSION
        raise DataError(
            f"the dataset has {'a newer' if is_newer else 'an older'} format",
            expected=f"format {FORMAT_VERSION}",
            found=f"format {format_version}"[:200],
            where=Where(path=f"{store.url}/{key}"),
            fix="install a newer candata" if is_newer else "push it again from a copy that candata migrate made",
        )
    parse(DatasetFile, store, key, data)
    return data


def _part(store: Store, name: str, entry: PartEntry) -> tuple[bytes, PartFile]:
    """Return the manifest of a part, whose files have plain names, hashes and sizes, and whose counts add up."""
    data = read_object(store, name, entry.sha256)
    key = object_key(name, entry.sha256)
    part = parse(PartFile, store, key, data)
    if part.id != entry.id:
        raise corrupted_error(store, key, f"part {part.id!r}"[:200])
    location = f"{store.url}/{key}"
    require_files([MANIFEST, *(file.path for file in part.files)], location)
    missing_files = {STEPS, EPISODES} - {file.path for file in part.files}
    if missing_files:
        raise corrupted_error(store, key, f"a part without {', '.join(sorted(missing_files))}")
    for file in part.files:
        require_hash("a file", file.sha256, location)
        _require_size(file, location)
    for _, digest in part.episodes:
        require_hash("an episode", digest, location)
    counts, manifest_counts = (entry.rows, entry.episodes), (part.rows, len(part.episodes))
    if counts != manifest_counts:
        raise corrupted_error(
            store,
            key,
            f"{manifest_counts[0]} rows, {manifest_counts[1]} episodes; its version claims {counts[0]}, {counts[1]}",
        )
    if len(dict(part.episodes)) < len(part.episodes):
        raise corrupted_error(store, key, "an episode twice")
    if part_id_of(list(part.episodes)) != part.id:
        raise corrupted_error(store, key, f"other episodes than those of part {part.id}")
    return data, part


def _require_cloud(cloud: FileEntry, location: str) -> None:
    """Refuse a point cloud that is not kept as `objects/<sha256>.parquet`."""
    folder, _, file = cloud.path.partition("/")
    if folder != "objects" or not file.endswith(".parquet"):
        raise DataError(
            "a point cloud has a name that cannot be kept",
            expected="objects/<sha256>.parquet",
            found=repr(cloud.path)[:200],
            where=Where(path=location),
        )
    require_hash("a point cloud", file.removesuffix(".parquet"), location)
    require_hash("a file", cloud.sha256, location)
    _require_size(cloud, location)


def _require_size(file: FileEntry, location: str) -> None:
    """Refuse a size below zero."""
    if file.bytes < 0:
        raise DataError("a file has no size", found=f"{file.bytes} bytes", where=Where(path=location))


def _small_files(store: Store, name: str, folder: str) -> Iterator[tuple[str, str, bytes]]:
    """Yield name, key and bytes of the JSON files of a folder of the remote, whose names are plain."""
    file_names = sorted(store.sizes(f"{name}/{folder}"))
    if len(file_names) > _MOST_FILES:
        raise DataError(
            f"too many {folder} on the remote", expected=f"{_MOST_FILES} at most", found=str(len(file_names))
        )
    require_files(file_names, f"{store.url}/{name}/{folder}")
    for file in (file for file in file_names if file.endswith(".json")):
        key = f"{name}/{folder}/{file}"
        yield require_name(folder[:-1], file.removesuffix(".json")), key, read_key(store, key, _SMALL_BYTES) or b""


def _splits(store: Store, name: str) -> dict[str, FileEntry]:
    """Return hash and size of the splits, by name."""
    entries = {split: parse(FileEntry, store, key, data) for split, key, data in _small_files(store, name, "splits")}
    for split, entry in entries.items():
        require_hash("a split", entry.sha256, f"{store.url}/{name}/splits/{split}.json")
    return entries


def _tags(store: Store, name: str) -> dict[str, TagFile]:
    """Return the tags, by name."""
    tag_files = {tag: (key, parse(TagFile, store, key, data)) for tag, key, data in _small_files(store, name, "tags")}
    for tag, (key, tag_file) in tag_files.items():
        if tag_file.name != tag:
            raise corrupted_error(store, key, f"a tag {tag_file.name!r}"[:200])
    return {tag: tag_file for tag, (_, tag_file) in tag_files.items()}
