"""Records of the registry, and of what a remote keeps of a version."""

from __future__ import annotations

from candata.schema.manifest import FileEntry, VersionFile
from candata.schema.record import Record

#: Version of the registry's file; a reader refuses one it does not know.
REGISTRY_VERSION = 1


class RemoteEntry(Record):
    """A place to push to: a folder, `file://` or `s3://bucket/prefix`; never a credential.

    The other fields are for S3: a store of one's own has an `endpoint`, is addressed by path and may speak plain http.
    """

    url: str
    endpoint: str | None = None
    region: str | None = None
    path_style: bool = True
    allow_http: bool = False
    anonymous: bool = False


class RegistryFile(Record):
    """`registry.json` in the user's data folder: names of datasets (absolute folders) and of remotes."""

    registry_version: int = REGISTRY_VERSION
    datasets: dict[str, str] = {}
    remotes: dict[str, RemoteEntry] = {}


class RemoteVersion(Record):
    """`NAME/versions/NNNNNN.json` of a remote, created once and last: the version and its point clouds.

    Each part's `part.json` lies under its sha256 in `NAME/objects`, and so does every file that it names.
    """

    version: VersionFile
    clouds: tuple[FileEntry, ...] = ()
