"""What a pull has fetched: checked by its contents, then kept. No claim of a manifest or a catalog row is believed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from candata.datasets import durable
from candata.datasets.clouds import get_cloud
from candata.datasets.encode import RawEpisode, episode_row
from candata.datasets.parts import EPISODES, EPISODES_PER_ROW_GROUP, MANIFEST, STEPS, UNREADABLE, RawPart, part_folder
from candata.datasets.pull_plan import PullPlan
from candata.datasets.remotes import Bar, corrupted_error, object_key, version_key
from candata.datasets.store import Store
from candata.datasets.tags import read_tags, tag_path
from candata.datasets.versions import DATASET, create_version, read_version
from candata.errors import DataError, UsageError, Where
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json
from candata.schema.manifest import PartFile, VersionFile

#: Columns of a catalog row that are compared in their own way: `effects` by what it means, `meta` by the content hash.
_SPECIAL_COLUMNS = ("effects", "meta")


def arrival_folder(root: Path) -> Path:
    """Return the folder of what was fetched and is not yet checked, laid out as a dataset; the same for each pull."""
    return root / durable.STAGING_FOLDER / durable.PULL_FOLDER


def split_path(root: Path, name: str) -> Path:
    """Return the file of a split."""
    return root / "splits" / f"{name}.json"


def missing_part_ids(root: Path, plan: PullPlan) -> list[str]:
    """Return the ids of the parts that the folder lacks."""
    return [entry.id for entry in plan.record.version.parts if not part_folder(root, entry.id).is_dir()]


def check(store: Store, name: str, root: Path, plan: PullPlan, bar: Bar) -> None:
    """Refuse parts and clouds whose contents are not what the remote claims, and episodes whose cloud it lacks.

    Every episode is decoded and hashed anew. Whether it is sound is for `candata validate` to say.

    Parameters
    ----------
    store, name : Store, str
        Where they come from.
    root : Path
        Dataset, what was fetched lying in `arrival_folder`.
    plan : PullPlan
        What is claimed.
    bar : callable
        Shows the progress in bytes.

    Raises
    ------
    DataError
        When a claim is wrong; names the file of the remote that makes it.
    """
    wait, version = arrival_folder(root), plan.record.version
    cloud_of: dict[str, str] = {}
    sizes = {
        part_id: sum(file.bytes for file in plan.parts[part_id][1].files) for part_id in missing_part_ids(root, plan)
    }
    with bar(sum(sizes.values())) as advance:
        for entry in (entry for entry in version.parts if entry.id in sizes):
            with _blame(store, object_key(name, entry.sha256)):
                cloud_of |= _require_part(RawPart(wait, entry), plan.parts[entry.id][1])
            advance(sizes[entry.id])
    clouds = {Path(cloud.path).stem: cloud for cloud in plan.record.clouds}
    for sha, cloud in clouds.items():
        if not (root / cloud.path).is_file():
            with _blame(store, object_key(name, cloud.sha256)):
                get_cloud(wait, sha)
    for episode, sha in cloud_of.items():
        if sha not in clouds and episode not in version.exclusions:
            raise corrupted_error(
                store, version_key(name, version.number), f"no point cloud {sha[:12]!r} of {episode}"[:200]
            )


@contextmanager
def _blame(store: Store, key: str) -> Iterator[None]:
    """Turn an error in files with the promised hashes into an error of the file that promised them."""
    try:
        yield
    except DataError as error:
        path = Path(error.where.path or "").name
        raise corrupted_error(store, key, f"{path}: {error.found}; expected {error.expected}") from None


def _require_part(part: RawPart, manifest: PartFile) -> dict[str, str]:
    """Return episode id to the point cloud that it names, for a part that holds what its manifest claims."""
    path, rows = part.folder / EPISODES, part.rows()
    catalog_rows = [(row["id"], row["content_hash"], row["row_group"]) for row in rows]
    if catalog_rows != [(*pair, i // EPISODES_PER_ROW_GROUP) for i, pair in enumerate(manifest.episodes)]:
        raise durable.damaged_error(
            path, f"{len(catalog_rows)} episodes that differ", f"the {len(manifest.episodes)} of the manifest"
        )
    groups = -(-len(catalog_rows) // EPISODES_PER_ROW_GROUP)
    counts = _counts(part)
    if counts != (manifest.rows, groups):
        expected_text = f"{manifest.rows} rows in {groups} row groups"
        raise durable.damaged_error(part.folder / STEPS, f"{counts[0]} rows in {counts[1]}", expected_text)
    clouds: dict[str, str] = {}
    for number in range(groups):
        group_rows = [row for row in rows if row["row_group"] == number]
        for raw, row in zip(part.group(number, rows), group_rows, strict=True):
            cloud = _require_episode(part, part.with_dense(raw), row)
            clouds |= {raw.id: cloud} if cloud else {}
    return clouds


def _counts(part: RawPart) -> tuple[int, int]:
    """Return the rows and row groups of `steps.parquet`."""
    path = part.folder / STEPS
    try:
        meta = pq.read_metadata(path)
    except UNREADABLE as error:
        raise durable.damaged_error(path, durable.reason(error)) from None
    return meta.num_rows, meta.num_row_groups


def _require_episode(part: RawPart, raw: RawEpisode, row: dict[str, Any]) -> str | None:
    """Return the point cloud that an episode names; refuse one that is not what its catalog row says."""
    digest = raw.content_hash()
    if digest != raw.stored_hash:
        path = part.folder / STEPS
        raise durable.damaged_error(path, f"content {digest[:12]} of {raw.id}", f"content {raw.stored_hash[:12]}")
    path = part.folder / EPISODES
    try:
        meta = raw.meta()
        expected_row = episode_row(meta, raw.arrays["time_ns"], digest, row["row_group"])
        settings = None if row["effects"] is None else parse_json(row["effects"])
        effects = None if settings is None else tuple(EffectSetting.model_validate(setting) for setting in settings)
    except (*UNREADABLE, IndexError, RecursionError, UsageError) as error:
        raise durable.damaged_error(path, f"no record of {raw.id}: {durable.reason(error)}") from None
    differing_columns = [
        name for name, value in expected_row.items() if name not in _SPECIAL_COLUMNS and row[name] != value
    ]
    differing_columns += ["effects"] if effects != meta.effects else []
    if differing_columns:
        raise durable.damaged_error(
            path,
            f"{differing_columns[0]} {row[differing_columns[0]]!r} of {raw.id}"[:200],
            f"{expected_row[differing_columns[0]]!r}"[:200],
        )
    return meta.point_cloud


def leave_nothing(root: Path, is_new_folder: bool) -> None:
    """Remove what was fetched, and the folder if this pull has made it."""
    shutil.rmtree(arrival_folder(root), ignore_errors=True)
    if is_new_folder:
        with suppress(OSError):
            (root / durable.STAGING_FOLDER).rmdir()
            root.rmdir()


def keep(root: Path, plan: PullPlan) -> tuple[str, ...]:
    """Return notes for people, after moving what was checked into the dataset: the version's file last, then tags.

    Raises
    ------
    DataError
        When another process has made another split or version of that name meanwhile.
    """
    durable.create_once(root, root / DATASET, plan.head)
    wait, version = arrival_folder(root), plan.record.version
    for cloud in plan.record.clouds:
        if (wait / cloud.path).is_file():
            durable.ensure_below(root, (root / cloud.path).parent)
            durable.replace_synced(wait / cloud.path, root / cloud.path)
    part_ids = missing_part_ids(root, plan)
    for part_id in part_ids:
        _commit(root, part_id, plan.parts[part_id][0])
    for split, file in plan.splits.items():
        path, fetched_path = split_path(root, split), split_path(wait, split)
        is_created = fetched_path.is_file() and durable.create_once(root, path, fetched_path.read_bytes())
        if not is_created and durable.file_sha256(path) != file.sha256:
            raise other_split(path)
    if not create_version(root, version, part_ids) and read_version(root, version.number) != version:
        raise diverged_error(root, version, read_version(root, version.number))
    notes = _keep_tags(root, plan)
    shutil.rmtree(wait, ignore_errors=True)
    return notes


def _commit(root: Path, part_id: str, manifest: bytes) -> None:
    """Move a part among the others, `part.json` written last."""
    folder, target = part_folder(arrival_folder(root), part_id), part_folder(root, part_id)
    (folder / MANIFEST).write_bytes(manifest)
    durable.sync(folder / MANIFEST)
    for path in [*(p for p in folder.rglob("*") if p.is_dir()), folder]:
        durable.sync(path)
    durable.ensure_below(root, target.parent)
    try:
        os.rename(folder, target)
    except OSError:
        if not target.is_dir():
            raise
    durable.sync(target.parent)


def _keep_tags(root: Path, plan: PullPlan) -> tuple[str, ...]:
    """Keep the tags of the version that was pulled; one that stands for another version stays, with a note."""
    existing_tags = read_tags(root)
    notes = []
    for name, tag in plan.tags.items():
        if name not in existing_tags:
            durable.create_once(root, tag_path(root, name), durable.encode_record(tag))
        elif existing_tags[name] != tag:
            notes.append(f"the tag {name} stands for version {existing_tags[name].version} here and was left so")
    return tuple(notes)


def other_split(path: Path) -> DataError:
    """Return the error for a split that stands with other content."""
    return DataError(
        f"another split is called {path.stem}",
        where=Where(path=str(path)),
        fix="pull to another folder: a split that models were trained on must not change",
    )


def diverged_error(root: Path, remote_version: VersionFile, local_version: VersionFile) -> DataError:
    """Return the error for a folder with another history."""
    return DataError(
        "the folder has another history of this dataset",
        expected=f"version {remote_version.number}, digest {remote_version.digest[:12]} (on the remote)",
        found=f"version {local_version.number}, digest {local_version.digest[:12]}",
        where=Where(path=str(root)),
        fix="pull to another folder; `candata registry merge` joins the two",
    )
