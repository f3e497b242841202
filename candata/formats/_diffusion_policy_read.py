"""Diffusion Policy buffers as episodes: exactly where candata wrote them, else by a map."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from candata.errors import DataError, UsageError, Where
from candata.formats import Reading
from candata.formats._by_map import even_time_ns, mapped_episode
from candata.formats._features import Feature, mapped_features, picked_features, picks
from candata.formats._map_file import read_map_file
from candata.formats._sidecar import give_clouds, parse_export, restore_episode
from candata.formats._zarr_buffer import (
    Buffer,
    array_names,
    attributes,
    episode_rows,
    find_buffer,
    open_array,
    read_rows,
    width,
)
from candata.schema.episode import Episode
from candata.schema.exchange import ExportFile, FeatureMap

#: Attribute of the root group that holds the sidecar as JSON text.
SIDECAR = "candata"
_ENDS = "meta/episode_ends"


def read(source: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes of a buffer in their order; arrays that nothing asks for are not opened.

    Raises
    ------
    UsageError
        When candata did not write it and there is no map, or the map is wrong.
    DataError
        When the buffer is missing, or what is taken from it is damaged.
    """
    buffer = find_buffer(source)
    side = attributes(buffer).get(SIDECAR)
    if reading.mapping is None and isinstance(side, str):
        export = parse_export(side, buffer.path)
        give_clouds(export, reading, buffer.path)
        yield from _restore_episodes(export, buffer)
        return
    yield from _by_map(buffer, reading)


def _ends(buffer: Buffer, arrays: Mapping[str, Any]) -> list[int]:
    """Return where the episodes end; every array that is taken is as long as the last end."""
    ends_array = open_array(buffer, _ENDS)
    lengths = {name: array.shape[0] for name, array in arrays.items()}
    rows = max(lengths.values(), default=0)
    if ends_array.size > rows:
        raise DataError(
            "episode_ends lists more episodes than there are rows",
            expected=f"at most {rows}",
            found=str(ends_array.size),
            where=buffer.where,
        )
    values = read_rows(buffer, _ENDS, ends_array, 0, ends_array.shape[0]).reshape(-1)
    odd_rows = np.flatnonzero(values.astype(np.int64) != values) if np.isfinite(values).all() else [0]
    if len(odd_rows):
        raise DataError(
            "episode_ends holds what is no whole number",
            expected="the number of rows up to each episode's end",
            found=str(values[odd_rows[0]]),
            where=dataclasses.replace(buffer.where, channel=_ENDS, index=int(odd_rows[0])),
        )
    ends = values.astype(np.int64).tolist()
    if not ends or ends[0] <= 0 or any(b <= a for a, b in itertools.pairwise(ends)):
        raise DataError("episode_ends does not rise", found=str(ends[:5]), where=buffer.where)
    mismatches = [f"{name}: {length}" for name, length in lengths.items() if length != ends[-1]]
    if mismatches:
        raise DataError(
            "the arrays differ in length from the episodes",
            expected=f"{ends[-1]} rows, the last of episode_ends",
            found=", ".join(mismatches),
            where=buffer.where,
        )
    return ends


def _open_arrays(buffer: Buffer, names: Iterable[str]) -> dict[str, Any]:
    """Return arrays of `data` by name; nothing of their values is read yet."""
    return {name: open_array(buffer, f"data/{name}") for name in names}


def _episodes(buffer: Buffer, arrays: Mapping[str, Any], ends: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Yield the arrays of each episode as `(T, width)`."""
    streams = [episode_rows(buffer, f"data/{name}", array, ends) for name, array in arrays.items()]
    for rows in zip(*streams, strict=True):
        yield dict(zip(arrays, rows, strict=True))


def _restore_episodes(export: ExportFile, buffer: Buffer) -> Iterator[Episode]:
    """Yield the episodes that candata exported."""
    known_names = array_names(buffer)
    keys = {column.column: column.key for column in export.columns if column.key in known_names}
    arrays = _open_arrays(buffer, dict.fromkeys(keys.values()))
    ends = _ends(buffer, arrays)
    if len(export.episodes) != len(ends):
        raise DataError(
            "the sidecar lists other episodes than the buffer",
            expected=str(len(export.episodes)),
            found=str(len(ends)),
            where=buffer.where,
        )
    for entry, rows in zip(export.episodes, _episodes(buffer, arrays, ends), strict=False):
        yield restore_episode(entry, {column: rows[key] for column, key in keys.items()}, buffer.path)


def _by_map(buffer: Buffer, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes as the map says."""
    known_names = array_names(buffer)
    if reading.mapping is None:
        raise UsageError(
            "the buffer does not say what its arrays are, nor its rate",
            found=", ".join(known_names),
            where=buffer.where,
            fix="say it with --map FILE, such as `rate_hz: 10` and `channels: {joint_position: 'state[0:7]'}`",
        )
    mapping = read_map_file(FeatureMap, reading.mapping)
    arrays = _open_arrays(buffer, mapped_features(mapping, known_names))
    features = [Feature(name, width(arrays[name]) if name in arrays else 0) for name in known_names]
    channel_picks = picks(mapping, features, reading.mapping)
    if mapping.rate_hz is None:
        raise UsageError("the map lacks rate_hz", where=Where(path=str(reading.mapping)), fix="add `rate_hz: 10`")
    read_arrays = {name: arrays[name] for name in picked_features(channel_picks)}
    left_out = [name for name in known_names if name not in read_arrays]
    if left_out:
        reading.note(f"left out: {', '.join(left_out)}")
    ends = _ends(buffer, read_arrays)
    file_facts = {"rate_hz": mapping.rate_hz}
    for index, (rows, start, end) in enumerate(
        zip(_episodes(buffer, read_arrays, ends), [0, *ends], ends, strict=False)
    ):
        identity, time_ns = f"{buffer.stem}-{index}", even_time_ns(end - start, mapping.rate_hz)
        yield mapped_episode(identity, time_ns, rows, channel_picks, mapping, reading, buffer.path, **file_facts)
