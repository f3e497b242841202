"""UFACTORY xArm: the report of TCP port 30000, 200 a second with a clock of the controller.

Source: the structure of that report in the public xArm-Python-SDK (BSD-3, `xarm/x3/report.py`, read for its layout):
big-endian size u32 and time u64, state and mode u8, queued commands u16, 17 reserved bytes, then little-endian floats.
Angles are radians there. Firmware 2.1 or later sends it.

No public source settles what follows, so it is a setting behind the address: the unit of the time (`clock=us`; the SDK
gives microseconds for another message), the length of a report (`bytes=any`; the SDK's structure has 804, other
firmware may send fewer or more after the joints), and the arm's number of joints (`joints=7`; the report has room for
seven).

The report has no check sum: TCP has one. A report is believed when its length is and its joint angles, targets and
velocities are ones that an arm can have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.record.devices._contract import Framer, Signal, StreamDevice
from candata.record.devices._settings import check_names, choice, number
from candata.record.devices._wire import FrameLayout, HeadFramer, no_frame_finding

JOINTS = 7
#: The report up to the torques; what stands behind is kept as bytes. Source: see above.
REPORT = np.dtype(
    [
        ("size", ">u4"),
        ("time", ">u8"),
        ("state_mode", "u1"),
        ("queued", ">u2"),
        ("reserved", "u1", 17),
        ("target_angle", "<f4", JOINTS),
        ("target_velocity", "<f4", JOINTS),
        ("target_acceleration", "<f4", JOINTS),
        ("angle", "<f4", JOINTS),
        ("velocity", "<f4", JOINTS),
        ("acceleration", "<f4", JOINTS),
        ("current", "<f4", JOINTS),
        ("torque", "<f4", JOINTS),
    ]
)
#: Length of the SDK's structure, and the longest that is believed [bytes].
DOCUMENTED_BYTES, LONGEST_BYTES = 804, 1024
#: Joints turn by one turn each way at most (user manual); a little more for readings beyond the stop [rad].
ANGLE_MAX_RAD = 2 * np.pi + 0.1
#: Joints turn at 180 deg/s at most (user manual); twice that is none of an arm [rad/s].
VELOCITY_MAX_RAD_S = 2 * np.pi
#: Lengths of the reports on the other ports. Source: the SDK's structures and published notes on 30003.
OTHER_PORTS = {87: 30003, 135: 30003, 133: 30001, 145: 30001, 233: 30002}
NS_A_TICK = {"us": 1000, "ns": 1}


class XarmFramer(HeadFramer):
    """Cuts reports; remembers the lengths that were claimed but are not those of this report.

    Parameters
    ----------
    size_bytes : int, optional
        The only length that is believed; by default any from the joints' end to `LONGEST_BYTES`.
    """

    def __init__(self, size_bytes: int | None) -> None:
        """Begin with nothing held."""
        self._sizes = (size_bytes, size_bytes) if size_bytes else (REPORT.itemsize, LONGEST_BYTES)
        self.other_ports: set[int] = set()
        super().__init__(
            FrameLayout(
                head=b"\0\0",
                prefix=4,
                size=self._size,
                longest_bytes=LONGEST_BYTES,
                checksum_ok=is_plausible,
                kind=lambda _frame: "state",
                baud=0,
            )
        )

    def _size(self, prefix: bytes) -> int:
        """Return the length that a report claims; one that is not believed becomes longer than the longest."""
        size = int.from_bytes(prefix, "big")
        if self._sizes[0] <= size <= self._sizes[1]:
            return size
        if size in OTHER_PORTS and not self.counts["frames"]:
            self.other_ports.add(OTHER_PORTS[size])
        return LONGEST_BYTES + 1


def is_plausible(report: bytes) -> bool:
    """Tell whether the joints of a report are ones that an arm can have."""
    row = np.frombuffer(report, REPORT, 1)[0]
    with np.errstate(invalid="ignore"):
        angles = np.concatenate([row["angle"], row["target_angle"]])
        velocities = np.concatenate([row["velocity"], row["target_velocity"]])
        return bool((np.abs(angles) <= ANGLE_MAX_RAD).all() and (np.abs(velocities) <= VELOCITY_MAX_RAD_S).all())


def decode(reports: Sequence[bytes], joints: int = JOINTS, ns_a_tick: int = 1000) -> dict[str, NDArray]:
    """Return what reports say: joints [rad, rad/s], torques [N m], and the controller's time [ns].

    Raises
    ------
    DataError
        When one is shorter than its joints.
    """
    short_report = next((report for report in reports if len(report) < REPORT.itemsize), None)
    if short_report is not None:
        raise DataError("a frame is no report", expected=f"{REPORT.itemsize} bytes", found=f"{len(short_report)} bytes")
    rows = np.frombuffer(b"".join(report[: REPORT.itemsize] for report in reports), REPORT)
    with np.errstate(invalid="ignore"):
        values = {name: rows[field][:, :joints].astype(np.float64) for name, field in _FIELDS.items()}
    # A clock beyond the year 2262 is none: it wraps rather than stops the decoding of what stands beside it.
    return {"device_time": (rows["time"].astype(np.uint64) * np.uint64(ns_a_tick)).astype(np.int64), **values}


_FIELDS = {
    "joint_position": "angle",
    "joint_target": "target_angle",
    "joint_velocity": "velocity",
    "joint_effort": "torque",
}


def encode(values: Mapping[str, NDArray], ns_a_tick: int = 1000) -> list[bytes]:
    """Return n reports of `DOCUMENTED_BYTES`: signals that are not given are 0, as all that no signal holds."""
    count = len(next(iter(values.values())))
    rows = np.zeros(count, REPORT)
    rows["size"] = DOCUMENTED_BYTES
    for name, field in _FIELDS.items():
        if name in values:
            block = np.asarray(values[name])
            rows[field][:, : block.shape[1]] = block
    if "device_time" in values:
        rows["time"] = np.asarray(values["device_time"]) // ns_a_tick
    rest = bytes(DOCUMENTED_BYTES - REPORT.itemsize)
    return [row.tobytes() + rest for row in rows]


def findings(framer: Framer) -> tuple[str, ...]:
    """Return what people should know of a stream: reports of another port, or none at all."""
    ports = sorted(framer.other_ports) if isinstance(framer, XarmFramer) and not framer.counts["frames"] else []
    if ports:
        return (f"these look like reports of port {ports[0]}, without a clock: connect to port 30000",)
    return no_frame_finding(framer, "no report of port 30000; firmware 2.1 or later sends it (or set bytes=N)")


def configured(settings: Mapping[str, str]) -> StreamDevice:
    """Return the arm under `joints`, `clock` (`us`, `ns`) and `bytes` (`any` or a number).

    Raises
    ------
    UsageError
        When a setting is unknown or wrong.
    """
    check_names(settings, ("joints", "clock", "bytes"))
    joints = int(number(settings, "joints", JOINTS, 1, JOINTS))
    ns_a_tick = NS_A_TICK[choice(settings, "clock", NS_A_TICK, "us")]
    any_size = settings.get("bytes", "any") == "any"
    size_bytes = None if any_size else int(number(settings, "bytes", 0, REPORT.itemsize, LONGEST_BYTES))
    names = tuple(f"joint{number}" for number in range(1, joints + 1))
    return StreamDevice(
        summary="UFACTORY xArm, TCP report of port 30000: joints, targets, velocities, torques at 200 Hz",
        rate_hz=200.0,
        link="tcp",
        port="192.168.1.185:30000",
        framer=partial(XarmFramer, size_bytes),
        signals=(
            Signal("device_time", (), "ns"),
            Signal("joint_position", (joints,), "rad", names),
            Signal("joint_target", (joints,), "rad", names),
            Signal("joint_velocity", (joints,), "rad/s", names),
            Signal("joint_effort", (joints,), "N m", names),
        ),
        decode=partial(decode, joints=joints, ns_a_tick=ns_a_tick),
        device_time="device_time",
        encode=partial(encode, ns_a_tick=ns_a_tick),
        findings=findings,
        configured=configured,
    )


DEVICE = configured({})
