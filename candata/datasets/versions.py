"""Versions: which parts belong to a dataset, published one after the other, never changed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from candata.datasets import durable
from candata.datasets.parts import RawPart, entry_of, hold
from candata.datasets.tags import read_tags, tag_path
from candata.errors import DataError, UsageError, Where
from candata.schema.channels import CHANNELS
from candata.schema.json_text import parse_json
from candata.schema.manifest import FORMAT_VERSION, DatasetFile, Lineage, PartEntry, PartFile, TagFile, VersionFile

DATASET = "dataset.json"


def create_dataset(path: str | Path, name: str | None = None, exist_ok: bool = False) -> Path:
    """Return the folder of a new dataset without versions; `dataset.json` is written once.

    Parameters
    ----------
    path : str or Path
        Folder; made when missing.
    name : str, optional
        Name of the dataset; the folder's by default.
    exist_ok : bool
        Take a dataset that stands as it is.

    Raises
    ------
    UsageError
        When a dataset stands there and `exist_ok` is false, or the folder holds something else.
    DataError
        When the dataset that stands there cannot be read.
    """
    root = Path(path)
    refuse_foreign(root)
    record = DatasetFile(
        name=name or root.resolve().name,
        schema_channels=tuple(row.model_dump(mode="json") for row in CHANNELS.values()),
    )
    durable.ensure_folder(root)
    if not durable.create_once(root, root / DATASET, durable.encode_record(record)):
        if not exist_ok:
            raise UsageError(
                "the dataset exists already",
                where=Where(path=str(root)),
                fix="choose another folder, or append",
            )
        read_dataset_file(root)
    return root


def refuse_foreign(root: Path) -> None:
    """Refuse a path that is a file, a link that leads nowhere, or a folder with other things in it.

    Raises
    ------
    UsageError
        When it is one.
    """
    if root.is_symlink() and not root.exists():
        raise UsageError("a link that leads nowhere", where=Where(path=str(root)), fix="mount or make what it leads to")
    if root.exists() and not root.is_dir():
        raise UsageError("not a folder", expected="a folder", found="a file", where=Where(path=str(root)))
    if not root.is_dir():
        return
    foreign_names = sorted(p.name for p in root.iterdir() if p.name not in (durable.STAGING_FOLDER, DATASET))
    if foreign_names and not (root / DATASET).exists():  # asked last: another process may just have made it
        raise UsageError(
            "the folder is not empty and no dataset",
            expected="an empty or missing folder, or a dataset",
            found=", ".join(foreign_names[:5]),
            where=Where(path=str(root)),
            fix="choose another folder",
        )


def read_dataset_file(root: Path) -> DatasetFile:
    """Return `dataset.json`.

    Raises
    ------
    UsageError
        When `root` is no dataset.
    DataError
        When the file is damaged, or of a newer or older format.
    """
    format_version = format_of(root)
    if format_version != FORMAT_VERSION:
        is_newer = format_version > FORMAT_VERSION
        raise DataError(
            f"the dataset has {'a newer' if is_newer else 'an older'} format",
            expected=f"format {FORMAT_VERSION}",
            found=f"format {format_version}",
            where=Where(path=str(root / DATASET)),
            fix="install a newer candata" if is_newer else f"candata migrate {root} --out NEW",
        )
    return durable.read_record(DatasetFile, root / DATASET)


def format_of(root: Path) -> int:
    """Return the format version that a dataset says it has, whether this code knows it or not.

    Raises
    ------
    UsageError
        When `root` is no dataset.
    DataError
        When `dataset.json` does not say.
    """
    path = root / DATASET
    if not path.is_file():
        raise UsageError(
            "not a dataset",
            expected=f"a folder with {DATASET}",
            where=Where(path=str(root)),
            fix="check the path",
        )
    try:
        format_version = parse_json(durable.read_bytes(path))["format_version"]
    except (ValueError, KeyError, TypeError) as error:
        raise durable.damaged_error(path, f"no format version: {durable.reason(error)}") from None
    if not isinstance(format_version, int) or isinstance(format_version, bool):
        raise durable.damaged_error(path, f"format version {format_version!r}", "a whole number")
    return format_version


def numbers(root: Path) -> list[int]:
    """Return the numbers of all versions, ascending."""
    return sorted(int(p.stem) for p in (root / "versions").glob("[0-9]*.json") if p.stem.isdigit())


def version_path(root: Path, number: int) -> Path:
    """Return the file of a version."""
    return root / "versions" / f"{number:06d}.json"


def read_version(root: Path, number: int) -> VersionFile:
    """Return a version by its number.

    Raises
    ------
    DataError
        When the file is missing or damaged; names it.
    """
    return durable.read_record(VersionFile, version_path(root, number))


def newest_version(root: Path) -> VersionFile | None:
    """Return the newest version, None when there is none."""
    version_numbers = numbers(root)
    return read_version(root, version_numbers[-1]) if version_numbers else None


def find_version(root: Path, version: int | str | None) -> VersionFile:
    """Return the version with this number, digest (its first 6 characters do) or tag, by default the newest.

    Raises
    ------
    DataError
        When the dataset has no version, or a tag is damaged.
    UsageError
        When there is no such version, or several.
    """
    version_numbers = numbers(root)
    if not version_numbers:
        raise DataError(
            "empty dataset",
            expected="at least 1 version",
            where=Where(path=str(root / "versions")),
            fix="add episodes: candata import, candata generate-sim; what was stopped goes on when run again",
        )
    if version is None or version in version_numbers:
        return read_version(root, version_numbers[-1] if version is None else int(version))
    digests = {n: read_version(root, n).digest for n in version_numbers} if isinstance(version, str) else {}
    matches = [n for n, d in digests.items() if len(str(version)) >= 6 and d.startswith(str(version))]
    tag = None if matches else read_tags(root).get(str(version))
    if tag:
        return _tagged_version(root, tag)
    if len({digests[n] for n in matches}) != 1:
        raise UsageError(
            f"{'several versions' if matches else 'no version'} {version}",
            expected=f"a number from {version_numbers[0]} to {version_numbers[-1]}, the start of a digest, or a tag",
            where=Where(path=str(root / "versions")),
        )
    return read_version(root, matches[-1])


def _tagged_version(root: Path, tag: TagFile) -> VersionFile:
    """Return the version that a tag names, which must still be the one it was given to."""
    version = read_version(root, tag.version)
    if version.digest != tag.digest:
        raise durable.damaged_error(
            tag_path(root, tag.name), f"digest {tag.digest[:12]}", f"digest {version.digest[:12]}"
        )
    return version


def index_of(root: Path, entries: Iterable[PartEntry]) -> dict[str, str]:
    """Return episode id to content hash over parts that stand.

    Raises
    ------
    DataError
        When a part is damaged.
    """
    return {name: digest for entry in entries for name, digest in RawPart(root, entry).manifest().episodes}


def members_of(root: Path, version: VersionFile) -> dict[str, str]:
    """Return episode id to content hash of a version: what its parts hold, less what it excludes.

    Raises
    ------
    DataError
        When a part is damaged.
    """
    excluded_ids = frozenset(version.exclusions)
    return {name: digest for name, digest in index_of(root, version.parts).items() if name not in excluded_ids}


def digest_of(index: dict[str, str]) -> str:
    """Return sha256 over sorted (episode id, content hash): what the version is, whatever its parts."""
    text = "".join(f"{name}\t{digest}\n" for name, digest in sorted(index.items()))
    return hashlib.sha256(text.encode()).hexdigest()


def publish(path: str | Path, part_ids: Iterable[str], lineage: Lineage) -> VersionFile:
    """Return the version that holds the newest one's parts and these; the newest one if they add nothing.

    Several processes may publish at once: each version file is created exclusively, and the one who comes
    late starts again from the newest version.

    Parameters
    ----------
    path : str or Path
        Dataset.
    part_ids : iterable of str
        Parts that stand, from `write_part` or `pending_parts`.
    lineage : Lineage
        How the new episodes came to be.

    Raises
    ------
    DataError
        When a part is missing or damaged, or an episode id stands with another content.
    UsageError
        When there are no parts and no version yet, or no dataset.
    """
    root = Path(path)
    read_dataset_file(root)
    new_entries = [entry_of(root, part_id) for part_id in dict.fromkeys(part_ids)]
    return advance(root, lambda base: _next_version(root, base, new_entries, lineage))


def advance(root: Path, change: Callable[[VersionFile | None], VersionFile]) -> VersionFile:
    """Return the version that `change` makes of the newest one, published; what it returns unchanged stands.

    Several processes may do so at once: each version file is created exclusively, and who comes late is asked
    again with what is then the newest. Every part of the version must stand.

    Parameters
    ----------
    root : Path
        Dataset.
    change : callable
        Takes the newest version (None where there is none) and returns the one after it, or the same value
        where nothing is to be published.

    Raises
    ------
    DataError
        When a version file is damaged.
    SetupError
        When the file system has no hard links, or the dataset was moved away.
    """
    while True:
        base = newest_version(root)
        version = change(base)
        if version is base:
            return version
        new_ids = {entry.id for entry in version.parts} - {entry.id for entry in (base.parts if base else ())}
        if create_version(root, version, new_ids):
            return version


def create_version(root: Path, version: VersionFile, new_ids: Iterable[str]) -> bool:
    """Create a version's file unless one stands; return whether this call made it.

    Parameters
    ----------
    root : Path
        Dataset.
    version : VersionFile
        The version.
    new_ids : iterable of str
        Parts that no version has named yet: they are held, so that garbage collection leaves them.

    Raises
    ------
    DataError
        When one of these has gone.
    SetupError
        When the file system has no hard links, or the dataset was moved away.
    """
    with durable.publish_lock(root):
        for part_id in new_ids:
            hold(root, part_id)
        return durable.create_once(root, version_path(root, version.number), durable.encode_record(version))


def _next_version(root: Path, base: VersionFile | None, new_entries: list[PartEntry], lineage: Lineage) -> VersionFile:
    """Return the version after `base` with the parts that add something; `base` itself if none does."""
    index = index_of(root, base.parts) if base else {}
    added_entries = []
    for entry in new_entries:
        new_episodes = _new_episodes(root, entry, index)
        if new_episodes:
            added_entries.append(entry)
            index |= new_episodes
    if base and not added_entries:
        return base
    if not added_entries:
        raise UsageError("nothing to publish", expected="at least 1 part", where=Where(path=str(root)))
    earlier = base.lineage if base else ()
    exclusions = base.exclusions if base else ()
    return VersionFile(
        number=base.number + 1 if base else 1,
        parent=base.digest if base else None,
        parts=(*(base.parts if base else ()), *added_entries),
        exclusions=exclusions,
        digest=digest_of({name: digest for name, digest in index.items() if name not in exclusions}),
        lineage=earlier if lineage in earlier else (*earlier, lineage),
    )


def _new_episodes(root: Path, entry: PartEntry, index: dict[str, str]) -> dict[str, str]:
    """Return the episodes of a part that `index` lacks; refuse one that stands with another content."""
    new_episodes = {}
    for name, digest in RawPart(root, entry).manifest().episodes:
        if is_new_episode(root, index, name, digest):
            new_episodes[name] = digest
    return new_episodes


def is_new_episode(root: Path, known: Mapping[str, str], name: str, digest: str) -> bool:
    """Return whether an episode is not among the `known` ones, whose ids lead to hashes of their content.

    Raises
    ------
    DataError
        When it is, with another content.
    """
    if known.get(name, digest) != digest:
        raise DataError(
            "an episode with this id but another content is in the dataset",
            expected=f"content {known[name][:12]}",
            found=f"content {digest[:12]}",
            where=Where(path=str(root), episode=name),
            fix="give the new episode another id, or write to another dataset",
        )
    return name not in known


def pending_parts(path: str | Path) -> tuple[PartFile, ...]:
    """Return the parts that are written whole but belong to no version, such as those of a stopped job.

    Raises
    ------
    UsageError
        When there is no dataset.
    DataError
        When a version file or the manifest of such a part is damaged.
    """
    root = Path(path)
    read_dataset_file(root)
    pending_ids = {p.parent.name for p in (root / "parts").glob("*/part.json")}
    for number in reversed(numbers(root)):
        if not pending_ids:
            break
        pending_ids -= {entry.id for entry in read_version(root, number).parts}
    return tuple(
        durable.read_record(PartFile, root / "parts" / part_id / "part.json") for part_id in sorted(pending_ids)
    )
