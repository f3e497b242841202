"""LeRobot sets as episodes: exactly where candata wrote them, else by a map or by the features' names."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.formats import Reading
from candata.formats._by_map import digest_of, even_time_ns, mapped_episode
from candata.formats._features import Pick, blocks, picks, wanted
from candata.formats._lerobot_layout import (
    BOOKKEEPING,
    INFO,
    SIDECAR,
    Entry,
    Folder,
    is_numbers,
    meta_files,
    open_folder,
    read_table,
    read_text,
)
from candata.formats._lerobot_names import ACTION, STATE, guess
from candata.formats._map_file import read_map_file
from candata.formats._sidecar import give_clouds, parse_export, restored
from candata.schema.episode import Episode
from candata.schema.exchange import ExportFile, FeatureMap

#: Distance of a stamp from frame_index / fps up to which it counts as on the beat: lerobot's own tolerance_s [s].
_ON_BEAT_S = 1e-4
#: Joint positions beyond it are no rad (two turns each way) or m, unless a map says so.
_LARGEST_POSITION = 4 * np.pi


def read(source: Path, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes of a LeRobot folder in their order.

    Raises
    ------
    UsageError
        When the map is wrong, or the names do not tell what a feature is.
    DataError
        When a file is missing or damaged, or an episode is.
    """
    folder = open_folder(source)
    path = folder.root / SIDECAR
    if reading.mapping is None and path.is_file():
        export = parse_export(read_text(path), path)
        give_clouds(export, reading, path)
        yield from _restored(folder, export, path)
        return
    yield from _by_map(folder, reading)


def digest(source: Path, reading: Reading) -> str:
    """Return the sha256 over the files, the map and what the import was told.

    Raises
    ------
    DataError
        When a file is missing or cannot be read.
    """
    folder = open_folder(source)
    files = meta_files(folder.root) + list(dict.fromkeys(entry.file for entry in folder.entries))
    return digest_of(folder.root, files, reading)


def _restored(folder: Folder, sidecar: ExportFile, path: Path) -> Iterator[Episode]:
    """Yield the episodes that candata exported."""
    if len(sidecar.episodes) != len(folder.entries):
        raise DataError(
            "the sidecar lists other episodes than the set",
            expected=f"{len(sidecar.episodes)} episodes",
            found=str(len(folder.entries)),
            where=Where(path=str(path)),
            fix="remove meta/candata.json to import what is there by its names",
        )
    known = {feature.name for feature in folder.features}
    keys = {one.column: one.key for one in sidecar.columns if one.key in known}
    for entry, arrays in _arrays(folder, tuple(keys.values())):
        own = sidecar.episodes[entry.index]
        yield restored(own, {column: arrays[key] for column, key in keys.items()}, entry.file)


def _by_map(folder: Folder, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes as the map says, or the names."""
    path = reading.mapping or folder.root / INFO
    mapping = read_map_file(FeatureMap, path) if reading.mapping else guess(folder.features, path)
    made = picks(mapping, folder.features, path)
    _say(folder, made, reading)
    rate_hz = mapping.rate_hz or folder.info.fps
    off_beat = 0
    for entry, arrays in _arrays(folder, wanted(made)):
        if reading.mapping is None:
            _check_positions(made, arrays, entry)
        on_beat, time_ns = _time_ns(arrays, rate_hz, entry)
        off_beat += not on_beat
        identity = f"{folder.root.resolve().name}-{entry.index}"
        own = {"rate_hz": rate_hz, "task": " / ".join(entry.tasks) or None}
        yield mapped_episode(identity, time_ns, arrays, made, mapping, reading, entry.file, **own)
    if off_beat:
        reading.note(f"{off_beat} episodes have stamps off the beat of fps: their stamps were kept")


def _say(folder: Folder, made: Sequence[Pick], reading: Reading) -> None:
    """Say what is left out and what is assumed."""
    used = set(wanted(made))
    others = {name: one for name, one in folder.info.features.items() if name not in used and name not in BOOKKEEPING}
    films = [name for name, one in others.items() if one.dtype in ("video", "image")]
    numbers = [name for name, one in others.items() if is_numbers(one)]
    rest = [name for name in others if name not in films + numbers]
    for what, names in (("videos and images", films), ("features without a channel", numbers), ("texts", rest)):
        if names:
            reading.note(f"left out, {what}: {', '.join(names)}")
    if reading.mapping is None:
        kinds = ", ".join(f"{pick.channel} from {wanted([pick])[0]}" for pick in made)
        reading.note(f"by their names: {kinds}; units are taken for SI (rad, m, N), as LeRobot names none")


def _arrays(folder: Folder, names: Sequence[str]) -> Iterator[tuple[Entry, dict[str, NDArray]]]:
    """Yield each episode with its features as `(T, width)`, and its stamps `(T,)`; a file is read once."""
    columns = tuple(dict.fromkeys([*names, "timestamp", "frame_index", "episode_index"]))
    widths = {feature.name: feature.width for feature in folder.features}
    for file, group in itertools.groupby(folder.entries, key=lambda entry: entry.file):
        table = read_table(file, columns)
        whose = _column(table, "episode_index", 1, file)[:, 0]
        for entry in group:
            rows = np.flatnonzero(whose == entry.index)
            _check_rows(entry, rows)
            part = table.slice(int(rows[0]), len(rows))
            arrays = {name: _column(part, name, widths[name], file) for name in names}
            yield entry, arrays | {name: _column(part, name, 1, file)[:, 0] for name in columns[-3:-1]}


def _check_rows(entry: Entry, rows: NDArray) -> None:
    """Raise unless the rows of an episode are as many as it claims, one after the other."""
    where = Where(path=str(entry.file), episode=str(entry.index))
    if len(rows) != entry.rows or not len(rows):
        raise DataError(
            "the file does not hold the episode's rows",
            expected=f"{entry.rows} rows",
            found=str(len(rows)),
            where=where,
            fix="the set was not closed or was edited; get it again from its source",
        )
    if rows[-1] - rows[0] != len(rows) - 1:
        raise DataError("the rows of an episode do not follow each other", found="rows of another between", where=where)


def _column(table: pa.Table, name: str, width: int, path: Path) -> NDArray:
    """Return a column as `(T, width)`: numbers, lists, or lists of lists; a missing value is NaN."""
    values: pa.Array = table[name].combine_chunks()
    if isinstance(values, pa.ExtensionArray):
        values = values.storage
    where = Where(path=str(path), channel=name)
    even = True
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        if values.null_count:
            raise DataError("a row has no value", expected=f"{width} numbers", found="an empty cell", where=where)
        even &= len(pc.unique(pc.list_value_length(values))) < 2
        values = values.flatten()
    kind = values.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        raise DataError(f"{name} does not hold numbers", expected="numbers", found=str(kind), where=where)
    if not even or len(values) != table.num_rows * width:
        raise DataError(
            f"{name} has rows of another size than meta/info.json says",
            expected=f"{table.num_rows} rows of {width}",
            found=f"{len(values)} numbers" if even else "rows of different sizes",
            where=where,
        )
    if pa.types.is_boolean(kind) and values.null_count:
        values = values.cast(pa.uint8())
    return values.to_numpy(zero_copy_only=False).reshape(table.num_rows, width)


def _time_ns(arrays: dict[str, NDArray], rate_hz: float, entry: Entry) -> tuple[bool, NDArray[np.int64]]:
    """Return whether the stamps lie on the beat, and `(T,) int64 [ns]`: the beat itself, else the stamps."""
    where = Where(path=str(entry.file), episode=str(entry.index), channel="time_ns")
    frames = np.arange(entry.rows)
    odd = np.flatnonzero(arrays["frame_index"] != frames)
    if len(odd):
        raise DataError(
            "frames are missing",
            expected=f"frame_index {odd[0]}",
            found=str(arrays["frame_index"][odd[0]]),
            where=dataclasses.replace(where, index=int(odd[0])),
            fix="LeRobot numbers the frames of an episode 0, 1, 2, ...; get the set again from its source",
        )
    stamps = arrays["timestamp"].astype(np.float64)
    if not (np.abs(stamps) < 1e9).all():
        raise DataError("a stamp is no time in seconds", found=str(stamps[~(np.abs(stamps) < 1e9)][0]), where=where)
    if (np.abs(stamps - frames / rate_hz) <= _ON_BEAT_S + 1e-7 * stamps).all():
        return True, even_time_ns(entry.rows, rate_hz)
    return False, np.rint(stamps * 1e9).astype(np.int64)


def _check_positions(made: Sequence[Pick], arrays: dict[str, NDArray], entry: Entry) -> None:
    """Raise where joint positions, taken by name alone, cannot be rad or m."""
    for block in blocks([pick for pick in made if pick.channel == "joint_position"], arrays):
        largest = np.abs(np.where(np.isfinite(block.values), block.values, 0.0)).max(axis=0)
        column = int(np.argmax(largest))
        if largest[column] > _LARGEST_POSITION:
            raise DataError(
                "the joints' positions are no rad or m",
                expected=f"up to {_LARGEST_POSITION:.1f}",
                found=f"{largest[column]:g} in {block.columns[column]}",
                where=Where(path=str(entry.file), episode=str(entry.index), channel=block.channel),
                fix=f"say the unit with --map FILE: `channels: {{joint_position: {STATE}, action: {ACTION}}}` and "
                "`units: {joint_position: deg, action: deg}`; `rad` or `1` takes them as they are",
            )
