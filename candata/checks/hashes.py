"""Rule: every file and every episode is what was written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from candata.checks._finding import Finding, Rule
from candata.datasets import RawEpisode, RawPart, get_cloud
from candata.datasets.durable import file_sha256, reason
from candata.datasets.parts import EPISODES, MANIFEST
from candata.errors import DataError, UsageError
from candata.schema.episode import EpisodeMeta


def _files(part: RawPart) -> Iterator[Finding]:
    """Yield files of a part that are missing or changed, and what they no longer agree on."""
    try:
        manifest = part.manifest()
    except DataError as error:
        yield Finding("error", "hashes", _text(part, error))
        return
    for entry in manifest.files:
        path = part.folder / entry.path
        try:
            found = file_sha256(path)
        except OSError as error:
            yield Finding("error", "hashes", f"{part.relative(path)}: {reason(error)}")
            continue
        if found != entry.sha256:
            text = f"sha256 {found[:12]}, expected {entry.sha256[:12]}"
            yield Finding("error", "hashes", f"{part.relative(path)}: {text}")
    try:
        rows = part.rows()
    except DataError:
        return  # the file's own hash tells
    yield from _pairs(rows, dict(manifest.episodes))
    yield from _clouds(part, rows)


def _pairs(rows: list[dict[str, Any]], promised: dict[str, str]) -> Iterator[Finding]:
    """Yield episodes whose catalog row differs from the manifest."""
    stored = {row["id"]: row["content_hash"] for row in rows}
    for name in sorted(promised.keys() | stored.keys()):
        if promised.get(name) != stored.get(name):
            text = f"{EPISODES} and {MANIFEST} disagree on the content"
            yield Finding("error", "hashes", text, episode=name)


def _clouds(part: RawPart, rows: list[dict[str, Any]]) -> Iterator[Finding]:
    """Yield point clouds that the part's episodes name and that are missing or damaged."""
    named: dict[str, str] = {}
    for row in rows:
        try:
            cloud = EpisodeMeta.parse(json.loads(row["meta"]), part.folder).point_cloud
        except (UsageError, ValueError):
            continue  # the rule on the schema tells
        if cloud:
            named.setdefault(cloud, row["id"])
    for cloud, episode in named.items():
        try:
            get_cloud(part.root, cloud)
        except DataError as error:
            yield Finding("error", "hashes", _text(part, error), episode=episode, channel="point_cloud")


def _content(episode: RawEpisode) -> Iterator[Finding]:
    """Yield content that no longer has the hash it was stored with."""
    found = episode.content_hash()
    if found != episode.stored_hash:
        text = f"content {found[:12]}, expected {episode.stored_hash[:12]}"
        yield Finding("error", "hashes", text, episode=episode.id)


def _text(part: RawPart, error: DataError) -> str:
    """Return `file: found, expected ...`."""
    return f"{part.relative(error.where.path)}: {error.found}, expected {error.expected}"


RULE = Rule(meaning="files and episodes are what was written", part=_files, episode=_content)
