"""The sidecar of an export: what a foreign layout cannot hold, and the way back to the exact episodes."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.datasets.clouds import cloud_hash
from candata.datasets.encode import content_hash, hash_columns, meta_json
from candata.errors import DataError, Where
from candata.formats import Reading, Writing
from candata.formats._assemble import checked_episode
from candata.schema.channels import CHANNELS, VALID_SUFFIX
from candata.schema.episode import Episode
from candata.schema.exchange import SIDECAR_VERSION, ExportedColumn, ExportedEpisode, ExportFile
from candata.schema.json_text import parse_json
from candata.schema.text_bounds import TextError


def exported_episode(episode: Episode) -> ExportedEpisode:
    """Return what an import needs beside the arrays of an episode."""
    layout = {name: array.shape[1:] for name, array in episode.arrays.items()}
    return ExportedEpisode(meta=episode.meta, rows=len(episode), content_hash=content_hash(episode), layout=layout)


def sidecar(
    writing: Writing, keys: Mapping[str, str], clouds: Iterable[str], episodes: Iterable[ExportedEpisode] = ()
) -> ExportFile:
    """Return the sidecar of an export; `keys` is where each column lies, `clouds` what the episodes name."""
    columns = tuple(_column(name, key) for name, key in keys.items())
    points = {} if writing.cloud is None else {name: writing.cloud(name) for name in clouds}
    return ExportFile(
        dataset=writing.name,
        digest=writing.digest,
        lineage=writing.lineage,
        columns=columns,
        episodes=tuple(episodes),
        clouds={name: base64.b64encode(cloud.astype("<f4").tobytes()).decode() for name, cloud in points.items()},
    )


def give_clouds(export: ExportFile, reading: Reading, path: object) -> None:
    """Pass on the point clouds of a sidecar, each checked against its name.

    Raises
    ------
    DataError
        When one is damaged.
    """
    for name, code in export.clouds.items():
        try:
            cloud = np.frombuffer(base64.b64decode(code, validate=True), "<f4").reshape(-1, 3)
        except ValueError as error:
            raise _altered_error(str(error), Where(path=str(path), channel="point_cloud")) from None
        if cloud_hash(cloud.astype(np.float32)) != name:
            raise _altered_error(f"a cloud that is not {name[:12]}", Where(path=str(path), channel="point_cloud"))
        reading.cloud(cloud)


def text(record: ExportFile | ExportedEpisode) -> str:
    """Return a sidecar as JSON."""
    return json.dumps(record.model_dump(mode="json"), ensure_ascii=False)


def parse_export(value: str | bytes, path: object) -> ExportFile:
    """Return the sidecar in JSON text.

    Raises
    ------
    DataError
        When the text is no JSON, or of a version that is not known.
    UsageError
        When a field is missing, unknown or wrong.
    """
    record = json_of(value, path)
    version = record.get("format_version") if isinstance(record, dict) else None
    if version != SIDECAR_VERSION:
        raise DataError(
            "the sidecar has another version",
            expected=f"format_version {SIDECAR_VERSION}",
            found=repr(version)[:80],
            where=Where(path=str(path)),
            fix="import with the candata that wrote it, or without the sidecar",
        )
    return ExportFile.parse(record, str(path))


def parse_episode(value: str | bytes, path: object) -> ExportedEpisode:
    """Return the sidecar of one episode in JSON text.

    Raises
    ------
    DataError
        When the text is no JSON.
    UsageError
        When a field is missing, unknown or wrong.
    """
    return ExportedEpisode.parse(json_of(value, path), str(path))


def json_of(value: str | bytes, path: object) -> Any:
    """Return the value of JSON text.

    Raises
    ------
    DataError
        When it is no JSON; says where.
    """
    try:
        return parse_json(value, finite=False)
    except TextError as error:
        raise DataError(
            "the file is no JSON", found=str(error)[:200], where=Where(path=str(path)), fix="restore it from a copy"
        ) from None


def restore_episode(entry: ExportedEpisode, arrays: Mapping[str, NDArray], path: object) -> Episode:
    """Return the episode that was exported, bit for bit.

    Parameters
    ----------
    entry : ExportedEpisode
        Its part of the sidecar.
    arrays : mapping of str to ndarray
        By column, `(T, n)` or `(T,)`; columns without elements may be absent.
    path : object
        File, for messages.

    Raises
    ------
    DataError
        When an array is missing or of another size, or the content is not what was exported.
    """
    location = Where(path=str(path), episode=entry.meta.id)
    try:
        columns = {name: _reshape(name, shape, entry.rows, arrays) for name, shape in entry.layout.items()}
    except (KeyError, ValueError, MemoryError, OverflowError) as error:
        raise _altered_error(f"{type(error).__name__}: {error}", location) from None
    digest = hash_columns(meta_json(entry.meta), columns)
    if digest != entry.content_hash:
        raise _altered_error(f"content {digest[:12]}", location, f"content {entry.content_hash[:12]}")
    return checked_episode(entry.meta, columns, path)


def _reshape(name: str, shape: tuple[int, ...], rows: int, arrays: Mapping[str, NDArray]) -> NDArray:
    """Return a column in the shape it had."""
    flag = name.endswith(VALID_SUFFIX)
    dtype = "bool" if flag else CHANNELS[name].dtype
    if not math.prod(shape):
        return np.zeros((rows, *shape), dtype)
    with np.errstate(over="ignore", invalid="ignore"):  # what does not fit has another hash
        return arrays[name].reshape(rows, *shape).astype(dtype, copy=False)


def _altered_error(found: str, location: Where, expected: str | None = None) -> DataError:
    """Return the error of an export that was changed after it was written."""
    return DataError(
        "the data are not what was exported",
        expected=expected,
        found=found,
        where=location,
        fix="export again; or remove the sidecar to import what is there by its names",
    )


def _column(name: str, key: str) -> ExportedColumn:
    """Return what a column's numbers mean."""
    channel = CHANNELS[name.removesuffix(VALID_SUFFIX)]
    if name.endswith(VALID_SUFFIX):
        return ExportedColumn(
            column=name, key=key, unit="1", frame="", meaning=f"{channel.name} holds a value in this row"
        )
    return ExportedColumn(column=name, key=key, unit=channel.unit, frame=channel.frame, meaning=channel.meaning)
