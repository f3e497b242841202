"""The messages of a hand in a log, read back as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.formats._mcap_messages import message
from candata.record.log_streams import Messages

WIRE, JOINTS, TARGETS = "/wire", "/hand/joint_states", "/hand/joint_targets"
FORCES, TAXELS, MOTORS, STATISTICS = "/hand/fingertip_forces", "/hand/taxels", "/hand/motor_states", "/statistics"
#: Topic of a session's events, and their kinds.
EVENTS, MARK, DRIFT = "/events", "mark", "drift"


def state_arrays(messages: Messages, joints: int, fingertips: int, taxels: int) -> dict[str, Any]:
    """Return the arrays of the state frames of which every message was read."""
    topics = [JOINTS, MOTORS, FORCES] + ([TAXELS] if taxels else [])
    numbers = sorted(set.intersection(*(set(messages[topic]) for topic in topics)))
    n = len(numbers)
    data = {topic: [messages[topic][number][1] for number in numbers] for topic in topics}
    currents = [message("candata.MotorState").FromString(d).current_ampere for d in data[MOTORS]]
    counts = [message("candata.FingertipForces").FromString(d).counts for d in data[FORCES]]
    taxel_counts = None
    if taxels:
        parse = message("candata.TactileFrame").FromString
        taxel_counts = np.empty((n, fingertips, taxels, 3), np.int16)  # filled row by row: they are most of a long log
        for row, item in zip(taxel_counts, data[TAXELS], strict=True):
            row[...] = np.frombuffer(parse(item).counts, dtype="<i2").reshape(row.shape)
    return {
        "state_time_ns": _times(messages[JOINTS], numbers),
        "joint_position": _positions(data[JOINTS], joints),
        "motor_current": np.array(currents, dtype=np.float64).reshape(n, joints),
        "force_counts": np.array(counts, dtype=np.int16).reshape(n, fingertips, 3),
        "taxel_counts": taxel_counts,
    }


def target_arrays(messages: Messages, joints: int) -> dict[str, Any]:
    """Return the arrays of the command frames."""
    numbers = sorted(messages[TARGETS])
    data = [messages[TARGETS][number][1] for number in numbers]
    return {
        "command_time_ns": _times(messages[TARGETS], numbers),
        "joint_target": _positions(data, joints),
    }


def _times(messages: Mapping[int, tuple[int, bytes]], numbers: Sequence[int]) -> NDArray[np.int64]:
    return np.array([messages[number][0] for number in numbers], dtype=np.int64)


def _positions(data: Sequence[bytes], joints: int) -> NDArray[np.float64]:
    """Return the positions (n, joints) of serialised `foxglove.JointStates`."""
    parse = message("foxglove.JointStates").FromString
    positions = [[joint.position for joint in parse(item).joints] for item in data]
    return np.array(positions, dtype=np.float64).reshape(len(data), joints)
