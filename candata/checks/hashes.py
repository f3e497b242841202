"""Rule: every file and every episode is what was written.

Without `deep`, files are compared by their size and episodes by their content, as far as it lies in tables.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView
from candata.datasets import RawPart, get_cloud
from candata.datasets.clouds import cloud_path
from candata.datasets.durable import file_sha256, reason
from candata.datasets.parts import EPISODES, MANIFEST
from candata.errors import DataError, UsageError
from candata.schema.episode import EpisodeMeta
from candata.schema.json_text import parse_json
from candata.schema.manifest import FileEntry

#: What to do about damage.
RESTORE = "restore the file from a copy"


def _files(part: RawPart, deep: bool) -> Iterator[Finding]:
    """Yield files of a part that are missing or changed, and what they no longer agree on."""
    try:
        manifest = part.manifest()
    except DataError as error:
        yield _damage(_text(part, error))
        return
    for entry in manifest.files:
        path = part.folder / entry.path
        try:
            difference = _difference(path, entry, deep)
        except OSError as error:
            difference = reason(error)
        if difference:
            yield _damage(f"{part.relative(path)}: {difference}")
    try:
        rows = part.rows()
    except DataError:
        return  # the file's own hash tells
    yield from _pairs(rows, dict(manifest.episodes))
    yield from _clouds(part, rows, deep)


def _damage(text: str) -> Finding:
    """Return the finding of a damaged file."""
    return Finding("error", "hashes", text, problem="a file is missing or changed", remedy=RESTORE)


def _difference(path: Path, entry: FileEntry, deep: bool) -> str:
    """Return how a file differs from its entry; nothing where it does not, by its size or in full."""
    size = path.stat().st_size
    if size != entry.bytes:
        return f"{size} bytes, expected {entry.bytes}"
    if not deep:
        return ""
    file_hash = file_sha256(path)
    return "" if file_hash == entry.sha256 else f"sha256 {file_hash[:12]}, expected {entry.sha256[:12]}"


def _pairs(rows: list[dict[str, Any]], manifest_hashes: dict[str, str]) -> Iterator[Finding]:
    """Yield episodes whose catalog row differs from the manifest."""
    catalog_hashes = {row["id"]: row["content_hash"] for row in rows}
    for name in sorted(manifest_hashes.keys() | catalog_hashes.keys()):
        if manifest_hashes.get(name) != catalog_hashes.get(name):
            text = f"{EPISODES} and {MANIFEST} disagree on the content"
            yield Finding("error", "hashes", text, episode=name, problem=text, remedy=RESTORE)


def _clouds(part: RawPart, rows: list[dict[str, Any]], deep: bool) -> Iterator[Finding]:
    """Yield point clouds that the part's episodes name and that are missing or damaged."""
    episode_by_cloud: dict[str, str] = {}
    for row in rows:
        try:
            cloud = EpisodeMeta.parse(parse_json(row["meta"]), part.folder).point_cloud
        except (UsageError, ValueError):
            continue  # the rule on the schema tells
        if cloud:
            episode_by_cloud.setdefault(cloud, row["id"])
    for cloud, episode in episode_by_cloud.items():
        if not deep and cloud_path(part.root, cloud).is_file():
            continue
        try:
            get_cloud(part.root, cloud)
        except DataError as error:
            problem = "a point cloud is missing or changed"
            text = _text(part, error)
            yield Finding(
                "error", "hashes", text, episode=episode, channel="point_cloud", problem=problem, remedy=RESTORE
            )


def _content(view: EpisodeView) -> Iterator[Finding]:
    """Yield content that no longer has the hash it was stored with."""
    raw = view.raw
    if raw.dense_shapes and not view.deep:
        return  # part of the content was not read
    content_hash = raw.content_hash()
    if content_hash != raw.stored_hash:
        text = f"content {content_hash[:12]}, expected {raw.stored_hash[:12]}"
        yield view.finding("error", "hashes", "the content has changed", text, remedy=RESTORE)


def _text(part: RawPart, error: DataError) -> str:
    """Return `file: found, expected ...`."""
    return f"{part.relative(error.where.path)}: {error.found}, expected {error.expected}"


RULE = Rule(meaning="files and episodes are what was written", part=_files, episode=_content)
