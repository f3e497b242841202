"""The common part of maps of all formats: the map file, the channels that can be made, units."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from candata.errors import UnknownNameError, UsageError, Where
from candata.formats._columns import TABLES
from candata.formats._map_file import read_map_file
from candata.schema.channels import CHANNELS, DENSE_CHANNELS
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
    "V": frozenset({"V", "mV"}),
    "A": frozenset({"A", "mA"}),
    "count": frozenset({"count"}),
    "1": frozenset({"1"}),
}
#: SI units that an element of a channel may have; for `joint` channels the scene says which.
_POSITION, _RATE, _FORCE = ("m", "rad", "1"), ("m/s", "rad/s", "1"), ("N", "N m", "1")
#: Units of an effort that say nothing of its size: a motor's current, counts, a share.
SIZELESS = ("A", "mA", "count", "1")
_JOINT = {
    "joint_position": _POSITION,
    "joint_velocity": _RATE,
    "joint_effort": (*_FORCE, "A", "count"),
    "action": _POSITION + _RATE + _FORCE,
}
_FIXED_UNITS = {
    "object_pose": (("m",),) * 3 + (("1",),) * 4,
    "hand_pose": (("m",),) * 3 + (("1",),) * 4,
    "object_velocity": (("m/s",),) * 3 + (("rad/s",),) * 3,
}


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
            expected="a map.yaml",
            found="a folder" if path.is_dir() else "the table itself",
            where=Where(path=str(path)),
            fix="write map.yaml beside the table, then: candata import table map.yaml --out recordings; such as\n\n"
            f"file: {table}\nsource: real\nepisode: COLUMN        # names the episode; leave out for one\n"
            "time_s: COLUMN\nrate_hz: 80\nchannels:              # quaternions w x y z\n"
            "  object_pose: [px, py, pz, qw, qx, qy, qz]\n  joint_position: [q_1, q_2]\n  action: [a_1, a_2]",
        )
    return read_map_file(TableMap, path)


def check_channels(channels: Iterable[str], location: Where) -> None:
    """Raise unless the channels that a map makes are known, and one of them says where things are.

    Raises
    ------
    UsageError
        When one is not known, or there is neither object_pose nor joint_position.
    """
    known_names = [name for name in CHANNELS if name != "time_ns" and name not in DENSE_CHANNELS]
    names = list(channels)
    for name in names:
        if name not in known_names:
            raise UnknownNameError("channel", name, known_names, location)
    if not {"object_pose", "joint_position"} & set(names):
        raise UsageError(
            "the map needs one of object_pose, joint_position", found=", ".join(names) or "no channels", where=location
        )


def time_factor(mapping: TableMap, path: Path) -> float:
    """Return the factor from the time column's unit (seconds unless the map says otherwise) to seconds.

    Raises
    ------
    UsageError
        When the unit is no unit of time.
    """
    unit = mapping.units.get(mapping.time_s, "s")
    location = Where(path=str(path), channel="time_ns")
    if to_si(unit, location) and unit not in _SAME_KIND["s"]:
        raise unfit(mapping.time_s, unit, ("s",), location)
    return TO_SI[unit]


def unit_factors(channel: str, count: int, unit: str | None, location: Where) -> tuple[float, ...]:
    """Return the factor to SI of each of a channel's values, the unit applied to those that can have it.

    Raises
    ------
    UsageError
        When the unit is not known, or none of the values can have it.
    """
    kinds = si_units(channel, count)
    if unit is None:
        return (1.0,) * count
    factor = to_si(unit, location)
    if not any(fits(unit, kind) for kind in kinds):
        raise unfit(channel, unit, kinds[0], location)
    return tuple(factor if fits(unit, kind) else 1.0 for kind in kinds)


def si_units(channel: str, count: int) -> tuple[tuple[str, ...], ...]:
    """Return, for each column of a channel, the SI units it may have."""
    return _FIXED_UNITS.get(channel) or (_JOINT.get(channel, (CHANNELS[channel].unit,)),) * count


def fits(unit: str, kind: tuple[str, ...]) -> bool:
    """Tell whether `unit` measures what one of the SI units of `kind` measures."""
    return any(unit in _SAME_KIND[si] for si in kind)


def unfit(name: str, unit: str, kind: tuple[str, ...], location: Where) -> UsageError:
    """Return the error of a known unit in the wrong place."""
    fitting = ", ".join(sorted(u for si in kind for u in _SAME_KIND[si]))
    return UsageError(f"{name} cannot be in {unit}", expected=f"one of {fitting}", found=unit, where=location)
