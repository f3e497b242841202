"""Names and units of a channel's elements, as tables, pages and views label them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.schema.channels import CHANNELS
from candata.schema.episode import Episode, EpisodeMeta

#: Parts of channels whose elements mean the same everywhere.
POSE = (("x", "m"), ("y", "m"), ("z", "m"), ("qw", "1"), ("qx", "1"), ("qy", "1"), ("qz", "1"))
VELOCITY = (("vx", "m/s"), ("vy", "m/s"), ("vz", "m/s"), ("wx", "rad/s"), ("wy", "rad/s"), ("wz", "rad/s"))
#: Unit of a joint's channel where the scene does not say whether it turns or slides; `joint` is rad or m.
JOINT_UNITS = {
    "joint_position": "joint",
    "joint_velocity": "joint/s",
    "joint_effort": "joint effort",
    "action": "command",
}
#: What stands for the unit of a channel that an episode keeps in the source's own.
UNSCALED = "source's unit"


@dataclass(frozen=True)
class Element:
    """One element of a channel: its name (empty where the channel is one number a row) and unit."""

    name: str
    unit: str


def joint_labels(meta: EpisodeMeta, count: int) -> tuple[str, ...]:
    """Return the joints' names, numbered where the episode does not state them."""
    return meta.joint_names or tuple(f"joint {i}" for i in range(count))


def actuator_labels(meta: EpisodeMeta, count: int) -> tuple[str, ...]:
    """Return the actuators' names, numbered where the episode does not state them."""
    return meta.actuator_names or tuple(f"actuator {i}" for i in range(count))


def fingertip_labels(meta: EpisodeMeta, count: int) -> tuple[str, ...]:
    """Return the fingertips' names, numbered where the episode does not state them."""
    return meta.fingertip_names or tuple(f"fingertip {i}" for i in range(count))


def elements(meta: EpisodeMeta, channel: str, shape: tuple[int, ...]) -> tuple[Element, ...]:
    """Return the elements of a channel, in the order of `columns`.

    Parameters
    ----------
    meta : EpisodeMeta
        Says the names.
    channel : str
        Name of the channel.
    shape : tuple of int
        Its shape without the time axis.
    """
    unit = UNSCALED if channel in meta.unscaled else JOINT_UNITS.get(channel, CHANNELS[channel].unit)
    if channel in ("object_pose", "hand_pose"):
        return tuple(Element(*pair) for pair in POSE)
    if channel == "object_velocity":
        return tuple(Element(*pair) for pair in VELOCITY)
    if channel in ("action", "supply_voltage", "torque_on"):
        return tuple(Element(name, unit) for name in actuator_labels(meta, shape[0]))
    if channel in JOINT_UNITS:
        return tuple(Element(name, unit) for name in joint_labels(meta, shape[0]))
    if channel == "fingertip_force":
        return tuple(Element(f"{tip} {axis}", unit) for tip in fingertip_labels(meta, shape[0]) for axis in "xyz")
    if shape:
        return tuple(Element(tip, unit) for tip in fingertip_labels(meta, shape[0]))
    return (Element("", unit),)


def columns(episode: Episode, channel: str) -> tuple[NDArray, int]:
    """Return a channel as `(R, E)` with E the number of its `elements`, and how many rows stand for one step.

    Taxels of one fingertip are rows of one column.
    """
    values = episode[channel]
    if channel == "taxels":
        rows = int(np.prod(values.shape[2:]))
        return np.moveaxis(values, 1, -1).reshape(-1, values.shape[1]), rows
    return values.reshape(len(values), -1), 1
