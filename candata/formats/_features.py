"""Named arrays as channels: which columns of which feature, in which unit, as a feature map says."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
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

#: Where w x y z stand in a pose whose quaternion is x y z w.
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
    """How one channel is made.

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
    where = Where(path=str(path))
    check_channels(dict.fromkeys((*mapping.channels, *mapping.units, *mapping.scales, *mapping.names)), where)
    for name in (*mapping.units, *mapping.scales, *mapping.names):
        if name not in mapping.channels:
            raise UsageError(f"the map speaks of {name}, but does not say what it is made of", where=where)
    by_name = {feature.name: feature for feature in features}
    made = tuple(_pick(mapping, name, by_name, path) for name in mapping.channels)
    _check_counts(made, path)
    return made


def asked(mapping: FeatureMap, names: Iterable[str]) -> tuple[str, ...]:
    """Return which of the features that are there a map speaks of; the others need not be opened."""
    entries = [text for entry in mapping.channels.values() for text in ((entry,) if isinstance(entry, str) else entry)]
    return tuple(
        name for name in names if any(text == name or text.startswith((f"{name}[", f"{name} [")) for text in entries)
    )


def blocks(made: Iterable[Pick], arrays: Mapping[str, NDArray]) -> list[Block]:
    """Return the channels of rows: `arrays` holds each feature as `(T, width)`."""
    done = []
    for pick in made:
        parts = [arrays[name][:, list(columns)].astype(np.float64) for name, columns in pick.parts]
        values = np.concatenate(parts, axis=1) * np.array(pick.factors)
        done.append(Block(pick.channel, values, pick.columns, pick.shape))
    return done


def wanted(made: Iterable[Pick]) -> tuple[str, ...]:
    """Return the features that the picks read, each once."""
    return tuple(dict.fromkeys(name for pick in made for name, _ in pick.parts))


def names_of(made: Sequence[Pick]) -> dict[str, tuple[str, ...]]:
    """Return the fields of an episode's record that name joints, actuators and fingertips."""
    by_channel = {pick.channel: pick.elements for pick in made}

    def first(*channels: str) -> tuple[str, ...]:
        return next((by_channel[name] for name in channels if by_channel.get(name)), ())

    return {
        "joint_names": first("joint_position", "joint_velocity", "joint_effort"),
        "actuator_names": first("action"),
        "fingertip_names": first("fingertip_force", "fingertip_contact"),
    }


def _pick(mapping: FeatureMap, channel: str, by_name: Mapping[str, Feature], path: Path) -> Pick:
    """Return how one channel is made."""
    where = Where(path=str(path), channel=channel)
    entry = mapping.channels[channel]
    parts = tuple(part(text, by_name, where) for text in ((entry,) if isinstance(entry, str) else entry))
    flat = [(by_name[name], column) for name, columns in parts for column in columns]
    _check_repeats(channel, flat, where)
    shape = _shape(channel, [_label(feature, column) for feature, column in flat], where)
    if channel in QUATERNION and mapping.quaternion == "xyzw":
        flat = [flat[i] for i in _XYZW]
        parts = tuple((feature.name, (column,)) for feature, column in flat)
    columns = tuple(_label(feature, column) for feature, column in flat)
    named = tuple(feature.names[column] if feature.names else "" for feature, column in flat)
    _check_quaternion(channel, named, where)
    units = _factors(channel, mapping.units.get(channel), len(flat), where)
    scales = _scales(channel, mapping.scales.get(channel, 1.0), len(flat), where)
    factors = tuple(unit * scale for unit, scale in zip(units, scales, strict=True))
    elements = _elements(channel, named, shape, mapping.names.get(channel), where)
    return Pick(channel, parts, shape, factors, columns, elements)


def part(text: str, by_name: Mapping[str, Feature], where: Where) -> tuple[str, tuple[int, ...]]:
    """Return a feature and the numbers of its columns from `feature` or `feature[columns]`.

    Raises
    ------
    UnknownNameError, UsageError
        When the feature or a column of it is not there.
    """
    name, chosen = split_entry(text, by_name)
    if name not in by_name:
        raise UnknownNameError("feature", name, by_name, where)
    feature = by_name[name]
    if feature.width > _MOST_COLUMNS:
        raise UsageError(
            f"{name} is too wide for a channel",
            expected=f"at most {_MOST_COLUMNS} columns",
            found=str(feature.width),
            where=where,
        )
    if chosen is None:
        return name, tuple(range(feature.width))
    columns = [column for word in chosen.split(",") for column in _columns(word.strip(), feature, where)]
    if not columns:
        raise UsageError("the map picks no column", found=text, where=where)
    return name, tuple(columns)


def _columns(word: str, feature: Feature, where: Where) -> list[int]:
    """Return the columns that `3`, `2:5` or a name means."""
    if word in feature.names:
        return [feature.names.index(word)]
    bounds = re.fullmatch(r"(\d{0,9}):(\d{0,9})|(\d{1,9})", word)
    if bounds is None:
        raise UnknownNameError(f"column of {feature.name}", word, feature.names, where)
    low, high, single = bounds.groups()
    first = int(single or low or 0)
    last = first + 1 if single else int(high or feature.width)
    if not first < last <= feature.width:
        raise UsageError(
            f"{feature.name} has no columns {word}",
            expected=f"numbers from 0 to {feature.width - 1}; a range leaves out its end",
            found=word,
            where=where,
        )
    return list(range(first, last))


def _label(feature: Feature, column: int) -> str:
    """Return what a column is called in messages."""
    if feature.names == (feature.name,):
        return feature.name
    return f"{feature.name}[{feature.names[column] if feature.names else column}]"


def width_of_row(channel: str) -> int | None:
    """Return how many numbers each element of a channel has; None where it has one."""
    symbols = CHANNELS[channel].shape[1:]
    return int(symbols[-1]) if len(symbols) == 2 else None


def _shape(channel: str, columns: Sequence[str], where: Where) -> tuple[int, ...]:
    """Return the shape of a row of these columns."""
    width = len(columns)
    symbols = CHANNELS[channel].shape[1:]
    last = symbols[-1] if symbols else 1
    fixed = len(symbols) < 2 and isinstance(last, int)
    if isinstance(last, int) and (width != last if fixed else width % last):
        raise UsageError(
            f"{channel} has the wrong number of columns",
            expected=f"{last} columns" if fixed else f"{last} columns a fingertip",
            found=f"{width}: {', '.join(columns)}"[:200],
            where=where,
        )
    return {0: (), 1: (width,), 2: (width // 3, 3)}[len(symbols)]


def _factors(channel: str, unit: str | tuple[str, ...] | None, width: int, where: Where) -> tuple[float, ...]:
    """Return the factor to SI of each column; one unit applies to those elements that can have it."""
    kinds = si_units(channel, width)
    if unit is None:
        return (1.0,) * width
    if isinstance(unit, str):
        to_si(unit, where)
        if not any(fits(unit, kind) for kind in kinds):
            raise unfit(channel, unit, kinds[0], where)
        return tuple(TO_SI[unit] if fits(unit, kind) else 1.0 for kind in kinds)
    if len(unit) != width:
        raise UsageError(
            f"{channel} has the wrong number of units",
            expected=f"one unit, or {width}, one a column",
            found=str(len(unit)),
            where=where,
        )
    for one, kind in zip(unit, kinds, strict=True):
        to_si(one, where)
        if not fits(one, kind):
            raise unfit(channel, one, kind, where)
    return tuple(TO_SI[one] for one in unit)


def _scales(channel: str, scale: float | tuple[float, ...], width: int, where: Where) -> tuple[float, ...]:
    """Return what each column is multiplied by before its unit counts; of a pose, one number is for the position."""
    if not isinstance(scale, tuple):
        return tuple(1.0 if kind == ("1",) else scale for kind in si_units(channel, width))
    if len(scale) != width:
        raise UsageError(
            f"{channel} has the wrong number of scales",
            expected=f"one number, or {width}, one a column",
            found=str(len(scale)),
            where=where,
        )
    return scale


def _elements(
    channel: str, named: tuple[str, ...], shape: tuple[int, ...], given: tuple[str, ...] | None, where: Where
) -> tuple[str, ...]:
    """Return the names of a channel's elements: the map's, else those of the columns."""
    if not shape or isinstance(CHANNELS[channel].shape[1], int):
        return ()
    if given is not None:
        if len(given) != shape[0]:
            raise UsageError(
                f"{channel} has the wrong number of names", expected=str(shape[0]), found=str(len(given)), where=where
            )
        return given
    if not all(named) or len(set(named)) < len(named):
        return ()
    if len(shape) == 2:
        return fingertip_names([named[i : i + 3] for i in range(0, len(named), 3)])
    ending = next((end for end in _ENDINGS if all(name.endswith(end) and name != end for name in named)), "")
    return element_names(channel, [name.removesuffix(ending) for name in named])


def _check_repeats(channel: str, flat: Sequence[tuple[Feature, int]], where: Where) -> None:
    """Refuse a channel that takes a column twice."""
    if len(set(flat)) < len(flat):
        repeated = [_label(feature, column) for (feature, column), count in Counter(flat).items() if count > 1]
        raise UsageError(f"{channel} names a column twice", found=", ".join(repeated), where=where)


def _check_quaternion(channel: str, named: Sequence[str], where: Where) -> None:
    """Refuse a pose whose columns say by their names that the real part comes last."""
    if channel not in QUATERNION:
        return
    words = [name.lower() for name in named[QUATERNION[channel]]]
    if words[-1].endswith("w") and not any(name.endswith("w") for name in words[:-1]):
        raise UsageError(
            "the quaternion's columns are in the order x y z w",
            expected="w x y z",
            found=", ".join(words),
            where=where,
            fix="say `quaternion: xyzw` in the map",
        )


def _check_counts(made: Sequence[Pick], path: Path) -> None:
    """Raise when two channels disagree about the number of joints or fingertips."""
    first: dict[str, Pick] = {}
    for pick in made:
        symbol = (*CHANNELS[pick.channel].shape, "")[1]
        if symbol not in ("J", "F"):
            continue
        other = first.setdefault(str(symbol), pick)
        if other.shape[0] != pick.shape[0]:
            raise DataError(
                f"{pick.channel} has the wrong count of {'joints' if symbol == 'J' else 'fingertips'}",
                expected=f"{other.shape[0]} as in {other.channel}",
                found=str(pick.shape[0]),
                where=Where(path=str(path), channel=pick.channel),
                fix="give a map that picks the columns of both channels in the same order",
            )
