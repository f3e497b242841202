"""Records of a dataset on disk: the dataset, its parts, its versions, their lineage."""

from __future__ import annotations

from typing import Any

from candata.schema.record import Record

#: Version of the folder layout; a reader refuses one it does not know.
FORMAT_VERSION = 1


class DatasetFile(Record):
    """`dataset.json`, written once."""

    format_version: int = FORMAT_VERSION
    name: str
    schema_channels: tuple[dict[str, Any], ...]


class FileEntry(Record):
    """One file of a part with its size and hash."""

    path: str
    bytes: int
    sha256: str


class PartFile(Record):
    """`part.json`, written last: the part exists once this does."""

    id: str
    files: tuple[FileEntry, ...]
    rows: int
    episodes: tuple[tuple[str, str], ...]  # (episode id, content hash)
    producer: dict[str, str] = {}


class Lineage(Record):
    """The origin of a version; a withheld set keeps only `sealed`, sha256(label + salt).

    `parents` are `name@digest`; `ancestry` is the lineage of each, so that the tree outlives them. A lineage that
    stands once in a tree is not repeated.
    """

    operation: str
    parents: tuple[str, ...] = ()
    config_digest: str | None = None
    seeds: tuple[int, ...] = ()
    revision: str | None = None
    tools: dict[str, str] = {}
    details: dict[str, Any] = {}
    sealed: str | None = None
    ancestry: dict[str, tuple[Lineage, ...]] = {}


class PartEntry(Record):
    """A part as a version names it."""

    id: str
    sha256: str
    rows: int
    episodes: int


class VersionFile(Record):
    """`versions/NNNNNN.json`: an immutable set of parts."""

    number: int
    parent: str | None = None
    parts: tuple[PartEntry, ...]
    exclusions: tuple[str, ...] = ()
    digest: str
    lineage: tuple[Lineage, ...] = ()


class TagFile(Record):
    """`tags/NAME.json`: a name for one version; gc keeps what it names."""

    name: str
    version: int
    digest: str
