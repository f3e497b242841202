"""The table of channels: the schema of an episode is these rows."""

from __future__ import annotations

from typing import Literal

from candata.schema.record import Record

Role = Literal["clock", "state", "command", "measurement", "truth"]


class Channel(Record):
    """One row of the schema.

    Attributes
    ----------
    name : str
        Name of the channel.
    unit : str
        SI unit of its values, from `candata.units`; `joint` where the scene says it per element.
    shape : tuple of str or int
        Shape; T steps, J joints, A actuators, F fingertips, N taxels a fingertip are bound by the episode.
    dtype : str
        numpy dtype in which it is kept and stored.
    role : str
        clock, state, command, measurement or truth.
    frame : str
        Frame in which vectors are given.
    meaning : str
        One line for people.
    """

    name: str
    unit: str
    shape: tuple[str | int, ...]
    dtype: str
    role: Role
    frame: str = ""
    meaning: str


_TABLE = (
    Channel(
        name="time_ns",
        unit="ns",
        shape=("T",),
        dtype="int64",
        role="clock",
        meaning="time of each row, strictly increasing",
    ),
    Channel(
        name="object_pose",
        unit="m",
        shape=("T", 7),
        dtype="float32",
        role="state",
        frame="world",
        meaning="object position [m] and unit quaternion w x y z, body to world",
    ),
    Channel(
        name="object_velocity",
        unit="m/s",
        shape=("T", 6),
        dtype="float32",
        role="state",
        frame="world, then body",
        meaning="linear m/s in the world, then angular rad/s in the body frame",
    ),
    Channel(
        name="joint_position",
        unit="joint",
        shape=("T", "J"),
        dtype="float32",
        role="state",
        frame="joint",
        meaning="joint positions",
    ),
    Channel(
        name="joint_velocity",
        unit="joint",
        shape=("T", "J"),
        dtype="float32",
        role="state",
        frame="joint",
        meaning="joint velocities",
    ),
    Channel(
        name="joint_effort",
        unit="joint",
        shape=("T", "J"),
        dtype="float32",
        role="measurement",
        frame="joint",
        meaning="joint torques or forces",
    ),
    Channel(
        name="action",
        unit="joint",
        shape=("T", "A"),
        dtype="float32",
        role="command",
        frame="joint",
        meaning="what the actuator takes, held over [time_k, time_k+1)",
    ),
    Channel(
        name="hand_pose",
        unit="m",
        shape=("T", 7),
        dtype="float32",
        role="state",
        frame="world",
        meaning="hand base position [m] and unit quaternion w x y z",
    ),
    Channel(
        name="fingertip_force",
        unit="N",
        shape=("T", "F", 3),
        dtype="float32",
        role="measurement",
        frame="fingertip",
        meaning="net force of all that touches the fingertip, on it, mean over the last step",
    ),
    Channel(
        name="fingertip_contact",
        unit="1",
        shape=("T", "F"),
        dtype="bool",
        role="measurement",
        meaning="fingertip touches the object: by force, see contact_rule, where its source does not say",
    ),
    Channel(
        name="contact",
        unit="1",
        shape=("T",),
        dtype="bool",
        role="measurement",
        meaning="any fingertip touches the object",
    ),
    Channel(
        name="fingertip_collision",
        unit="1",
        shape=("T", "F"),
        dtype="bool",
        role="truth",
        meaning="a geom of the fingertip met the object in the last step, whatever the force: simulations know it",
    ),
    Channel(
        name="supply_voltage",
        unit="V",
        shape=("T", "A"),
        dtype="float32",
        role="measurement",
        meaning="voltage at each actuator's supply",
    ),
    Channel(
        name="torque_on",
        unit="1",
        shape=("T", "A"),
        dtype="bool",
        role="command",
        meaning="the actuator drives; where false it does not hold its joint, whatever its command",
    ),
    Channel(
        name="taxels",
        unit="count",
        shape=("T", "F", "N", 3),
        dtype="int16",
        role="measurement",
        frame="fingertip",
        meaning="raw counts of each fingertip's N taxels, as on the wire; times newton_per_count: the force in N",
    ),
)

#: Channel name to its row; the order is the canonical one (storage, hashing, printing).
CHANNELS: dict[str, Channel] = {row.name: row for row in _TABLE}

#: Columns of a pose channel that hold its quaternion.
QUATERNION: dict[str, slice] = {"object_pose": slice(3, 7), "hand_pose": slice(3, 7)}

VALID_SUFFIX = "_valid"

#: Channels too wide for a table: kept as a sharded Zarr store beside the tables of a part.
DENSE_CHANNELS = frozenset({"taxels"})


def canonical_order(names: list[str]) -> list[str]:
    """Return channel names (and their `_valid` flags) in the canonical order."""
    order = list(CHANNELS)
    return sorted(names, key=lambda n: (order.index(n.removesuffix(VALID_SUFFIX)), n.endswith(VALID_SUFFIX)))
