"""An episode as lanes: lines over time, one unit a lane, commands beside the joints that they drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from candata.datasets.elements import columns, elements, fingertip_labels, joint_labels
from candata.reports.joint_units import joint_units, readable_unit
from candata.reports.traces import command_joints, masked
from candata.reports.words import readable_name
from candata.rotation import difference
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: Channels that are drawn where none are named; flags of contact are drawn as bars by whoever draws lanes.
USUAL_CHANNELS = ("object_pose", "joint_position", "fingertip_force")


@dataclass(frozen=True)
class Lane:
    """Lines over time in one unit.

    Attributes
    ----------
    title, unit : str
    lines : mapping of str to (T,) float64
        Values by name, NaN where they are not valid.
    commands : mapping of str to (T,) float64
        What the lines of the same names were commanded to.
    """

    title: str
    unit: str
    lines: Mapping[str, Array]
    commands: Mapping[str, Array] = field(default_factory=dict)


def lanes(
    episode: Episode, channels: Sequence[str] = USUAL_CHANNELS, units: Mapping[str, str] | None = None
) -> list[Lane]:
    """Return the lanes of those of the channels that an episode has.

    An object's pose becomes its position and its turn from the first valid row, a fingertip's force the size of its
    vector; joints are split by their unit.

    Parameters
    ----------
    episode : Episode
    channels : sequence of str
        Channels to draw.
    units : mapping of str to str, optional
        Units of the joints, as `joint_units` has them; by default of the episode's scene, where it is built in.
    """
    known_units = joint_units(episode.meta.scene) if units is None else units
    return [lane for name in channels if name in episode for lane in _lanes(episode, name, known_units)]


def _lanes(episode: Episode, channel: str, units: Mapping[str, str]) -> list[Lane]:
    """Return the lanes of one channel."""
    values = masked(episode, channel)
    if channel == "object_pose":
        position = {axis: values[:, k] for k, axis in enumerate("xyz")}
        turn = {"turn": _turn_deg(values[:, 3:])}
        return [Lane("object's position", "m", position), Lane("object's turn from its first pose", "deg", turn)]
    if channel == "fingertip_force":
        sizes = np.linalg.norm(values, axis=2)
        names = fingertip_labels(episode.meta, sizes.shape[1])
        return [Lane("fingertip force", "N", dict(zip(names, sizes.T, strict=True)))]
    if channel == "joint_position":
        return _joint_lanes(episode, values, units)
    flat = columns(episode, channel)[0].astype(float)
    flat[~episode.valid(channel)] = np.nan
    by_unit: dict[str, dict[str, Array]] = {}
    for k, element in enumerate(elements(episode.meta, channel, episode[channel].shape[1:])):
        by_unit.setdefault(readable_unit(element.unit, element.name, units), {})[element.name or channel] = flat[:, k]
    return [Lane(readable_name(channel), unit, lines) for unit, lines in by_unit.items()]


def _joint_lanes(episode: Episode, position: Array, units: Mapping[str, str]) -> list[Lane]:
    """Return a lane for the joints of each unit, with the commands that bear their names."""
    names = joint_labels(episode.meta, position.shape[1])
    by_unit: dict[str, dict[str, Array]] = {}
    for name, values in zip(names, position.T, strict=True):
        by_unit.setdefault(readable_unit("joint", name, units), {})[name] = values
    commands: dict[str, Array] = {}
    if "action" in episode:
        action = masked(episode, "action")
        commands = dict(zip(command_joints(episode, names, action.shape[1]), action.T, strict=True))
    title = "joint position, command dashed" if commands.keys() & set(names) else "joint position"
    return [
        Lane(title, unit, lines, {name: values for name, values in commands.items() if name in lines})
        for unit, lines in by_unit.items()
    ]


def _turn_deg(quaternion: Array) -> Array:
    """Return `(T,)` the angle [deg] from the first valid orientation; NaN where none is valid."""
    valid_rows = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
    if not len(valid_rows):
        return np.full(len(quaternion), np.nan)
    first = np.tile(quaternion[valid_rows[0]], (len(quaternion), 1))
    return np.degrees(np.linalg.norm(difference(first, quaternion), axis=1))
