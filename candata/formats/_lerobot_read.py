"""LeRobot sets as episodes: exactly where candata wrote them, else by a map or by the features' names."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from candata.errors import DataError, UsageError, Where
from candata.formats import Reading
from candata.formats._by_map import even_time_ns, mapped_episode
from candata.formats._features import Pick, picked_features, picks
from candata.formats._lerobot_layout import (
    BOOKKEEPING_COLUMNS,
    INFO,
    SIDECAR,
    Entry,
    Folder,
    is_numbers,
    open_folder,
    read_text,
)
from candata.formats._lerobot_names import guess
from candata.formats._lerobot_percent import largest_positions, note_percent
from candata.formats._lerobot_rows import FRAME, STAMP, episode_arrays
from candata.formats._map_file import read_map_file
from candata.formats._sidecar import give_clouds, parse_export, restore_episode
from candata.formats._stamps import times_ns
from candata.schema.episode import Episode
from candata.schema.exchange import ExportFile, FeatureMap
from candata.units import TO_SI

#: Distance of a stamp from frame_index / fps up to which it counts as on the beat: lerobot's own tolerance_s [s].
_ON_BEAT_S = 1e-4
#: Units that stamps may be in.
TIME_UNITS = ("s", "ms", "us", "ns")


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
        yield from _restore_episodes(folder, export, path, reading.note)
        return
    yield from _by_map(folder, reading)


def _restore_episodes(
    folder: Folder, sidecar: ExportFile, path: Path, note: Callable[[str], None]
) -> Iterator[Episode]:
    """Yield the episodes that candata exported."""
    if len(sidecar.episodes) != len(folder.entries):
        raise DataError(
            "the sidecar lists other episodes than the set",
            expected=f"{len(sidecar.episodes)} episodes",
            found=str(len(folder.entries)),
            where=Where(path=str(path)),
            fix="remove meta/candata.json to import what is there by its names",
        )
    known_names = {feature.name for feature in folder.features}
    keys = {column.column: column.key for column in sidecar.columns if column.key in known_names}
    for entry, arrays in episode_arrays(folder, tuple(keys.values()), note):
        exported_episode = sidecar.episodes[entry.index]
        yield restore_episode(exported_episode, {column: arrays[key] for column, key in keys.items()}, entry.file)


def _by_map(folder: Folder, reading: Reading) -> Iterator[Episode]:
    """Yield the episodes as the map says, or the names."""
    path = reading.mapping or folder.root / INFO
    mapping = read_map_file(FeatureMap, path) if reading.mapping else guess(folder.features, path)
    mapping, stamp_s = _stamp_unit(mapping, path)
    channel_picks = picks(mapping, folder.features, path)
    _say(folder, channel_picks, reading)
    rate_hz = mapping.rate_hz or folder.info.fps
    off_beat, largest_raw = 0, np.zeros(1)
    map_hint = "" if reading.mapping else f", with `channels: {_flow(mapping.channels)}`"
    for entry, arrays in episode_arrays(folder, picked_features(channel_picks), reading.note):
        largest_raw = np.maximum(largest_raw, largest_positions(mapping, channel_picks, arrays, entry))
        on_beat, time_ns = _time_ns(arrays, stamp_s, rate_hz, entry, map_hint)
        off_beat += not on_beat
        identity = f"{folder.root.resolve().name}-{entry.index}"
        file_facts = {"rate_hz": rate_hz, "task": " / ".join(entry.tasks) or None}
        yield mapped_episode(identity, time_ns, arrays, channel_picks, mapping, reading, entry.file, **file_facts)
    if off_beat:
        reading.note(f"{off_beat} episodes have stamps off the beat of fps: their stamps were kept")
    note_percent(mapping, channel_picks, largest_raw, reading)


def _flow(value: object) -> str:
    """Return a value as YAML in one line."""
    return yaml.safe_dump(value, default_flow_style=True, width=float("inf")).strip()


def _stamp_unit(mapping: FeatureMap, path: Path) -> tuple[FeatureMap, float]:
    """Return the map without the unit of the stamps, and the factor from that to seconds."""
    unit = mapping.units.get(STAMP, "s")
    if unit not in TIME_UNITS:
        raise UsageError(
            f"{STAMP} cannot be in {unit}", expected=f"one of {', '.join(TIME_UNITS)}", where=Where(path=str(path))
        )
    units = {name: value for name, value in mapping.units.items() if name != STAMP}
    return mapping.model_copy(update={"units": units}), TO_SI[str(unit)]


def _say(folder: Folder, channel_picks: Sequence[Pick], reading: Reading) -> None:
    """Say what is left out and what is assumed."""
    used = set(picked_features(channel_picks))
    unused_features = {
        name: info
        for name, info in folder.info.features.items()
        if name not in used and name not in BOOKKEEPING_COLUMNS
    }
    films = [name for name, info in unused_features.items() if info.dtype in ("video", "image")]
    numbers = [name for name, info in unused_features.items() if is_numbers(info)]
    rest = [name for name in unused_features if name not in films + numbers]
    for label, names in (("videos and images", films), ("features without a channel", numbers), ("texts", rest)):
        if names:
            reading.note(f"left out, {label}: {', '.join(names)}")
    if reading.mapping is None:
        kinds = ", ".join(f"{pick.channel} from {picked_features([pick])[0]}" for pick in channel_picks)
        reading.note(f"by their names: {kinds}; units are taken for SI (rad, m, N), as LeRobot names none")


def _time_ns(
    arrays: dict[str, NDArray], stamp_s: float, rate_hz: float, entry: Entry, map_hint: str
) -> tuple[bool, NDArray[np.int64]]:
    """Return whether the stamps lie on the beat, and `(T,) int64 [ns]`: the beat itself, else the stamps.

    The beat begins at the first stamp: 0 where LeRobot recorded, unix time in sets of others. `map_hint` is what a map
    needs beside a unit.
    """
    location = Where(path=str(entry.file), episode=str(entry.index), channel="time_ns")
    frames = np.arange(entry.rows)
    odd_frames = np.flatnonzero(arrays[FRAME] != frames)
    if len(odd_frames):
        raise DataError(
            "frames are missing",
            expected=f"{FRAME} {odd_frames[0]}",
            found=str(arrays[FRAME][odd_frames[0]]),
            where=dataclasses.replace(location, index=int(odd_frames[0])),
            fix="LeRobot numbers the frames of an episode 0, 1, 2, ...; get the set again from its source",
        )
    stamps = arrays[STAMP] * stamp_s  # float32 stays float32, whole numbers become float64
    stamps_ns = times_ns(
        stamps, rate_hz, location, lambda unit: f"`units: {{{STAMP}: {unit}}}` in a --map FILE{map_hint}"
    )
    beat = stamps_ns[0] + even_time_ns(entry.rows, rate_hz)
    rounding_error = np.finfo(arrays[STAMP].dtype).eps if arrays[STAMP].dtype.kind == "f" else 0.0
    on_beat = bool((np.abs(stamps_ns - beat) * 1e-9 <= _ON_BEAT_S + rounding_error * np.abs(stamps_ns) * 1e-9).all())
    return on_beat, beat if on_beat else stamps_ns
