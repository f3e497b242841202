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
from candata.datasets.pull_plan import Plan
from candata.datasets.remotes import Bar, corrupted, object_key, version_key
from candata.datasets.store import Store
from candata.datasets.tags import read_tags, tag_path
from candata.datasets.versions import DATASET, create_version, read_version
from candata.errors import DataError, UsageError, Where
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json
from candata.schema.manifest import PartFile, VersionFile

#: Columns of a catalog row that are compared in their own way: `effects` by what it means, `meta` by the content hash.
_APART = ("effects", "meta")


def waiting(root: Path) -> Path:
    """Return where what arrives lies, as in a dataset, until all of it is checked; the same for each pull."""
    return root / durable.STAGING / durable.PULLING


def split_path(root: Path, name: str) -> Path:
    """Return the file of a split."""
    return root / "splits" / f"{name}.json"


def arriving(root: Path, plan: Plan) -> list[str]:
    """Return the ids of the parts that the folder lacks."""
    return [entry.id for entry in plan.record.version.parts if not part_folder(root, entry.id).is_dir()]


def check(store: Store, name: str, root: Path, plan: Plan, bar: Bar) -> None:
    """Refuse parts and clouds whose contents are not what the remote claims, and episodes whose cloud it lacks.

    Every episode is decoded and hashed anew. Whether it is sound is for `candata validate` to say.

    Parameters
    ----------
    store, name : Store, str
        Where they come from.
    root : Path
        Dataset, what was fetched lying in `waiting`.
    plan : Plan
        What is claimed.
    bar : callable
        Shows the progress in bytes.

    Raises
    ------
    DataError
        When a claim is wrong; names the file of the remote that makes it.
    """
    wait, version = waiting(root), plan.record.version
    named: dict[str, str] = {}
    sizes = {part_id: sum(file.bytes for file in plan.parts[part_id][1].files) for part_id in arriving(root, plan)}
    with bar(sum(sizes.values())) as advance:
        for entry in (entry for entry in version.parts if entry.id in sizes):
            with _blamed(store, object_key(name, entry.sha256)):
                named |= _require_part(RawPart(wait, entry), plan.parts[entry.id][1])
            advance(sizes[entry.id])
    clouds = {Path(cloud.path).stem: cloud for cloud in plan.record.clouds}
    for sha, cloud in clouds.items():
        if not (root / cloud.path).is_file():
            with _blamed(store, object_key(name, cloud.sha256)):
                get_cloud(wait, sha)
    for episode, sha in named.items():
        if sha not in clouds and episode not in version.exclusions:
            raise corrupted(store, version_key(name, version.number), f"no point cloud {sha[:12]!r} of {episode}"[:200])


@contextmanager
def _blamed(store: Store, key: str) -> Iterator[None]:
    """Turn what is wrong with files that have the promised hashes into an error of what promised them."""
    try:
        yield
    except DataError as error:
        path = Path(error.where.path or "").name
        raise corrupted(store, key, f"{path}: {error.found}; expected {error.expected}") from None


def _require_part(part: RawPart, manifest: PartFile) -> dict[str, str]:
    """Return episode id to the point cloud that it names, for a part that holds what its manifest claims."""
    path, rows = part.folder / EPISODES, part.rows()
    held = [(row["id"], row["content_hash"], row["row_group"]) for row in rows]
    if held != [(*pair, i // EPISODES_PER_ROW_GROUP) for i, pair in enumerate(manifest.episodes)]:
        raise durable.damaged(
            path, f"{len(held)} episodes that differ", f"the {len(manifest.episodes)} of the manifest"
        )
    groups = -(-len(held) // EPISODES_PER_ROW_GROUP)
    counts = _counts(part)
    if counts != (manifest.rows, groups):
        expected = f"{manifest.rows} rows in {groups} row groups"
        raise durable.damaged(part.folder / STEPS, f"{counts[0]} rows in {counts[1]}", expected)
    clouds: dict[str, str] = {}
    for number in range(groups):
        some = [row for row in rows if row["row_group"] == number]
        for raw, row in zip(part.group(number, rows), some, strict=True):
            cloud = _require_episode(part, part.whole(raw), row)
            clouds |= {raw.id: cloud} if cloud else {}
    return clouds


def _counts(part: RawPart) -> tuple[int, int]:
    """Return the rows and row groups of `steps.parquet`."""
    path = part.folder / STEPS
    try:
        meta = pq.read_metadata(path)
    except UNREADABLE as error:
        raise durable.damaged(path, durable.reason(error)) from None
    return meta.num_rows, meta.num_row_groups


def _require_episode(part: RawPart, raw: RawEpisode, row: dict[str, Any]) -> str | None:
    """Return the point cloud that an episode names; refuse one that is not what its catalog row says."""
    found = raw.content_hash()
    if found != raw.stored_hash:
        path = part.folder / STEPS
        raise durable.damaged(path, f"content {found[:12]} of {raw.id}", f"content {raw.stored_hash[:12]}")
    path = part.folder / EPISODES
    try:
        meta = raw.meta()
        told = episode_row(meta, raw.arrays["time_ns"], found, row["row_group"])
        settings = None if row["effects"] is None else parse_json(row["effects"])
        effects = None if settings is None else tuple(EffectSetting.model_validate(one) for one in settings)
    except (*UNREADABLE, IndexError, RecursionError, UsageError) as error:
        raise durable.damaged(path, f"no record of {raw.id}: {durable.reason(error)}") from None
    wrong = [name for name, value in told.items() if name not in _APART and row[name] != value]
    wrong += ["effects"] if effects != meta.effects else []
    if wrong:
        raise durable.damaged(path, f"{wrong[0]} {row[wrong[0]]!r} of {raw.id}"[:200], f"{told[wrong[0]]!r}"[:200])
    return meta.point_cloud


def leave_nothing(root: Path, made: bool) -> None:
    """Remove what was fetched, and the folder if this pull has made it."""
    shutil.rmtree(waiting(root), ignore_errors=True)
    if made:
        with suppress(OSError):
            (root / durable.STAGING).rmdir()
            root.rmdir()


def keep(root: Path, plan: Plan) -> tuple[str, ...]:
    """Return notes for people on what is now in the dataset: what was checked, the version's file last but for tags.

    Raises
    ------
    DataError
        When another process has made another split or version of that name meanwhile.
    """
    durable.create_once(root, root / DATASET, plan.head)
    wait, version = waiting(root), plan.record.version
    for cloud in plan.record.clouds:
        if (wait / cloud.path).is_file():
            durable.ensure_below(root, (root / cloud.path).parent)
            durable.replace_synced(wait / cloud.path, root / cloud.path)
    added = arriving(root, plan)
    for part_id in added:
        _commit(root, part_id, plan.parts[part_id][0])
    for split, file in plan.splits.items():
        path, arrived = split_path(root, split), split_path(wait, split)
        made = arrived.is_file() and durable.create_once(root, path, arrived.read_bytes())
        if not made and durable.file_sha256(path) != file.sha256:
            raise other_split(path)
    if not create_version(root, version, added) and read_version(root, version.number) != version:
        raise diverged(root, version, read_version(root, version.number))
    notes = _keep_tags(root, plan)
    shutil.rmtree(wait, ignore_errors=True)
    return notes


def _commit(root: Path, part_id: str, manifest: bytes) -> None:
    """Move a part among the others, `part.json` written last."""
    folder, target = part_folder(waiting(root), part_id), part_folder(root, part_id)
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


def _keep_tags(root: Path, plan: Plan) -> tuple[str, ...]:
    """Keep the tags of the version that was pulled; one that stands for another version stays, with a note."""
    standing = read_tags(root)
    notes = []
    for name, tag in plan.tags.items():
        if name not in standing:
            durable.create_once(root, tag_path(root, name), durable.encode_record(tag))
        elif standing[name] != tag:
            notes.append(f"the tag {name} stands for version {standing[name].version} here and was left so")
    return tuple(notes)


def other_split(path: Path) -> DataError:
    """Return the error for a split that stands with other content."""
    return DataError(
        f"another split is called {path.stem}", where=Where(path=str(path)),
        fix="pull to another folder: a split that models were trained on must not change",
    )  # fmt: skip


def diverged(root: Path, there: VersionFile, here: VersionFile) -> DataError:
    """Return the error for a folder with another history."""
    return DataError(
        "the folder has another history of this dataset",
        expected=f"version {there.number}, digest {there.digest[:12]} (on the remote)",
        found=f"version {here.number}, digest {here.digest[:12]}",
        where=Where(path=str(root)),
        fix="pull to another folder; `candata registry merge` joins the two",
    )
