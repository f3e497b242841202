"""The values of a channel in a message: field paths, and the fields of standard messages without a path."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from candata.errors import DataError, UsageError, Where
from candata.schema.topics import TopicEntry

#: A message to its readings: header stamp [ns] (-1 where it has none), names, values.
Reading = tuple[int, tuple[str, ...], tuple[float, ...]]
Extract = Callable[[Any], list[Reading]]

_POSES = {
    "geometry_msgs/Pose": ("position", "orientation"),
    "geometry_msgs/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/Transform": ("translation", "rotation"),
    "geometry_msgs/TransformStamped": ("transform.translation", "transform.rotation"),
    "nav_msgs/Odometry": ("pose.pose.position", "pose.pose.orientation"),
    "foxglove.Pose": ("position", "orientation"),
    "foxglove.PoseInFrame": ("pose.position", "pose.orientation"),
    "foxglove.FrameTransform": ("translation", "rotation"),
}
_FORCES = {
    "geometry_msgs/Wrench": "force",
    "geometry_msgs/WrenchStamped": "wrench.force",
    "geometry_msgs/Vector3": "",
    "geometry_msgs/Vector3Stamped": "vector",
    "foxglove.Vector3": "",
}
#: Lists of transforms: their field, and the type of their elements.
TRANSFORMS = {
    "tf2_msgs/TFMessage": ("transforms", "geometry_msgs/TransformStamped"),
    "foxglove.FrameTransforms": ("transforms", "foxglove.FrameTransform"),
}
#: Times from here on (the year 2116) are damage; differences of earlier ones stay within int64.
LATEST_NS = 1 << 62
_ARRAYS = re.compile(r"std_msgs/(U?Int(8|16|32|64)|Float(32|64))(MultiArray)?|std_msgs/Bool")
JOINTS = ("sensor_msgs/JointState", "foxglove.JointStates")
_JOINT_FIELD = {"joint_velocity": "velocity", "joint_effort": "effort"}
_JOINT_CHANNELS = ("joint_position", "joint_velocity", "joint_effort", "action")
_PATH = re.compile(r"[A-Za-z]\w*(\[-?\d*(:-?\d*)?\])*(\.[A-Za-z]\w*(\[-?\d*(:-?\d*)?\])*)*")
_Step = str | int | slice


def default_channels(kind: str) -> tuple[str, ...]:
    """Return the channels that a type of message can become without `fields`, the likeliest first."""
    if kind in _POSES or kind in TRANSFORMS:
        return ("object_pose", "hand_pose")
    if kind in JOINTS:
        return _JOINT_CHANNELS
    if kind in _FORCES:
        return ("fingertip_force",)
    if kind == "std_msgs/Bool":
        return ("contact", "fingertip_contact")
    return ("action",) if _ARRAYS.fullmatch(kind) else ()


def paths(channel: str, kind: str, entry: TopicEntry, location: Where) -> tuple[str, ...]:
    """Return the fields that make a channel's values of a type of message.

    Raises
    ------
    UsageError
        When the map gives none and the type says none for this channel, or one is no path.
    """
    kind = TRANSFORMS[kind][1] if kind in TRANSFORMS else kind
    for path in entry.fields:
        if not _PATH.fullmatch(path):
            raise UsageError(
                f"{path!r} is no field path",
                expected="such as pose.position.x or data[0:6]",
                found=path,
                where=location,
            )
    fields = entry.fields or _standard(channel, kind)
    if not fields:
        raise UsageError(
            f"nothing says which fields of {entry.topic} are {channel}",
            expected=f"`fields:` for a message of type {kind}",
            found="none",
            where=location,
            fix=f"add fields: [...] to {channel} in the map",
        )
    return fields


def _standard(channel: str, kind: str) -> tuple[str, ...]:
    """Return the fields of a standard message, none where it cannot be this channel."""
    if channel in ("object_pose", "hand_pose") and kind in _POSES:
        at, turn = _POSES[kind]
        return tuple(f"{at}.{a}" for a in "xyz") + tuple(f"{turn}.{a}" for a in "wxyz")
    if channel == "fingertip_force" and kind in _FORCES:
        return tuple(f"{_FORCES[kind]}.{a}".lstrip(".") for a in "xyz")
    if channel not in ("object_pose", "hand_pose", "object_velocity") and _ARRAYS.fullmatch(kind):
        return ("data",)
    return ()


def by_joint(channel: str, kind: str, entry: TopicEntry) -> bool:
    """Tell whether the values stand beside names in the message."""
    return kind in JOINTS and channel in _JOINT_CHANNELS and (not entry.fields or entry.fields[0] in _JOINT_VALUES)


_JOINT_VALUES = ("position", "velocity", "effort")


def extract(channel: str, kind: str, entry: TopicEntry, location: Where) -> Extract:
    """Return the function that takes a channel's readings from a message.

    The function raises DataError when a field is missing or is no number.

    Raises
    ------
    UsageError
        When the map does not say what to take.
    """
    if by_joint(channel, kind, entry):
        value = entry.fields[0] if entry.fields else _JOINT_FIELD.get(channel, "position")
        return lambda message: _joints(message, value, entry, location)
    steps = [_steps(path) for path in paths(channel, kind, entry, location)]
    if kind in TRANSFORMS or kind == "foxglove.FrameTransform":
        if entry.child is None:
            raise UsageError(
                f"nothing says which frame of {entry.topic} is {channel}",
                expected="`child:` (and `parent:` where several have it)",
                where=location,
            )
        return lambda message: [
            _plain_reading(item, steps, location) for item in _transforms(message, kind, entry, location)
        ]
    return lambda message: [_plain_reading(message, steps, location)]


def _plain_reading(message: Any, steps: Sequence[list[_Step]], location: Where) -> Reading:
    """Return the reading in a message or an element of its list."""
    return (
        stamp_ns(message),
        (),
        tuple(number for path in steps for number in _numbers(_at(message, path, location), location)),
    )


def _transforms(message: Any, kind: str, entry: TopicEntry, location: Where) -> Iterable[Any]:
    """Return the transforms of the wanted frame."""
    return [
        item
        for item in transforms(message, kind)
        if _frames(item)[1] == entry.child and entry.parent in (None, _frames(item)[0])
    ]


def _frames(item: Any) -> tuple[str, str]:
    """Return parent and child frame of a transform."""
    header = _get(item, "header")
    parent = _get(item, "parent_frame_id") if header is None else _get(header, "frame_id")
    return str(parent), str(_get(item, "child_frame_id"))


def transforms(message: Any, kind: str) -> list[Any]:
    """Return the transforms in a message; none where its type holds none."""
    if kind in TRANSFORMS:
        return list(_get(message, TRANSFORMS[kind][0]) or ())
    return [message] if kind in ("foxglove.FrameTransform", "geometry_msgs/TransformStamped") else []


def child_frame(item: Any) -> str:
    """Return the child frame of a transform."""
    return _frames(item)[1]


def joint_names(message: Any) -> tuple[str, ...]:
    """Return the names in a message of joints."""
    joints = _get(message, "joints")
    names = _get(message, "name") if joints is None else [_get(joint, "name") for joint in joints]
    return tuple(str(name) for name in names or ())


def _joints(message: Any, value: str, entry: TopicEntry, location: Where) -> list[Reading]:
    """Return the reading of the wanted joints; none where the message names none of them."""
    names, joints = joint_names(message), _get(message, "joints")
    raw_values = _get(message, value) if joints is None else [_get(joint, value) for joint in joints]
    wanted_names = entry.joints or names
    if not set(wanted_names) & set(names):
        return []
    values = _numbers(raw_values, location)
    if len(values) != len(names):
        raise DataError(
            f"{entry.topic} gives no {value} of each joint",
            expected=f"{len(names)} values",
            found=str(len(values)),
            where=location,
        )
    by_name = dict(zip(names, values, strict=True))
    missing_names = [name for name in wanted_names if name not in by_name]
    if missing_names:
        raise DataError(
            f"{entry.topic} lacks joints of the map",
            expected=", ".join(wanted_names),
            found=", ".join(names),
            where=location,
            fix=_nearest_hint(missing_names[0], names, "correct `joints` in the map"),
        )
    return [(stamp_ns(message), tuple(wanted_names), tuple(by_name[name] for name in wanted_names))]


def stamp_ns(message: Any) -> int:
    """Return a message's own stamp `header.stamp` or `timestamp` [ns]; -1 where it has none."""
    header = _get(message, "header")
    stamp = _get(message, "timestamp") if header is None else _get(header, "stamp")
    if stamp is None:
        return -1
    seconds = next((v for v in (_get(stamp, name) for name in ("sec", "seconds")) if v is not None), 0)
    parts = (_get(stamp, name) for name in ("nanosec", "nanos", "nsec"))
    nanoseconds = next((v for v in parts if v is not None), 0)
    if not (isinstance(seconds, int) and isinstance(nanoseconds, int)):
        return -1
    total_ns = seconds * 1_000_000_000 + nanoseconds
    return total_ns if 0 <= total_ns < LATEST_NS else -1


def _steps(path: str) -> list[_Step]:
    """Return the steps of a path: names, indices, slices."""
    steps: list[_Step] = []
    for name, index_text in re.findall(r"([A-Za-z]\w*)|\[([^\]]*)\]", path):
        if name:
            steps.append(name)
        elif ":" in index_text:
            start, stop = (int(part) if part else None for part in index_text.split(":"))
            steps.append(slice(start, stop))
        else:
            steps.append(int(index_text or 0))
    return steps


def _get(value: Any, name: str) -> Any:
    """Return a field of a message, None where it has no such field."""
    if isinstance(value, Mapping):
        return value.get(name)
    descriptor = getattr(value, "DESCRIPTOR", None)
    if descriptor is not None and name not in descriptor.fields_by_name:
        return None
    return getattr(value, name, None)


def field_names(value: Any) -> list[str]:
    """Return the names of a message's fields."""
    if isinstance(value, Mapping):
        return [str(name) for name in value]
    descriptor = getattr(value, "DESCRIPTOR", None)
    return list(descriptor.fields_by_name) if descriptor is not None else list(getattr(value, "__slots__", ()))


def _at(value: Any, steps: Sequence[_Step], location: Where) -> Any:
    """Return what stands at a path."""
    for step in steps:
        if isinstance(step, str):
            inner = _get(value, step)
            if inner is None:
                known_fields = field_names(value)
                raise DataError(
                    f"the message has no field {step}",
                    expected=".".join(str(s) for s in steps),
                    found=f"fields {', '.join(known_fields)}" if known_fields else "a value without fields",
                    where=location,
                    fix=_nearest_hint(step, known_fields, "correct `fields` in the map"),
                )
        else:
            try:
                inner = value[step]
            except (IndexError, TypeError, KeyError):
                size = f"{len(value)} values" if hasattr(value, "__len__") else "no list"
                raise DataError(
                    "the message has no such element", expected=str(step), found=size, where=location
                ) from None
        value = inner
    return value


def _numbers(value: Any, location: Where) -> tuple[float, ...]:
    """Return a number or lists of them as floats, in order; null is none that is known."""
    if hasattr(value, "__iter__") and not isinstance(value, str | Mapping):
        return tuple(number for item in value for number in _numbers(item, location))
    try:
        return (float("nan") if value is None else float(value),)
    except (TypeError, ValueError, OverflowError):
        raise DataError(
            "a field does not hold numbers",
            expected="numbers",
            found=repr(value)[:80],
            where=location,
            fix="name the fields down to the numbers, such as pose.position.x",
        ) from None


def _nearest_hint(name: str, known_names: Iterable[str], otherwise: str) -> str:
    """Return a hint at the nearest name."""
    matches = difflib.get_close_matches(name, list(known_names), n=1)
    return f"did you mean {matches[0]!r}?" if matches else otherwise
