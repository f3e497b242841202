"""The plan of a table import: which columns make which channel, with factors to SI."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from candata.errors import DataError, UnknownNameError, UsageError, Where
from candata.formats._columns import TABLES
from candata.formats._map_file import read_map_file
from candata.schema.channels import CHANNELS, DENSE, QUATERNION
from candata.schema.scene import TableMap
from candata.units import TO_SI, to_si

#: Units that measure the same thing as the SI unit they stand behind.
_SAME_KIND: dict[str, frozenset[str]] = {
    "m": frozenset({"m", "mm", "cm"}),
    "rad": frozenset({"rad", "mrad", "deg"}),
    "m/s": frozenset({"m/s", "mm/s"}),
    "rad/s": frozenset({"rad/s", "deg/s"}),
    "N": frozenset({"N", "mN", "gf", "kgf"}),
    "N m": frozenset({"N m", "mN m"}),
    "s": frozenset({"s", "ms", "us", "ns"}),
    "1": frozenset({"1"}),
}
#: SI units that an element of a channel may have; for `joint` channels the scene says which.
_POSITION, _RATE, _EFFORT = ("m", "rad", "1"), ("m/s", "rad/s", "1"), ("N", "N m", "1")
_JOINT = {
    "joint_position": _POSITION,
    "joint_velocity": _RATE,
    "joint_effort": _EFFORT,
    "action": _POSITION + _RATE + _EFFORT,
}
_FIXED = {
    "object_pose": (("m",),) * 3 + (("1",),) * 4,
    "hand_pose": (("m",),) * 3 + (("1",),) * 4,
    "object_velocity": (("m/s",),) * 3 + (("rad/s",),) * 3,
}


@dataclass(frozen=True)
class Plan:
    """How one channel is made.

    Attributes
    ----------
    channel : str
        Name of the channel.
    columns : tuple of str
        Its columns, row-major.
    shape : tuple of int
        Shape of one row.
    factors : tuple of float
        Factor to SI of each column.
    """

    channel: str
    columns: tuple[str, ...]
    shape: tuple[int, ...]
    factors: tuple[float, ...]


def read_map(path: Path) -> TableMap:
    """Return the record in a `map.yaml`.

    Raises
    ------
    UsageError
        When the file is missing, is the table itself or no YAML, or a field is missing, unknown or wrong.
    """
    if path.is_dir() or (path.is_file() and path.suffix.lower() in TABLES):
        table = "TABLE.parquet" if path.is_dir() else path.name
        raise UsageError(
            "a table is imported by a map, which says what each column is",
            expected="a map.yaml", found="a folder" if path.is_dir() else "the table itself",
            where=Where(path=str(path)),
            fix="write map.yaml beside the table, then: candata import table map.yaml --out recordings; such as\n\n"
            f"file: {table}\nsource: real\nepisode: COLUMN        # names the episode; leave out for one\n"
            "time_s: COLUMN\nrate_hz: 80\nchannels:              # quaternions w x y z\n"
            "  object_pose: [px, py, pz, qw, qx, qy, qz]\n  joint_position: [q_1, q_2]\n  action: [a_1, a_2]",
        )  # fmt: skip
    return read_map_file(TableMap, path)


def check_channels(channels: Iterable[str], where: Where) -> None:
    """Raise unless the channels that a map makes are known, and one of them says where things are.

    Raises
    ------
    UsageError
        When one is not known, or there is neither object_pose nor joint_position.
    """
    known = [name for name in CHANNELS if name != "time_ns" and name not in DENSE]
    made = list(channels)
    for name in made:
        if name not in known:
            raise UnknownNameError("channel", name, known, where)
    if not {"object_pose", "joint_position"} & set(made):
        raise UsageError(
            "the map needs one of object_pose, joint_position", found=", ".join(made) or "no channels", where=where
        )


def plans(mapping: TableMap, path: Path) -> tuple[Plan, ...]:
    """Return the plan of every channel of a map, in the map's order.

    Raises
    ------
    UsageError
        When a channel or unit is unknown, a unit does not fit, the columns of a channel have the wrong
        number or nesting, or the map has neither object_pose nor joint_position.
    DataError
        When two channels disagree about the number of joints or fingertips.
    """
    where = Where(path=str(path))
    check_channels(mapping.channels, where)
    _check_units(mapping, where)
    made = tuple(_plan(mapping, name, path) for name in mapping.channels)
    _check_counts(made, where)
    for plan in made:
        _check_quaternion(plan, path)
    return made


def _check_quaternion(plan: Plan, path: Path) -> None:
    """Refuse a pose whose columns say by their names that the real part comes last."""
    if plan.channel not in QUATERNION or len(plan.columns) != QUATERNION[plan.channel].stop:
        return
    names = [name.lower() for name in plan.columns[QUATERNION[plan.channel]]]
    if names[-1].endswith("w") and not any(name.endswith("w") for name in names[:-1]):
        raise UsageError(
            "the quaternion's columns are in the order x y z w",
            expected="w x y z",
            found=", ".join(names),
            where=Where(path=str(path), channel=plan.channel),
            fix="put the column that ends in w first",
        )


def time_factor(mapping: TableMap, path: Path) -> float:
    """Return the factor from the time column's unit (seconds unless the map says otherwise) to seconds.

    Raises
    ------
    UsageError
        When the unit is no unit of time.
    """
    unit = mapping.units.get(mapping.time_s, "s")
    where = Where(path=str(path), channel="time_ns")
    if to_si(unit, where) and unit not in _SAME_KIND["s"]:
        raise unfit(mapping.time_s, unit, ("s",), where)
    return TO_SI[unit]


def _plan(mapping: TableMap, channel: str, path: Path) -> Plan:
    """Return the plan of one channel, its columns checked."""
    where = Where(path=str(path), channel=channel)
    symbols = CHANNELS[channel].shape[1:]
    entries = mapping.channels[channel]
    rows = _rows(entries, symbols, where)
    columns = tuple(column for row in rows for column in row)
    repeated = [column for column, count in Counter(columns).items() if count > 1]
    if repeated:
        raise UsageError(f"{channel} names a column twice", found=", ".join(repeated), where=where)
    shape = {0: (), 1: (len(columns),), 2: (len(rows), len(rows[0]))}[len(symbols)]
    return Plan(channel, columns, shape, _factors(mapping, channel, columns, where))


def _rows(
    entries: Sequence[str | tuple[str, ...]], symbols: tuple[str | int, ...], where: Where
) -> tuple[tuple[str, ...], ...]:
    """Return a channel's columns as rows (one row where the channel is flat)."""
    nested = len(symbols) == 2
    rows = tuple((e,) if isinstance(e, str) else e for e in entries)
    width = symbols[-1] if symbols else 1
    if not nested:
        rows = (tuple(column for row in rows for column in row),)
    wrong_kind = any(isinstance(e, str) is nested for e in entries)
    wrong_width = isinstance(width, int) and any(len(row) != width for row in rows)
    if wrong_kind or wrong_width or not entries:
        each = f"{width} columns" if isinstance(width, int) else "one column an element"
        raise UsageError(
            f"{where.channel} has the wrong columns",
            expected=f"a list of lists of {each}" if nested else f"a list of {each}",
            found=_shape_text(entries),
            where=where,
        )
    return rows


def _shape_text(entries: Sequence[str | tuple[str, ...]]) -> str:
    """Return a short description of a list of columns for messages."""
    if not entries:
        return "an empty list"
    if all(isinstance(e, str) for e in entries):
        return f"{len(entries)} columns: {', '.join(map(str, entries))}"
    return "lists of " + ", ".join(str(1 if isinstance(e, str) else len(e)) for e in entries)


def _factors(mapping: TableMap, channel: str, columns: tuple[str, ...], where: Where) -> tuple[float, ...]:
    """Return the factor to SI of each column; a column's own unit comes before its channel's.

    A channel's unit applies to those of its elements that can have it: `object_pose: mm` leaves the
    quaternion alone.
    """
    kinds = si_units(channel, len(columns))
    shared = mapping.units.get(channel)
    if shared is not None and not any(fits(shared, kind) for kind in kinds):
        raise unfit(channel, shared, kinds[0], where)
    factors = []
    for column, kind in zip(columns, kinds, strict=True):
        own = mapping.units.get(column)
        if own is not None and not fits(own, kind):
            raise unfit(column, own, kind, where)
        unit = own or (shared if shared is not None and fits(shared, kind) else "1")
        factors.append(TO_SI[unit])
    return tuple(factors)


def unit_factors(channel: str, count: int, unit: str | None, where: Where) -> tuple[float, ...]:
    """Return the factor to SI of each of a channel's values, the unit applied to those that can have it.

    Raises
    ------
    UsageError
        When the unit is not known, or none of the values can have it.
    """
    kinds = si_units(channel, count)
    if unit is None:
        return (1.0,) * count
    factor = to_si(unit, where)
    if not any(fits(unit, kind) for kind in kinds):
        raise unfit(channel, unit, kinds[0], where)
    return tuple(factor if fits(unit, kind) else 1.0 for kind in kinds)


def si_units(channel: str, count: int) -> tuple[tuple[str, ...], ...]:
    """Return, for each column of a channel, the SI units it may have."""
    return _FIXED.get(channel) or (_JOINT.get(channel, (CHANNELS[channel].unit,)),) * count


def fits(unit: str, kind: tuple[str, ...]) -> bool:
    """Tell whether `unit` measures what one of the SI units of `kind` measures."""
    return any(unit in _SAME_KIND[si] for si in kind)


def unfit(name: str, unit: str, kind: tuple[str, ...], where: Where) -> UsageError:
    """Return the error of a known unit in the wrong place."""
    fitting = ", ".join(sorted(u for si in kind for u in _SAME_KIND[si]))
    return UsageError(f"{name} cannot be in {unit}", expected=f"one of {fitting}", found=unit, where=where)


def _check_units(mapping: TableMap, where: Where) -> None:
    """Raise when `units` names what the map does not have, or a unit that is not known."""
    entries = (entry for listed in mapping.channels.values() for entry in listed)
    columns = {column for entry in entries for column in ((entry,) if isinstance(entry, str) else entry)}
    for name, unit in mapping.units.items():
        if name not in columns | set(mapping.channels) | {mapping.time_s}:
            raise UnknownNameError("channel or column in units", name, columns | set(mapping.channels), where)
        to_si(unit, where)


def _check_counts(made: tuple[Plan, ...], where: Where) -> None:
    """Raise when two channels disagree about the number of joints or fingertips."""
    first: dict[str, Plan] = {}
    for plan in made:
        symbol = (*CHANNELS[plan.channel].shape, "")[1]
        if not isinstance(symbol, str) or not symbol:
            continue
        other = first.setdefault(symbol, plan)
        if other.shape[0] != plan.shape[0]:
            noun = {"J": "joints", "F": "fingertips"}.get(symbol, "elements")
            raise DataError(
                f"{plan.channel} has the wrong count of {noun}",
                expected=f"{other.shape[0]} as in {other.channel}",
                found=str(plan.shape[0]),
                where=Where(path=where.path, channel=plan.channel),
                fix="name one column an element in both channels, in the same order",
            )
