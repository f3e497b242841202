"""Named arrays as channels: which columns of which feature, in which unit, as a feature map says."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.formats._assemble import Block
from candata.formats._mapping import check_channels, fits, si_units, unfit
from candata.formats._names import element_names, fingertip_names, split_entry
from candata.schema.channels import CHANNELS, QUATERNION
from candata.schema.exchange import FeatureMap
from candata.units import TO_SI, to_si

#: Columns of a pose whose quaternion is x y z w, in the order w x y z.
_XYZW = (0, 1, 2, 6, 3, 4, 5)
#: Last words of a column's name that say what it holds and not which joint it belongs to.
_ENDINGS = (".pos", ".vel", ".effort", ".torque")
#: Columns that a channel may take of one feature; only pictures have more.
_MOST_COLUMNS = 10_000


@dataclass(frozen=True)
class Feature:
    """A named array of a file: its columns, and their names where the file gives any."""

    name: str
    width: int
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Pick:
    """The recipe of one channel.

    Attributes
    ----------
    channel : str
        Name of the channel.
    parts : tuple of (str, tuple of int)
        Features and the numbers of their columns, side by side.
    shape : tuple of int
        Shape of one row.
    factors : tuple of float
        Factor to SI of each column.
    columns : tuple of str
        What each column is called.
    elements : tuple of str
        Names of joints, actuators or fingertips, where they are known.
    """

    channel: str
    parts: tuple[tuple[str, tuple[int, ...]], ...]
    shape: tuple[int, ...]
    factors: tuple[float, ...]
    columns: tuple[str, ...]
    elements: tuple[str, ...]


def picks(mapping: FeatureMap, features: Iterable[Feature], path: Path) -> tuple[Pick, ...]:
    """Return how every channel of a map is made; `path` is the map's, for messages.

    Raises
    ------
    UsageError
        When a channel, feature, column or unit is unknown or does not fit, or neither object_pose nor
        joint_position is made.
    DataError
        When two channels disagree about the number of joints or fingertips.
    """
    location = Where(path=str(path))
    check_channels(dict.fromkeys((*mapping.channels, *mapping.units, *mapping.scales, *mapping.names)), location)
    for name in (*mapping.units, *mapping.scales, *mapping.names):
        if name not in mapping.channels:
            raise UsageError(f"the map speaks of {name}, but does not say what it is made of", where=location)
    by_name = {feature.name: feature for feature in features}
    channel_picks = tuple(_pick(mapping, name, by_name, path) for name in mapping.channels)
    _check_counts(channel_picks, path)
    return _with_common_supply(channel_picks)


def _with_common_supply(channel_picks: Sequence[Pick]) -> tuple[Pick, ...]:
    """Return the picks with a single column of the supply taken for every actuator: they share it."""
    actuators = sum(pick.shape[0] for pick in channel_picks if pick.channel == "action")
    return tuple(
        replace(
            pick,
            parts=pick.parts * actuators,
            shape=(actuators,),
            factors=pick.factors * actuators,
            columns=pick.columns * actuators,
            elements=(),
        )
        if pick.channel == "supply_voltage" and pick.shape == (1,) and actuators
        else pick
        for pick in channel_picks
    )


def mapped_features(mapping: FeatureMap, names: Iterable[str]) -> tuple[str, ...]:
    """Return the features of these that a map uses; the others need not be opened."""
    entries = [text for entry in mapping.channels.values() for text in ((entry,) if isinstance(entry, str) else entry)]
    return tuple(
        name for name in names if any(text == name or text.startswith((f"{name}[", f"{name} [")) for text in entries)
    )


def blocks(channel_picks: Iterable[Pick], arrays: Mapping[str, NDArray]) -> list[Block]:
    """Return the channels of rows: `arrays` holds each feature as `(T, width)`."""
    channel_blocks = []
    for pick in channel_picks:
        parts = [arrays[name][:, list(columns)].astype(np.float64) for name, columns in pick.parts]
        values = np.concatenate(parts, axis=1) * np.array(pick.factors)
        channel_blocks.append(Block(pick.channel, values, pick.columns, pick.shape))
    return channel_blocks


def picked_features(channel_picks: Iterable[Pick]) -> tuple[str, ...]:
    """Return the features that the picks read, each once."""
    return tuple(dict.fromkeys(name for pick in channel_picks for name, _ in pick.parts))


def names_of(channel_picks: Sequence[Pick]) -> dict[str, tuple[str, ...]]:
    """Return the fields of an episode's record that name joints, actuators and fingertips."""
    by_channel = {pick.channel: pick.elements for pick in channel_picks}

    def first_names(*channels: str) -> tuple[str, ...]:
        return next((by_channel[name] for name in channels if by_channel.get(name)), ())

    return {
        "joint_names": first_names("joint_position", "joint_velocity", "joint_effort"),
        "actuator_names": first_names("action"),
        "fingertip_names": first_names("fingertip_force", "fingertip_contact"),
    }


def _pick(mapping: FeatureMap, channel: str, by_name: Mapping[str, Feature], path: Path) -> Pick:
    """Return how one channel is made."""
    location = Where(path=str(path), channel=channel)
    entry = mapping.channels[channel]
    parts = tuple(part(text, by_name, location) for text in ((entry,) if isinstance(entry, str) else entry))
    feature_columns = [(by_name[name], column) for name, columns in parts for column in columns]
    _check_repeats(channel, feature_columns, location)
    shape = _shape(channel, [_label(feature, column) for feature, column in feature_columns], location)
    if channel in QUATERNION and mapping.quaternion == "xyzw":
        feature_columns = [feature_columns[i] for i in _XYZW]
        parts = tuple((feature.name, (column,)) for feature, column in feature_columns)
    columns = tuple(_label(feature, column) for feature, column in feature_columns)
    column_names = tuple(feature.names[column] if feature.names else "" for feature, column in feature_columns)
    _check_quaternion(channel, column_names, location)
    units = _factors(channel, mapping.units.get(channel), len(feature_columns), location)
    scales = _scales(channel, mapping.scales.get(channel, 1.0), len(feature_columns), location)
    factors = tuple(unit * scale for unit, scale in zip(units, scales, strict=True))
    elements = _elements(channel, column_names, shape, mapping.names.get(channel), location)
    return Pick(channel, parts, shape, factors, columns, elements)


def part(text: str, by_name: Mapping[str, Feature], location: Where) -> tuple[str, tuple[int, ...]]:
    """Return a feature and the numbers of its columns from `feature` or `feature[columns]`.

    Raises
    ------
    UnknownNameError, UsageError
        When the feature or a column of it is not there.
    """
    name, column_text = split_entry(text, by_name)
    if name not in by_name:
        raise UnknownNameError("feature", name, by_name, location)
    feature = by_name[name]
    if feature.width > _MOST_COLUMNS:
        raise UsageError(
            f"{name} is too wide for a channel",
            expected=f"at most {_MOST_COLUMNS} columns",
            found=str(feature.width),
            where=location,
        )
    if column_text is None:
        return name, tuple(range(feature.width))
    columns = [column for word in column_text.split(",") for column in _columns(word.strip(), feature, location)]
    if not columns:
        raise UsageError("the map picks no column", found=text, where=location)
    return name, tuple(columns)


def _columns(word: str, feature: Feature, location: Where) -> list[int]:
    """Return the columns that `3`, `2:5` or a name means."""
    if word in feature.names:
        return [feature.names.index(word)]
    bounds = re.fullmatch(r"(\d{0,9}):(\d{0,9})|(\d{1,9})", word)
    if bounds is None:
        raise UnknownNameError(f"column of {feature.name}", word, feature.names, location)
    low, high, single_number = bounds.groups()
    start = int(single_number or low or 0)
    stop = start + 1 if single_number else int(high or feature.width)
    if not start < stop <= feature.width:
        raise UsageError(
            f"{feature.name} has no columns {word}",
            expected=f"numbers from 0 to {feature.width - 1}; a range leaves out its end",
            found=word,
            where=location,
        )
    return list(range(start, stop))


def _label(feature: Feature, column: int) -> str:
    """Return what a column is called in messages."""
    if feature.names == (feature.name,):
        return feature.name
    return f"{feature.name}[{feature.names[column] if feature.names else column}]"


def width_of_row(channel: str) -> int | None:
    """Return how many numbers each element of a channel has; None where it has one."""
    symbols = CHANNELS[channel].shape[1:]
    return int(symbols[-1]) if len(symbols) == 2 else None


def _shape(channel: str, columns: Sequence[str], location: Where) -> tuple[int, ...]:
    """Return the shape of a row of these columns."""
    width = len(columns)
    symbols = CHANNELS[channel].shape[1:]
    row_width = symbols[-1] if symbols else 1
    is_fixed = len(symbols) < 2 and isinstance(row_width, int)
    if isinstance(row_width, int) and (width != row_width if is_fixed else width % row_width):
        raise UsageError(
            f"{channel} has the wrong number of columns",
            expected=f"{row_width} columns" if is_fixed else f"{row_width} columns a fingertip",
            found=f"{width}: {', '.join(columns)}"[:200],
            where=location,
        )
    return {0: (), 1: (width,), 2: (width // 3, 3)}[len(symbols)]


def _factors(channel: str, unit: str | tuple[str, ...] | None, width: int, location: Where) -> tuple[float, ...]:
    """Return the factor to SI of each column; one unit applies to those elements that can have it."""
    kinds = si_units(channel, width)
    if unit is None:
        return (1.0,) * width
    if isinstance(unit, str):
        to_si(unit, location)
        if not any(fits(unit, kind) for kind in kinds):
            raise unfit(channel, unit, kinds[0], location)
        return tuple(TO_SI[unit] if fits(unit, kind) else 1.0 for kind in kinds)
    if len(unit) != width:
        raise UsageError(
            f"{channel} has the wrong number of units",
            expected=f"one unit, or {width}, one a column",
            found=str(len(unit)),
            where=location,
        )
    for column_unit, kind in zip(unit, kinds, strict=True):
        to_si(column_unit, location)
        if not fits(column_unit, kind):
            raise unfit(channel, column_unit, kind, location)
    return tuple(TO_SI[column_unit] for column_unit in unit)


def _scales(channel: str, scale: float | tuple[float, ...], width: int, location: Where) -> tuple[float, ...]:
    """Return the factor of each column that applies before its unit; one number for a pose is for the position."""
    if not isinstance(scale, tuple):
        return tuple(1.0 if kind == ("1",) else scale for kind in si_units(channel, width))
    if len(scale) != width:
        raise UsageError(
            f"{channel} has the wrong number of scales",
            expected=f"one number, or {width}, one a column",
            found=str(len(scale)),
            where=location,
        )
    return scale


def _elements(
    channel: str,
    column_names: tuple[str, ...],
    shape: tuple[int, ...],
    given_names: tuple[str, ...] | None,
    location: Where,
) -> tuple[str, ...]:
    """Return the names of a channel's elements: the map's, else those of the columns."""
    if not shape or isinstance(CHANNELS[channel].shape[1], int):
        return ()
    if given_names is not None:
        if len(given_names) != shape[0]:
            raise UsageError(
                f"{channel} has the wrong number of names",
                expected=str(shape[0]),
                found=str(len(given_names)),
                where=location,
            )
        return given_names
    if not all(column_names) or len(set(column_names)) < len(column_names):
        return ()
    if len(shape) == 2:
        return fingertip_names([column_names[i : i + 3] for i in range(0, len(column_names), 3)])
    ending = next((end for end in _ENDINGS if all(name.endswith(end) and name != end for name in column_names)), "")
    return element_names(channel, [name.removesuffix(ending) for name in column_names])


def _check_repeats(channel: str, feature_columns: Sequence[tuple[Feature, int]], location: Where) -> None:
    """Refuse a channel that takes a column twice."""
    if len(set(feature_columns)) < len(feature_columns):
        repeated_labels = [
            _label(feature, column) for (feature, column), count in Counter(feature_columns).items() if count > 1
        ]
        raise UsageError(f"{channel} names a column twice", found=", ".join(repeated_labels), where=location)


def _check_quaternion(channel: str, column_names: Sequence[str], location: Where) -> None:
    """Refuse a pose whose columns say by their names that the real part comes last."""
    if channel not in QUATERNION:
        return
    words = [name.lower() for name in column_names[QUATERNION[channel]]]
    if words[-1].endswith("w") and not any(name.endswith("w") for name in words[:-1]):
        raise UsageError(
            "the quaternion's columns are in the order x y z w",
            expected="w x y z",
            found=", ".join(words),
            where=location,
            fix="say `quaternion: xyzw` in the map",
        )


def _check_counts(channel_picks: Sequence[Pick], path: Path) -> None:
    """Raise when two channels disagree about the number of joints or fingertips."""
    first_picks: dict[str, Pick] = {}
    for pick in channel_picks:
        symbol = (*CHANNELS[pick.channel].shape, "")[1]
        if symbol not in ("J", "F"):
            continue
        earlier_pick = first_picks.setdefault(str(symbol), pick)
        if earlier_pick.shape[0] != pick.shape[0]:
            raise DataError(
                f"{pick.channel} has the wrong count of {'joints' if symbol == 'J' else 'fingertips'}",
                expected=f"{earlier_pick.shape[0]} as in {earlier_pick.channel}",
                found=str(pick.shape[0]),
                where=Where(path=str(path), channel=pick.channel),
                fix="give a map that picks the columns of both channels in the same order",
            )
