"""Tables: Parquet, CSV or npz columns, read as a `map.yaml` says."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.formats import Format
from candata.formats._assemble import checked_episode, gather
from candata.formats._columns import check_lengths, numbers, read_columns, require_file
from candata.formats._features import Pick, blocks, names_of, picked_features
from candata.formats._mapping import check_channels, read_map, time_factor
from candata.formats._stamps import LATEST_NS, likely_unit, require_rate, require_resolution
from candata.formats._table_map import flat_entries, table_picks
from candata.schema.channels import CHANNELS
from candata.schema.episode import ContactRule, Episode, EpisodeMeta
from candata.schema.scene import TableMap

#: Fields that maps did not always have: left out of a digest where not given, so that a source keeps its own.
_LATER_FIELDS = ("quaternion", "joint_names", "actuator_names", "fingertip_names")


def read(source: Path, allow_gaps: bool = False) -> Iterator[Episode]:
    """Yield the episodes of the table that the map file `source` names, in the table's order.

    Parameters
    ----------
    source : Path
        A `map.yaml`; its `file` is relative to its folder.
    allow_gaps : bool
        Mark values that are not finite as invalid instead of refusing them.

    Raises
    ------
    UsageError
        When the map is wrong.
    DataError
        When the table is, or an episode in it.
    """
    source = Path(source)
    mapping = read_map(source)
    yield from read_mapped(mapping, source.parent / mapping.file, allow_gaps, source)


def read_mapped(
    mapping: TableMap, path: Path, allow_gaps: bool = False, map_path: Path | None = None
) -> Iterator[Episode]:
    """Yield the episodes of the table `path` under a map that is at hand; its `file` is not looked at.

    Parameters
    ----------
    map_path : Path, optional
        File of the map, for messages.

    Raises
    ------
    UsageError
        When the map is wrong.
    DataError
        When the table is, or an episode in it.
    """
    _check_map(mapping, map_path or path)
    key_columns = [mapping.time_s] if mapping.episode is None else [mapping.time_s, mapping.episode]
    entries = [entry for channel_entries in mapping.channels.values() for entry in flat_entries(channel_entries)]
    columns = read_columns(path, key_columns, entries)
    yield from episodes(mapping, columns, path, allow_gaps, map_path)


def digest(source: Path) -> str:
    """Return the sha256 over a map and its data file, independent of names and layout of the map.

    Raises
    ------
    UsageError
        When the map is wrong.
    DataError
        When the data file cannot be read.
    """
    source = Path(source)
    mapping = read_map(source)
    path = source.parent / mapping.file
    require_file(path)
    try:
        with path.open("rb") as file:
            data = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        location = Where(path=str(path))
        raise DataError("the table cannot be read", found=error.strerror, where=location) from None
    return map_digest(mapping, data)


def map_digest(mapping: TableMap, data_digest: str) -> str:
    """Return the sha256 over a map and the digest of the data it is applied to."""
    default_fields = {name for name in _LATER_FIELDS if name not in mapping.model_fields_set}
    return hashlib.sha256(f"{mapping.model_dump_json(exclude=default_fields)}\n{data_digest}".encode()).hexdigest()


def episodes(
    mapping: TableMap,
    columns: Mapping[str, NDArray],
    path: Path,
    allow_gaps: bool = False,
    map_path: Path | None = None,
) -> Iterator[Episode]:
    """Yield the episodes in `columns`; `path` names the file for messages and episode ids.

    Parameters
    ----------
    columns : mapping of str to ndarray
        Each `(T,)`, or `(T, k)` where every row holds a list.
    map_path : Path, optional
        File of the map, for messages.

    Raises
    ------
    UsageError
        When the map is wrong.
    DataError
        When a column is, or an episode.
    """
    channel_picks = table_picks(mapping, columns, map_path or path)
    check_lengths(columns, path)
    time_ns = _time_ns(columns[mapping.time_s], time_factor(mapping, path), mapping, path)
    flags = {name for pick in channel_picks if CHANNELS[pick.channel].dtype == "bool" for name, _ in pick.parts}
    values = {
        c: numbers(columns[c], c, path, c in flags).reshape(len(time_ns), -1) for c in picked_features(channel_picks)
    }
    table = _Table(mapping, channel_picks, time_ns, values, path, allow_gaps)
    for label, rows in _groups(mapping, columns, len(time_ns), path):
        yield _episode(table, rows, path.stem if label is None else f"{path.stem}-{label}")


@dataclass(frozen=True)
class _Table:
    """A table at hand: its map, how channels are made, its time in ns, its columns as `(T, k)`, its file."""

    mapping: TableMap
    picks: tuple[Pick, ...]
    time_ns: NDArray[np.int64]
    values: Mapping[str, NDArray[np.float64]]
    path: Path
    allow_gaps: bool

    def say_unit(self, unit: str) -> str:
        """Return what a map says of stamps in a unit."""
        return f"`units: {{{self.mapping.time_s}: {unit}}}`"


def _check_map(mapping: TableMap, path: Path) -> None:
    """Refuse what is wrong with a map whatever its table holds."""
    check_channels(mapping.channels, Where(path=str(path)))
    time_factor(mapping, path)


def _groups(
    mapping: TableMap, columns: Mapping[str, NDArray], total: int, path: Path
) -> Iterator[tuple[str | None, NDArray[np.intp]]]:
    """Yield each episode's label and rows, by first appearance; rows keep the file's order."""
    if mapping.episode is None:
        yield None, np.arange(total)
        return
    labels = columns[mapping.episode]
    if labels.dtype.kind not in "biufMUSO" or any(not isinstance(label, Hashable) for label in labels):
        raise DataError(
            f"column {mapping.episode} does not name an episode",
            expected="numbers or texts",
            found=f"{labels[0]!r}"[:80],
            where=Where(path=str(path)),
        )
    empty_rows = [k for k, v in enumerate(labels) if v is None or v != v] if labels.dtype.kind in "fO" else []
    if empty_rows:
        raise DataError(
            f"column {mapping.episode} does not name an episode",
            expected="a value in every row",
            found="an empty cell",
            where=Where(path=str(path), index=empty_rows[0]),
        )
    is_float = labels.dtype.kind == "f"
    odd_rows = np.flatnonzero(~np.isfinite(labels) | (labels != np.rint(labels))) if is_float else np.zeros(0, int)
    if odd_rows.size:
        raise DataError(
            f"column {mapping.episode} does not name an episode",
            expected="whole numbers or texts",
            found=f"{labels[odd_rows[0]]}",
            where=Where(path=str(path), index=int(odd_rows[0])),
            fix="give the column that numbers the episodes, or leave `episode` out for one episode",
        )
    unique_labels, first_rows, inverse = np.unique(labels, return_index=True, return_inverse=True)
    by_label = np.split(np.argsort(inverse, kind="stable"), np.cumsum(np.bincount(inverse))[:-1])
    for k in np.argsort(first_rows):
        value = unique_labels[k]
        yield str(int(value) if is_float else value), by_label[k]


def _time_ns(values: NDArray, factor: float, mapping: TableMap, path: Path) -> NDArray[np.int64]:
    """Return `(T,) int64 [ns]`; whole numbers stay exact."""
    column = mapping.time_s
    is_missing: NDArray[np.bool_]
    if values.dtype.kind == "M":
        is_missing = np.isnat(values)
        stamps = values.astype("datetime64[ns]")
        time_ns, is_far = stamps.astype(np.int64), ~is_missing & (stamps.astype(values.dtype) != values)
    elif values.dtype.kind in "iu":
        is_missing, unit_ns = np.zeros(len(values), bool), round(factor * 1e9)
        is_far = np.abs(values.astype(np.float64)) * unit_ns >= LATEST_NS
        time_ns = np.where(is_far, 0, values).astype(np.int64) * unit_ns
    else:
        seconds = numbers(values, column, path) * factor
        if values.dtype == np.float32:
            require_resolution(seconds.astype(np.float32), mapping.rate_hz, Where(path=str(path)))
        is_missing = ~np.isfinite(seconds)
        is_far = ~is_missing & (np.abs(seconds) >= LATEST_NS * 1e-9)
        time_ns = np.rint(np.where(is_missing | is_far, 0.0, seconds) * 1e9).astype(np.int64)
    if is_missing.any():
        raise DataError(
            "time is missing",
            expected="a number in every row",
            found=f"{is_missing.sum()} rows without",
            where=Where(path=str(path), channel="time_ns", index=int(np.argmax(is_missing))),
            fix="drop the rows that have no time",
        )
    if is_far.any():
        unit = likely_unit(values * factor, mapping.rate_hz) if values.dtype.kind in "iuf" else "ns"
        raise DataError(
            "time lies further away than ns can say",
            expected="within 292 years of zero",
            found=str(values[is_far][0]),
            where=Where(path=str(path), channel="time_ns", index=int(np.argmax(is_far))),
            fix=f"give the unit of the time column, such as units: {{{column}: {unit}}}",
        )
    return time_ns


def _episode(table: _Table, rows: NDArray[np.intp], identity: str) -> Episode:
    """Return one checked episode; a problem in it also names the file."""
    location = Where(path=str(table.path), episode=identity)
    channel_blocks = blocks(table.picks, {name: values[rows] for name, values in table.values.items()})
    episode_arrays = gather(table.time_ns[rows], channel_blocks, rows, location, table.allow_gaps)
    episode = checked_episode(
        _meta(table, identity, episode_arrays.rule, episode_arrays.invalid), episode_arrays.arrays, table.path
    )
    require_rate(episode["time_ns"] * 1e-9, table.mapping.rate_hz, location, table.say_unit)
    return episode


def _meta(table: _Table, identity: str, rule: ContactRule | None, invalid: dict[str, int]) -> EpisodeMeta:
    """Return who, what and when of an episode."""
    mapping, names = table.mapping, names_of(table.picks)
    return EpisodeMeta(
        id=identity,
        source=mapping.source,
        rate_hz=mapping.rate_hz,
        scene=mapping.scene,
        object=mapping.object,
        task=mapping.task,
        force=mapping.force,
        action=mapping.action,
        joint_names=names["joint_names"],
        actuator_names=names["actuator_names"],
        fingertip_names=names["fingertip_names"],
        contact_rule=rule,
        invalid_counts=invalid,
        unscaled=names["unscaled"],
    )


FORMAT = Format(
    name="table",
    summary="Parquet, CSV or npz columns, mapped by a map.yaml",
    read=lambda source, reading: read(source, reading.allow_gaps),
)
