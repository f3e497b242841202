"""Small recordings: ROS 2 bags in CDR, Foxglove files in protobuf and JSON, and the maps that read them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from candata.formats import Reading
from candata.formats._mcap_messages import descriptors, message
from candata.plugins import load
from candata.schema.episode import Episode

#: Unix time at which the recordings begin [ns], and the step of 100 Hz.
START, STEP = 1_700_000_000_000_000_000, 10_000_000

_TIME = "int32 sec\nuint32 nanosec"
_POINT, _QUATERNION = "float64 x\nfloat64 y\nfloat64 z", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
_POSE = "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"
_PARTS = {
    "builtin_interfaces/Time": _TIME,
    "std_msgs/Header": _HEADER,
    "geometry_msgs/Point": _POINT,
    "geometry_msgs/Vector3": _POINT,
    "geometry_msgs/Quaternion": _QUATERNION,
    "geometry_msgs/Pose": _POSE,
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
}
_MAIN = {
    "geometry_msgs/msg/Pose": _POSE,
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "geometry_msgs/msg/TransformStamped": _PARTS["geometry_msgs/TransformStamped"],
    "sensor_msgs/msg/JointState": "std_msgs/Header header\nstring[] name\n"
    "float64[] position\nfloat64[] velocity\nfloat64[] effort",
    "std_msgs/msg/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data",
    "std_msgs/msg/Bool": "bool data",
    "std_msgs/msg/String": "string data",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
_RULE = "=" * 80

Messages = Mapping[str, tuple[str, Iterable[tuple[int, Any]]]]


def write_ros2(path: Path, topics: Messages, **settings: Any) -> Path:
    """Write a ROS 2 recording: topic to its type and its messages by log time [ns]."""
    from mcap_ros2.writer import Writer

    parts = "".join(f"{_RULE}\nMSG: {name}\n{text}\n" for name, text in _PARTS.items())
    with path.open("wb") as file:
        writer = Writer(file, **settings)
        for topic, (kind, messages) in topics.items():
            schema = writer.register_msgdef(kind, f"{_MAIN[kind]}\n{parts}")
            for k, (log_ns, value) in enumerate(messages):
                writer.write_message(topic, schema, value, log_ns, log_ns - 1, k)
        writer.finish()
    return path


def write_bag(folder: Path, parts: list[Messages]) -> Path:
    """Write a bag's folder with a file for each of `parts`, and its metadata.yaml."""
    folder.mkdir()
    names = [write_ros2(folder / f"{folder.name}_{k}.mcap", part).name for k, part in enumerate(parts)]
    value = {"rosbag2_bagfile_information": {"version": 9, "relative_file_paths": names}}
    (folder / "metadata.yaml").write_text(yaml.safe_dump(value))
    return folder


def write_foxglove(path: Path, topics: Messages, encoding: str = "protobuf") -> Path:
    """Write a recording of Foxglove's messages; of JSON the messages are plain values."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "test")
        for topic, (kind, messages) in topics.items():
            proto = encoding == "protobuf"
            data = descriptors(kind) if proto else b'{"type": "object"}'
            schema = writer.register_schema(kind, "protobuf" if proto else "jsonschema", data)
            channel = writer.register_channel(topic, encoding, schema)
            for log_ns, value in messages:
                raw = value.SerializeToString() if proto else json.dumps(value).encode()
                writer.add_message(channel, log_ns, raw, log_ns)
        writer.finish()
    return path


def stamp(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}


def pose(x: float = 0.0, w: float = 1.0) -> dict[str, Any]:
    return {"position": {"x": x, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": w}}


def poses(count: int = 50, late_ns: int = 0, step: int = STEP, start: int = START) -> list[tuple[int, Any]]:
    """PoseStamped messages whose x is their number; logged `late_ns` after their stamps."""
    times = [start + k * step for k in range(count)]
    return [(t + late_ns, {"header": {"stamp": stamp(t)}, "pose": pose(float(k))}) for k, t in enumerate(times)]


def joints(count: int = 50, names: Iterable[str] = ("b", "a"), late_ns: int = 0, **more: Any) -> list[tuple[int, Any]]:
    """JointState messages: of message k joint i stands at k + i / 10."""
    names = list(names)
    times = [START + k * STEP for k in range(count)]
    return [
        (
            t + late_ns,
            {"header": {"stamp": stamp(t)}, "name": names, "position": [k + i / 10 for i in range(len(names))]} | more,
        )
        for k, t in enumerate(times)
    ]


def fox_pose(time_ns: int, x: float) -> tuple[int, Any]:
    made = message("foxglove.PoseInFrame")()
    made.timestamp.FromNanoseconds(time_ns)
    made.pose.position.x, made.pose.orientation.w = x, 1.0
    return time_ns, made


POSE_TOPIC = {"/pose": ("geometry_msgs/msg/PoseStamped", poses())}
POSE_MAP = {"rate_hz": 100, "channels": {"object_pose": "/pose"}}


def read(source: Path, mapping: Mapping[str, Any] | None = None, **told: Any) -> list[Episode]:
    """Return the episodes of a recording under a map given as a value."""
    if mapping is not None:
        path = source.parent / "topics.yaml"
        path.write_text(yaml.safe_dump(dict(mapping), sort_keys=False))
        told["mapping"] = path
    return list(load("candata.formats", "FORMAT", "mcap").read(source, Reading(**told)))
