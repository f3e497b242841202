"""The memory-mapped cache of a version: all rows of all episodes in one file, made once, checked when opened."""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.align import GAP_STEPS
from candata.datasets import Dataset, durable
from candata.errors import CandataError, DataError, SetupError, Where
from candata.loaders.layout import POINT_CLOUD, Shapes, row_dtype, row_shapes
from candata.schema.channels import CHANNELS, QUATERNION
from candata.schema.episode import Episode
from candata.schema.json_text import parse_json
from candata.schema.record import Record
from candata.user_folders import user_cache

#: Raised when the bytes of the cache, or what they mean, change.
LAYOUT_VERSION = 2

ROWS, VALID, STRETCH, FACTS = "rows.npy", "valid.npy", "stretch.npy", "cache.json"
ARRAYS = (ROWS, VALID, STRETCH)

#: Called with (episodes done, episodes in all).
Progress = Callable[[int, int], None]


class CacheFile(Record):
    """`cache.json`: what the arrays are; columns with an entry an episode, in the order of the ids."""

    layout_version: int
    digest: str
    shapes: dict[str, tuple[int, ...]]
    crc32: dict[str, int]
    ids: tuple[str, ...]
    rows: tuple[int, ...]
    rate_hz: tuple[float, ...]
    clouds: tuple[str | None, ...]
    joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    fingertip_names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Cache:
    """All rows of a version, memory-mapped.

    Attributes
    ----------
    folder : Path
        Where it lies.
    file : CacheFile
        What is in it.
    rows : (R,) structured
        Rows of all episodes, one after the other; a field a channel. Values that are not valid are
        replaced by the last valid ones before them (the first after them at the start).
    valid : (R,) bool
        False where any of the channels holds no valid value.
    stretch : (R,) int32
        Counts, from 0 in each episode, the times at which rows are missing: equal for rows without a break between.
    """

    folder: Path
    file: CacheFile
    rows: NDArray
    valid: NDArray[np.bool_]
    stretch: NDArray[np.int32]

    def __reduce__(self) -> tuple[Callable[[Path], Cache], tuple[Path]]:
        """Send only the place to another process, which maps the same file."""
        return reopen, (self.folder,)

    @cached_property
    def begin(self) -> NDArray[np.int64]:
        """`(E,) int64`: first row of each episode."""
        return self.end - np.array(self.file.rows, np.int64)

    @cached_property
    def end(self) -> NDArray[np.int64]:
        """`(E,) int64`: row behind the last one of each episode."""
        return np.cumsum(np.array(self.file.rows, np.int64))

    @cached_property
    def all_valid(self) -> bool:
        """Whether no row is invalid."""
        return bool(self.valid.all())

    @cached_property
    def unbroken(self) -> bool:
        """Whether no row is missing anywhere."""
        return not self.stretch.any()


def open_cache(
    dataset: Dataset,
    channels: Sequence[str] | None = None,
    folder: Path | None = None,
    progress: Progress = lambda done_count, total: None,
) -> Cache:
    """Return the cache of a version, made now unless a whole one stands.

    A cache whose bytes do not match its check sums is made again. Several processes may do so at once:
    each builds in its own staging folder, and the first to finish gives the name to its own. A killed one
    leaves at most its staging folder. The cache folder may be deleted at any time.

    Parameters
    ----------
    dataset : Dataset
        Version to read.
    channels : sequence of str, optional
        As for `row_shapes`; `point_cloud` asks for a cloud of every episode's object.
    folder : Path, optional
        Where caches are kept; by default `cache/` of the dataset, or the user's cache folder where the
        dataset cannot be written.
    progress : callable
        Called with (episodes done, episodes in all) while the cache is made.

    Raises
    ------
    DataError
        When episodes lack a channel or differ in shapes or names, or a part is damaged.
    SetupError
        When the cache cannot be written.
    """
    name = f"windows-{_key(dataset, channels)}"
    homes = [folder] if folder else [dataset.path / "cache", user_cache()]
    candidate = next((candidate for home in homes if (candidate := _read(home / name))), None)
    if candidate is None:
        home = homes[0] if folder or os.access(dataset.path, os.W_OK) else homes[-1]
        shapes = row_shapes(dataset, None if channels is None else [n for n in channels if n != POINT_CLOUD])
        try:
            candidate = _make(dataset, shapes, POINT_CLOUD in (channels or ()), home / name, progress)
        except OSError as error:
            raise SetupError(
                "the cache cannot be written",
                expected=f"{sum(_counts(dataset)) * row_dtype(shapes).itemsize / 1e6:.0f} MB of space",
                found=durable.reason(error),
                where=Where(path=str(home)),
                fix="free space, or name another folder: windows(..., cache=FOLDER)",
            ) from None
    return candidate


def reopen(folder: Path) -> Cache:
    """Return the cache that lies in `folder`.

    Raises
    ------
    DataError
        When it is missing or damaged.
    """
    cache = _read(folder)
    if cache is None:
        raise DataError(
            "the cache is missing or damaged",
            where=Where(path=str(folder)),
            fix="open the windows of the dataset again",
        )
    return cache


def _key(dataset: Dataset, channels: Sequence[str] | None) -> str:
    """Return what names a cache: content, episodes left out, channels, layout."""
    facts = [LAYOUT_VERSION, dataset.digest, dataset.ids, None if channels is None else list(channels)]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:24]


def _read(folder: Path) -> Cache | None:
    """Return the cache in `folder`; None where there is none, or it is not what was written."""
    try:
        facts = parse_json((folder / FACTS).read_bytes())
        file = CacheFile.parse(facts["cache"], folder / FACTS)
        if facts["sha256"] != _hash(file) or {n: _crc(folder / n) for n in ARRAYS} != file.crc32:
            return None
        arrays = [np.asarray(np.load(folder / name, mmap_mode="r", allow_pickle=False)) for name in ARRAYS]
    except (OSError, ValueError, KeyError, TypeError, CandataError):
        return None
    return Cache(folder, file, *arrays)


def _crc(path: Path) -> int:
    """Return the check sum of a file's bytes; at memory speed, so that every opening can afford it."""
    return zlib.crc32(np.memmap(path, np.uint8, "r").data)


def _hash(file: CacheFile) -> str:
    """Return the sha256 of what the cache says of itself."""
    return hashlib.sha256(durable.encode_record(file)).hexdigest()


def _make(dataset: Dataset, shapes: Shapes, clouds: bool, target: Path, progress: Progress) -> Cache:
    """Return the cache at `target`, built aside and given its name when whole."""
    durable.ensure_folder(target.parent)
    with durable.staging_folder(target.parent) as folder:
        draft = folder / target.name
        draft.mkdir()
        file = _write(dataset, shapes, clouds, draft, progress)
        text = {"sha256": _hash(file), "cache": file.model_dump(mode="json")}
        (draft / FACTS).write_text(json.dumps(text), encoding="utf-8")
        while True:
            try:
                os.rename(draft, target)
            except OSError:
                if not target.exists():
                    raise
            cache = _read(target)
            if cache is not None:
                return cache
            _move_aside(target, folder)


def _move_aside(target: Path, folder: Path) -> None:
    """Take a damaged cache out of the way; another process may have done so."""
    try:
        os.rename(target, folder / f"damaged-{len(list(folder.iterdir()))}")
    except FileNotFoundError:
        return


def _counts(dataset: Dataset) -> list[int]:
    """Return the rows of each episode."""
    counts: list[int] = dataset.catalog()["rows"].to_pylist()
    return counts


def _write(dataset: Dataset, shapes: Shapes, clouds: bool, folder: Path, progress: Progress) -> CacheFile:
    """Write the arrays into `folder` and return what is in them."""
    catalog = dataset.catalog()
    meta = [parse_json(text) for text in catalog["meta"].to_pylist()]
    counts = _counts(dataset)
    names = {key: _common_names(dataset, meta, key, axis, shapes) for key, axis in _NAMED_AXES.items()}
    named_clouds = tuple(fields.get(POINT_CLOUD) for fields in meta)
    if clouds:
        _require_clouds(dataset, named_clouds)
    rows = np.lib.format.open_memmap(folder / ROWS, "w+", row_dtype(shapes), (sum(counts),))
    valid, stretch = np.ones(len(rows), bool), np.zeros(len(rows), np.int32)
    ends = dict(zip(dataset.ids, np.cumsum(counts).tolist(), strict=True))
    # Read as it lies, not by id: each row group is then decoded once.
    order = sorted(dataset.ids, key=lambda i: (dataset.places[i].part.entry.id, dataset.places[i].position))
    for done_count, episode in enumerate(dataset.episodes(order), 1):
        part = slice(ends[episode.meta.id] - len(episode), ends[episode.meta.id])
        _fill(episode, rows[part], valid[part])
        stretch[part] = _stretches(episode)
        progress(done_count, len(order))
    rows.flush()
    del rows
    np.save(folder / VALID, valid, allow_pickle=False)
    np.save(folder / STRETCH, stretch, allow_pickle=False)
    return CacheFile(
        layout_version=LAYOUT_VERSION,
        digest=dataset.digest,
        shapes=shapes,
        crc32={name: _crc(folder / name) for name in ARRAYS},
        ids=dataset.ids,
        rows=tuple(counts),
        rate_hz=tuple(catalog["rate_hz"].to_pylist()),
        clouds=named_clouds,
        **names,
    )


def _stretches(episode: Episode) -> NDArray[np.int32]:
    """Return `(T,) int32`: how many breaks of the clock lie before each row, by the rule of `candata validate`."""
    steps = np.diff(episode["time_ns"])
    breaks = steps > GAP_STEPS * (np.median(steps) if len(steps) else 0)
    return np.concatenate([[0], np.cumsum(breaks)]).astype(np.int32)


def _fill(episode: Episode, rows: NDArray, valid: NDArray[np.bool_]) -> None:
    """Write an episode's rows in place, gaps held, commands as those that follow their row."""
    for name in rows.dtype.names or ():
        values, is_valid = episode[name], episode.valid(name)
        if name == "action" and episode.meta.action == "previous":
            values, is_valid = (np.concatenate([x[1:], x[-1:]]) for x in (values, is_valid))
        rows[name] = values if is_valid.all() else _fill_gaps(name, values, is_valid)
        valid &= is_valid


def _fill_gaps(name: str, values: NDArray, valid: NDArray[np.bool_]) -> NDArray:
    """Return values with each gap filled by the last valid row before it, at the start by the first one.

    The rows stay flagged; what is filled in is finite, so that a masked loss stays so.
    """
    if not valid.any():
        rest = np.zeros_like(values)
        if name in QUATERNION:
            rest[:, QUATERNION[name].start] = 1
        return rest
    last_valid = np.maximum.accumulate(np.where(valid, np.arange(len(valid)), -1))
    return values[np.where(last_valid < 0, np.argmax(valid), last_valid)]


#: Field of the record to the axis it names.
_NAMED_AXES = {"joint_names": "J", "actuator_names": "A", "fingertip_names": "F"}


def _common_names(dataset: Dataset, meta: list[dict], key: str, axis: str, shapes: Shapes) -> tuple[str, ...]:
    """Return the names of an axis; episodes must agree where a channel has that axis."""
    names_by_episode = [tuple(fields.get(key, ())) for fields in meta]
    mismatch = next((i for i, names in enumerate(names_by_episode) if names != names_by_episode[0]), None)
    if mismatch is None:
        return names_by_episode[0]
    if not any(axis in CHANNELS[name].shape for name in shapes):
        return ()
    raise DataError(
        f"episodes differ in their {key.replace('_', ' ')}",
        expected=f"{', '.join(names_by_episode[0]) or 'none'} (episode {dataset.ids[0]})",
        found=", ".join(names_by_episode[mismatch]) or "none",
        where=Where(path=str(dataset.path), episode=dataset.ids[mismatch]),
        fix="keep one hand a dataset, its joints in one order",
    )


def _require_clouds(dataset: Dataset, clouds: Sequence[str | None]) -> None:
    """Refuse episodes whose object has no point cloud."""
    ids_without_cloud = [name for name, cloud in zip(dataset.ids, clouds, strict=True) if cloud is None]
    if ids_without_cloud:
        raise DataError(
            "the dataset lacks point clouds",
            expected=f"a point cloud of the object in all {len(dataset)} episodes",
            found=f"{len(ids_without_cloud)} without one",
            where=Where(path=str(dataset.path), episode=ids_without_cloud[0], channel=POINT_CLOUD),
            fix="generate with a scene that has an object, or take a model without a point cloud",
        )
