"""Giving, moving and taking away tags."""

from __future__ import annotations

import re
from pathlib import Path

from candata.datasets import durable
from candata.datasets.names import require_name
from candata.datasets.tags import read_tags, tag_path
from candata.datasets.versions import find_version, read_dataset_file
from candata.errors import UnknownNameError, UsageError, Where
from candata.schema.manifest import TagFile


def set_tag(path: str | Path, name: str, version: int | str | None = None, move: bool = False) -> TagFile:
    """Return the tag, which now names a version; the same may be given twice.

    Parameters
    ----------
    path : str or Path
        Dataset.
    name : str
        Name of the tag.
    version : int or str, optional
        Number, digest or another tag; by default the newest.
    move : bool
        Let a tag that names another version name this one.

    Raises
    ------
    UsageError
        When the name cannot be one, there is no such version, or the tag names another and `move` is false.
    DataError
        When a version or tag is damaged.
    """
    root = Path(path)
    require_name("tag", name)
    if name.isdigit() or re.fullmatch(r"[0-9a-f]{6,}", name):
        raise UsageError("a tag must not read as a version or a digest", found=name, fix="choose another name")
    read_dataset_file(root)
    with durable.publish_lock(root):
        return _set(root, name, version, move)


def _set(root: Path, name: str, version: int | str | None, move: bool) -> TagFile:
    """Return the tag, which now names a version that stands."""
    named_version = find_version(root, version)
    tag = TagFile(name=name, version=named_version.number, digest=named_version.digest)
    data = durable.encode_record(tag)
    if durable.create_once(root, tag_path(root, name), data):
        return tag
    existing_tag = read_tags(root)[name]
    if existing_tag != tag and not move:
        raise UsageError(
            f"the tag {name} names another version",
            expected=f"version {tag.version}, digest {tag.digest[:12]}",
            found=f"version {existing_tag.version}, digest {existing_tag.digest[:12]}",
            where=Where(path=str(root)),
            fix="move it with --move",
        )
    if existing_tag != tag:
        with durable.replacing_staged(root, tag_path(root, name)) as draft:
            draft.write_bytes(data)
    return tag


def delete_tag(path: str | Path, name: str) -> None:
    """Take a tag away; the version stays.

    Raises
    ------
    UnknownNameError
        When there is no such tag; lists those there are.
    """
    root = Path(path)
    tags = read_tags(root)
    if name not in tags:
        raise UnknownNameError("tag", name, tags, Where(path=str(root)))
    tag_path(root, name).unlink(missing_ok=True)
    durable.sync(root / "tags")
