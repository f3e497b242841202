"""The map of a table as the map of features: columns and lists in columns, nested entries, units of columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from numpy.typing import NDArray

from candata.errors import UnknownNameError, UsageError, Where
from candata.formats._features import Feature, Pick, part, picks, width_of_row
from candata.formats._mapping import fits, si_units, unfit
from candata.schema.exchange import FeatureMap
from candata.schema.scene import TableMap
from candata.units import to_si

#: Channels whose elements a field of the map names.
_NAMED_CHANNELS = {
    "joint_names": ("joint_position", "joint_velocity", "joint_effort"),
    "actuator_names": ("action", "torque_on"),
    "fingertip_names": ("fingertip_force", "fingertip_contact"),
}
Entries = str | Sequence[str | tuple[str, ...]]


def flat_entries(entries: Entries) -> tuple[str, ...]:
    """Return the entries of a channel in order, without the lists about them."""
    if isinstance(entries, str):
        return (entries,)
    return tuple(entry for item in entries for entry in ((item,) if isinstance(item, str) else item))


def table_picks(mapping: TableMap, columns: Mapping[str, NDArray], path: Path) -> tuple[Pick, ...]:
    """Return how every channel of a map is made of a table's columns; `path` is the map's, for messages.

    Parameters
    ----------
    columns : mapping of str to ndarray
        Each `(T,)`, or `(T, k)` where every row holds a list.

    Raises
    ------
    UsageError
        When a channel, column or unit is unknown or does not fit, or nesting is wrong.
    DataError
        When two channels disagree about the number of joints or fingertips.
    """
    by_name = {name: _feature(name, values) for name, values in columns.items()}
    _check_units(mapping, by_name, Where(path=str(path)))
    channels: dict[str, str | tuple[str, ...]] = {}
    units: dict[str, str | tuple[str, ...]] = {}
    for channel, entries in mapping.channels.items():
        location = Where(path=str(path), channel=channel)
        _check_nesting(channel, entries, by_name, location)
        channels[channel] = flat_entries(entries)
        if unit := _channel_units(mapping, channel, by_name, location):
            units[channel] = unit
    names = {
        channel: given_names
        for field, of_channels in _NAMED_CHANNELS.items()
        if (given_names := getattr(mapping, field))
        for channel in of_channels
        if channel in channels
    }
    feature_map = FeatureMap(channels=channels, units=units, names=names, quaternion=mapping.quaternion)
    return picks(feature_map, by_name.values(), path)


def _feature(name: str, values: NDArray) -> Feature:
    """Return a column as a feature: one value has the column's name, numbers of a list have none."""
    return Feature(name, 1, (name,)) if values.ndim == 1 else Feature(name, values.shape[1])


def _check_nesting(channel: str, entries: Entries, by_name: Mapping[str, Feature], location: Where) -> None:
    """Raise unless lists stand in lists only where a channel has elements of several numbers, and hold so many."""
    lists = [entry for entry in entries if not isinstance(entry, str)]
    width = width_of_row(channel)
    expected_text = f"a list of lists of {width} columns" if width else "a list of columns"
    counts = [sum(len(part(text, by_name, location)[1]) for text in entry) for entry in lists]
    if entries and not (lists and (width is None or len(lists) < len(entries) or any(n != width for n in counts))):
        return
    problem = f"{channel} has the wrong columns"
    raise UsageError(problem, expected=expected_text, found=_shape_text(entries, counts), where=location)


def _shape_text(entries: Entries, counts: Sequence[int]) -> str:
    """Return what the lists of a channel hold."""
    if not entries:
        return "an empty list"
    single_entries = [entry for entry in entries if isinstance(entry, str)]
    lists = "lists of " + ", ".join(map(str, counts))
    return f"{lists} beside {', '.join(single_entries)}" if single_entries else lists


def _channel_units(
    mapping: TableMap, channel: str, by_name: Mapping[str, Feature], location: Where
) -> str | tuple[str, ...] | None:
    """Return a channel's unit, or one for each of its columns where a column has a unit of its own.

    The unit of a column comes before that of its channel, which applies to the elements that can have it.
    """
    channel_unit, by_column = mapping.units.get(channel), []
    for text in flat_entries(mapping.channels[channel]):
        name, columns = part(text, by_name, location)
        by_column += [_own_unit(mapping.units, text, name, column) for column in columns]
    kinds = si_units(channel, len(by_column))
    if len(kinds) != len(by_column) or not any(by_column):
        return channel_unit
    units = []
    for unit, kind in zip(by_column, kinds, strict=True):
        if unit and not fits(unit, kind):
            raise unfit(next(name for name in mapping.units if mapping.units[name] == unit), unit, kind, location)
        units.append(unit or (channel_unit if channel_unit and fits(channel_unit, kind) else kind[0]))
    return tuple(units)


def _own_unit(units: Mapping[str, str], text: str, name: str, column: int) -> str | None:
    """Return the unit that a map gives one column: by its number, by the entry that takes it, or by its list."""
    return units.get(f"{name}[{column}]") or units.get(text) or units.get(name)


def _check_units(mapping: TableMap, by_name: Mapping[str, Feature], location: Where) -> None:
    """Raise when `units` names what the map does not have, or a unit that is not known."""
    entries = [entry for channel_entries in mapping.channels.values() for entry in flat_entries(channel_entries)]
    known_names = {*entries, *by_name, *mapping.channels, mapping.time_s}
    indexed_names = {f"{f.name}[{i}]" for f in by_name.values() if not f.names for i in range(f.width)}
    for name, unit in mapping.units.items():
        if name not in known_names | indexed_names:
            raise UnknownNameError("channel or column in units", name, _sorted_names(known_names), location)
        to_si(unit, location)


def _sorted_names(names: Iterable[str]) -> list[str]:
    """Return names in order."""
    return sorted(names)
