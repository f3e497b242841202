"""Episodes as rows of one fixed set of columns, as formats for learning want them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.schema.channels import CHANNELS, VALID_SUFFIX, canonical_order
from candata.schema.episode import Episode

#: A stamp further than this share of a period from the beat is uneven.
_UNEVEN_SHARE = 0.01
#: Channels of a hand in the order of the packed state, and the endings of their names.
_HAND_CHANNELS = {
    "joint_position": (".pos",),
    "joint_velocity": (".vel",),
    "joint_effort": (".effort",),
    "fingertip_force": (".fx", ".fy", ".fz"),
}
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_FIXED_NAMES = {"object_pose": _POSE, "hand_pose": _POSE, "object_velocity": _TWIST}


@dataclass(frozen=True)
class ColumnSurvey:
    """The columns that all episodes of an export share.

    Attributes
    ----------
    layout : dict of str to tuple of int
        Every column that an episode has, with its shape without the time axis, in the canonical order; each channel
        that some episode lacks or marks has a `_valid` column.
    rate_hz : float
        The one rate.
    names : dict of str to tuple of str
        `joint_names`, `actuator_names`, `fingertip_names`.
    episodes, rows : int
        Totals.
    notes : tuple of str
        What the rows do not tell: uneven stamps, filled and invalid rows.
    clouds : tuple of str
        The point clouds that they name.
    """

    layout: dict[str, tuple[int, ...]]
    rate_hz: float
    names: dict[str, tuple[str, ...]]
    episodes: int
    rows: int
    notes: tuple[str, ...]
    clouds: tuple[str, ...] = ()

    @property
    def columns(self) -> dict[str, tuple[int, ...]]:
        """The columns that have elements."""
        return {name: shape for name, shape in self.layout.items() if math.prod(shape)}


def survey(episodes: Iterable[Episode]) -> ColumnSurvey:
    """Return what the episodes share; reads them all once.

    Raises
    ------
    DataError
        When two differ in rate, or in number or names of joints, actuators or fingertips; or there is none.
    """
    first_values: dict[str, tuple[object, str]] = {}
    counts: Counter[str] = Counter()
    shapes: dict[str, tuple[int, ...]] = {}
    names: dict[str, tuple[str, ...]] = {}
    total = rows = uneven_count = 0
    rate_hz = 0.0
    clouds: set[str] = set()
    for episode in episodes:
        total += 1
        _require_same(first_values, "rate_hz", episode.meta.rate_hz, episode)
        for field in ("joint_names", "actuator_names", "fingertip_names"):
            if getattr(episode.meta, field):
                _require_same(first_values, field, getattr(episode.meta, field), episode)
                names[field] = getattr(episode.meta, field)
        for name, array in episode.arrays.items():
            _require_same(first_values, name, array.shape[1:], episode)
            shapes[name] = array.shape[1:]
        counts.update(list(episode.arrays))
        clouds |= {episode.meta.point_cloud} if episode.meta.point_cloud else set()
        rate_hz = episode.meta.rate_hz
        rows += len(episode)
        uneven_count += _is_uneven(episode)
    if not total:
        raise DataError("there is no episode to export", fix="choose a version that holds episodes")
    channels = [name for name in shapes if not name.endswith(VALID_SUFFIX)]
    flags = [c + VALID_SUFFIX for c in channels if counts[c] < total or c + VALID_SUFFIX in shapes]
    layout = {name: shapes.get(name, ()) for name in canonical_order(channels + flags)}
    notes = tuple(_notes(counts, channels, flags, total, uneven_count))
    return ColumnSurvey(layout, rate_hz, names, total, rows, notes, tuple(sorted(clouds)))


def filled_columns(episode: Episode, column_survey: ColumnSurvey) -> dict[str, NDArray]:
    """Return every column of the survey as `(T, *shape)`: what an episode lacks is zero and marked as not valid."""
    columns = {}
    for name, shape in column_survey.columns.items():
        channel = name.removesuffix(VALID_SUFFIX)
        if name in episode.arrays:
            columns[name] = episode.arrays[name]
        elif name == channel:
            columns[name] = np.zeros((len(episode), *shape), CHANNELS[name].dtype)
        else:
            columns[name] = np.full(len(episode), channel in episode.arrays)
    return columns


def as_matrix(array: NDArray) -> NDArray:
    """Return a column as `(T, n)`."""
    return array.reshape(len(array), -1)


def state_channels(column_survey: ColumnSurvey) -> tuple[str, ...]:
    """Return the channels of the packed state: those of the hand; without joints, those of the object's motion."""
    hand_channels = tuple(name for name in _HAND_CHANNELS if name in column_survey.columns)
    if "joint_position" in hand_channels:
        return hand_channels
    return tuple(name for name in ("object_pose", "object_velocity") if name in column_survey.columns)


def packed_state(arrays: dict[str, NDArray], column_survey: ColumnSurvey) -> NDArray[np.float32]:
    """Return `(T, n) float32`: the channels of the state side by side."""
    return np.concatenate([as_matrix(arrays[name]) for name in state_channels(column_survey)], axis=1, dtype=np.float32)


def state_names(column_survey: ColumnSurvey) -> list[str]:
    """Return the names of the packed state's columns."""
    names = []
    for channel in state_channels(column_survey):
        names += (
            [f"object.{n}" for n in column_names(channel, column_survey)]
            if channel in _FIXED_NAMES
            else [
                element + ending
                for element in element_names(channel, column_survey)
                for ending in _HAND_CHANNELS[channel]
            ]
        )
    return names


def column_names(column: str, column_survey: ColumnSurvey) -> list[str]:
    """Return a name for each element of a column's row, row-major."""
    if column in _FIXED_NAMES:
        return list(_FIXED_NAMES[column])
    shape = column_survey.layout[column]
    if not shape:
        return [column]
    elements = element_names(column, column_survey)
    if column == "fingertip_force":
        return [element + ending for element in elements for ending in _HAND_CHANNELS[column]]
    if len(shape) == 1:
        return elements
    return [f"{element}.{k}" for element in elements for k in range(math.prod(shape[1:]))]


def element_names(column: str, column_survey: ColumnSurvey) -> list[str]:
    """Return the names of a column's joints, actuators or fingertips; numbered where they have none."""
    symbol = CHANNELS[column].shape[1]
    field, letter = {"J": ("joint_names", "joint"), "A": ("actuator_names", "actuator")}.get(
        str(symbol), ("fingertip_names", "fingertip")
    )
    count = column_survey.layout[column][0]
    return list(column_survey.names.get(field, ())) or [f"{letter}{k}" for k in range(count)]


def _require_same(first_values: dict[str, tuple[object, str]], fact: str, value: object, episode: Episode) -> None:
    """Keep the first value of `fact`; raise when a later one differs."""
    first_value, first_id = first_values.setdefault(fact, (value, episode.meta.id))
    if first_value != value:
        raise DataError(
            f"the episodes differ in {fact}",
            expected=f"{first_value} as in episode {first_id}",
            found=str(value),
            where=Where(episode=episode.meta.id),
            fix="the format has one for all: export them apart, from filtered versions",
        )


def _is_uneven(episode: Episode) -> bool:
    """Tell whether a stamp lies off the beat of the nominal rate."""
    beat = np.arange(len(episode)) / episode.meta.rate_hz
    return bool((np.abs(episode.time_s - beat) * episode.meta.rate_hz > _UNEVEN_SHARE).any())


def _notes(counts: Counter[str], channels: list[str], flags: list[str], total: int, uneven_count: int) -> Iterable[str]:
    """Yield what the rows do not tell."""
    if uneven_count:
        yield (
            f"{uneven_count} of {total} episodes have stamps off the beat of the rate: only time_ns holds the true ones"
        )
    for name in channels:
        if counts[name] < total:
            yield f"{total - counts[name]} of {total} episodes have no {name}: filled with zeros, marked as not valid"
    if flags:
        flag_list = ", ".join(name.removesuffix(VALID_SUFFIX) for name in flags)
        yield f"rows may be invalid (zero or NaN) in {flag_list}: mind their flags"
