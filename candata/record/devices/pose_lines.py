"""A tracker that sends one line of text for each pose, over UDP or TCP: what a FoundationPose loop prints.

    candata-pose 1 TIME OBJECT X Y Z QW QX QY QZ [SCORE]

Version 1; the time in seconds on the sender's clock; the object's name without spaces; the position in metres and the
unit quaternion, w first, of the object in the frame of the scene's world; a score, if there is one. Fields are parted
by spaces. Each line ends with a line feed, in a datagram too.

What else is sent is found and told, and no pose is taken from it until a setting behind the address says how it is to
be read:

- lines of a second object, unless `object=NAME` says which is meant;
- positions out of reach (`reach=3` metres from the origin), which are mostly millimetres: `unit=mm`;
- quaternions that look like x y z w: `order=wxyz` or `order=xyzw`.

The order cannot be told from how an object turns. Its four numbers read in the other order are the same curve on the
sphere of unit quaternions but for a mirror image, q -> p conj(q) r with fixed p, r: as smooth, as fast, as often about
one axis. What remains is where the object starts: most start near the orientation they are described in. So a first
quaternion near (0, 0, 0, 1) is taken for x y z w, one near (1, 0, 0, 0) for w x y z; of others it is said that the
order is not known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.record.devices._contract import Framer, Signal, StreamDevice
from candata.record.devices._settings import check_names, choice, number
from candata.record.devices._wire import DelimitedFramer, FrameKind, no_frame_finding

WORD, VERSION = b"candata-pose", b"1"
#: A line without a score, and with one, has so many fields.
FIELDS = (11, 12)
LONGEST_BYTES = 512
#: Farther from the origin than this is no table with a robot [m].
REACH_M = 3.0
#: How far the length of a quaternion may be from 1: six digits a number leave 1e-6, a filter less than this.
UNIT_TOLERANCE = 0.01
#: A quaternion this near to a half turn's (w of 0.3: 145 degrees) or to none (0.9: 52 degrees) speaks for an order.
NEAR_ZERO, NEAR_ONE = 0.3, 0.9
#: What a tracker of a depth camera gives [Hz].
RATE_HZ = 15.0
#: Names of objects that are kept for people.
MOST_OBJECTS = 8
#: Positions are clipped to this before their length is taken: squares of larger ones overflow.
DISTANCE_MAX = 1e9
#: Times beyond this are none: the year 2262, where nanoseconds end [s].
TIME_MAX_S = 9.2e9


@dataclass(frozen=True)
class Reading:
    """How lines are to be read.

    Attributes
    ----------
    object_name : str
        The object that is meant; empty: the first one.
    metres : float
        What a unit of the position is [m].
    order : str
        `wxyz`, `xyzw`, or `auto`: w x y z unless the first line speaks against it.
    reach_m : float
        The farthest position that is believed [m].
    """

    object_name: str = ""
    metres: float = 1.0
    order: str = "auto"
    reach_m: float = REACH_M


@dataclass(frozen=True)
class Line:
    """One line, as it was sent.

    Attributes
    ----------
    time_ns : int
        The sender's time [ns].
    object_name : str
        The object.
    position, quaternion : (3,), (4,) float64
        As they stand.
    score : float
        NaN where there is none.
    """

    time_ns: int
    object_name: str
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    score: float


def parse(line: bytes) -> Line | None:
    """Return what a line says, or None when it is not as documented, or its quaternion is none."""
    fields = line.split()
    # Python reads 1_0 as ten; a line does not.
    if len(fields) not in FIELDS or fields[:2] != [WORD, VERSION] or any(b"_" in field for field in fields[4:]):
        return None
    try:
        time_s = Decimal(fields[2].decode("ascii"))
        object_name = fields[3].decode()
        numbers = np.array([float(field) for field in fields[4:]])
    except (ValueError, InvalidOperation):
        return None
    quaternion = numbers[3:7]
    if not np.isfinite(numbers).all() or not time_s.is_finite() or abs(time_s) > TIME_MAX_S:
        return None
    if abs(np.sqrt(np.sum(np.square(np.clip(quaternion, -2, 2)))) - 1) > UNIT_TOLERANCE:
        return None
    score = float(numbers[7]) if len(numbers) > 7 else float("nan")
    return Line(int(time_s.scaleb(9).to_integral_value()), object_name, numbers[:3], quaternion, score)


def order_evidence(quaternion: NDArray) -> Literal["wxyz", "xyzw", "unknown"]:
    """Return the order for which the quaternion of an object at its start speaks."""
    first, last = abs(quaternion[0]), abs(quaternion[3])
    if last >= NEAR_ONE and first <= NEAR_ZERO:
        return "xyzw"
    return "wxyz" if first >= NEAR_ONE and last <= NEAR_ZERO else "unknown"


class PoseFramer(DelimitedFramer):
    """Cuts lines; gives those that are to be read as `state`, and others as `other`, counted by why.

    The counts are `malformed`, `other_version`, `other_object`, `beyond_reach`, `order_doubtful`.
    """

    def __init__(self, reading: Reading) -> None:
        """Begin with no line heard."""
        super().__init__(b"\n", LONGEST_BYTES, self._judge_line)
        self.reading = reading
        self.objects: list[str] = []  # in the order in which they were heard, at most MOST_OBJECTS
        self.evidence: str | None = None  # of the first line of the object that is meant
        self.first_beyond = 0.0  # distance of the first position beyond reach, as sent

    def _judge_line(self, line: bytes) -> tuple[FrameKind, bytes] | str:
        """Return a line as a frame, or what to count."""
        parsed = parse(line)
        if parsed is None:
            fields = line.split(None, 2)
            return "other_version" if len(fields) > 1 and fields[0] == WORD and fields[1] != VERSION else "malformed"
        if parsed.object_name not in self.objects and len(self.objects) < MOST_OBJECTS:
            self.objects.append(parsed.object_name)
        if parsed.object_name != (self.reading.object_name or self.objects[0]):
            return "other_object"
        distance = float(np.linalg.norm(np.clip(parsed.position, -DISTANCE_MAX, DISTANCE_MAX)))
        if not distance * self.reading.metres <= self.reading.reach_m:
            self.first_beyond = self.first_beyond or distance
            return "beyond_reach"
        if self.evidence is None:
            self.evidence = order_evidence(parsed.quaternion)
        if self.reading.order == "auto" and self.evidence == "xyzw":
            return "order_doubtful"
        return "state", line + b"\n"


def decode(lines: Sequence[bytes], reading: Reading) -> dict[str, NDArray]:
    """Return what lines say: `device_time (n,) int64 [ns]`, `object_pose (n, 7)` [m, w x y z], `score (n,)`.

    Raises
    ------
    DataError
        When a line is not as documented.
    """
    rows: list[Line] = []
    for line in lines:
        parsed = parse(line)
        if parsed is None:
            raise DataError("a frame is no line of a pose", found=repr(line[:80]))
        rows.append(parsed)
    quaternions = np.array([row.quaternion for row in rows]).reshape(-1, 4)
    if reading.order == "xyzw":
        quaternions = np.roll(quaternions, 1, axis=1)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    positions = np.array([row.position for row in rows]).reshape(-1, 3) * reading.metres
    return {
        "device_time": np.array([row.time_ns for row in rows], np.int64),
        "object_pose": np.hstack([positions, quaternions]),
        "score": np.array([row.score for row in rows]),
    }


def encode(values: Mapping[str, NDArray], object_name: str = "object") -> list[bytes]:
    """Return n lines of `device_time`, `object_pose` and, where it is given, `score`; with nine digits."""
    poses = np.asarray(values["object_pose"])
    times_ns = values.get("device_time", np.arange(len(poses)) * round(1e9 / RATE_HZ))
    scores = values.get("score")
    lines: list[bytes] = []
    for k, pose in enumerate(poses):
        seconds, rest_ns = divmod(int(times_ns[k]), 1_000_000_000)
        numbers = " ".join(f"{value:.9f}" for value in pose)
        score = "" if scores is None or np.isnan(scores[k]) else f" {scores[k]:.6g}"
        lines.append(f"{WORD.decode()} 1 {seconds}.{rest_ns:09d} {object_name} {numbers}{score}\n".encode())
    return lines


def findings(framer: Framer) -> tuple[str, ...]:
    """Return what people should know of a stream: see the head of this module."""
    if not isinstance(framer, PoseFramer):
        return ()
    counts, reading = framer.counts, framer.reading
    lines: list[str] = []
    if counts.get("malformed") or counts.get("oversize"):
        lines.append("lines that are no poses are left out: candata-pose 1 TIME OBJECT X Y Z QW QX QY QZ [SCORE]")
    if counts.get("other_version"):
        lines.append("lines of another version than 1 are left out")
    if counts.get("other_object"):
        meant = reading.object_name or framer.objects[0]
        lines.append(f"several objects ({', '.join(framer.objects)}): only {meant} is taken; set object=NAME")
    if counts.get("beyond_reach"):
        is_millimetres = framer.first_beyond / 1000 <= reading.reach_m
        cause = "millimetres? set unit=mm" if is_millimetres and reading.metres == 1 else "set reach=METRES"
        lines.append(
            f"positions beyond {reading.reach_m:g} m are left out (the first: {framer.first_beyond:.4g}): {cause}"
        )
    if reading.order == "auto" and framer.evidence == "xyzw":
        lines.append("the quaternions look like x y z w and are left out: set order=xyzw, or order=wxyz if w is first")
    if reading.order == "auto" and framer.evidence == "unknown":
        lines.append("the order of the quaternions cannot be told: read as w x y z; set order=wxyz if that is so")
    return tuple(lines) or no_frame_finding(framer, "no line feed ends a line")


def configured(settings: Mapping[str, str]) -> StreamDevice:
    """Return the tracker under `object`, `unit` (`m`, `mm`), `order` (`auto`, `wxyz`, `xyzw`), `reach` [m].

    Raises
    ------
    UsageError
        When a setting is unknown or wrong.
    """
    check_names(settings, ("object", "unit", "order", "reach"))
    reading = Reading(
        object_name=settings.get("object", ""),
        metres=1e-3 if choice(settings, "unit", ("m", "mm"), "m") == "mm" else 1.0,
        order=choice(settings, "order", ("auto", "wxyz", "xyzw"), "auto"),
        reach_m=number(settings, "reach", REACH_M, 0.01, 1000),
    )
    return StreamDevice(
        summary="tracker that sends one documented text line a pose, over UDP or TCP, such as FoundationPose",
        rate_hz=RATE_HZ,
        link="udp",
        port="0.0.0.0:30015",
        framer=lambda: PoseFramer(reading),
        signals=(Signal("device_time", (), "ns"), Signal("object_pose", (7,), "m"), Signal("score", (), "1")),
        decode=lambda lines: decode(lines, reading),
        device_time="device_time",
        encode=encode,
        findings=findings,
        configured=configured,
    )


DEVICE = configured({})
