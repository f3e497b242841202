"""What a log is imported with: streams of a table or an MCAP file that the wire does not carry, on their own stamps."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, UsageError, Where
from candata.formats import table
from candata.formats._columns import TABLES
from candata.formats._mapping import read_map
from candata.schema.episode import Episode

#: Channels that are taken from a companion; forces and contact come from the wire alone.
IMPORTED_CHANNELS = ("object_pose", "object_velocity", "hand_pose", "joint_position", "action")
_NAMES = {"joint_position": "joint_names", "action": "actuator_names"}


@dataclass(frozen=True, eq=False)
class RecordedStream:
    """One channel with stamps of its own.

    Attributes
    ----------
    channel : str
        Name of the channel.
    names : tuple of str
        Joints or actuators in the order of the columns; empty for poses.
    time_ns : (n,) int64 [unix ns]
        Stamps, not decreasing.
    values : (n, ...) ndarray
        In the channel's unit; rows that are not finite were not read.
    origin : str
        Name of the file (and topic).
    device_time_ns : (n,) int64 [ns], optional
        The device's own clock at each row, with its own zero.
    """

    channel: str
    names: tuple[str, ...]
    time_ns: NDArray[np.int64]
    values: NDArray
    origin: str
    device_time_ns: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False)
class Companion:
    """A file beside a log.

    Attributes
    ----------
    name : str
        Name of the file.
    streams : tuple of Stream
        What is taken from it.
    digest : str
        sha256 over what determines them.
    left_out : tuple of str
        Channels that it has and that are not taken.
    scene, object, task : str or None
        What it says the recording shows.
    """

    name: str
    streams: tuple[RecordedStream, ...]
    digest: str
    left_out: tuple[str, ...] = ()
    scene: str | None = None
    object: str | None = None
    task: str | None = None


def read_companion(path: Path) -> Companion:
    """Return the streams of a `map.yaml`, of the table that a map.yaml beside it names, or of an MCAP file.

    Stamps must be unix time: that of the machine which recorded the log.

    Raises
    ------
    UsageError
        When the file is of another kind, or a table without its map.
    DataError
        When the file is missing, damaged or holds nothing to take.
    MissingExtraError
        When an MCAP file is given and the packages that read it are not installed.
    """
    kind = path.suffix.lower()
    if kind in (".yaml", ".yml"):
        return _from_table(path)
    if kind in TABLES:
        return _from_table(_map_of(path))
    if kind == ".mcap":
        return _from_mcap(path)
    raise UsageError(
        "cannot import a log with this file",
        expected=f"a map.yaml, a table ({', '.join(TABLES)}) with its map.yaml beside it, or .mcap",
        found=path.name,
        where=Where(path=str(path)),
    )


def _map_of(path: Path) -> Path:
    """Return the map beside a table."""
    map_path = path.parent / "map.yaml"
    if not map_path.is_file() or (map_path.parent / read_map(map_path).file).resolve() != path.resolve():
        raise UsageError(
            "the table has no map",
            expected=f"{map_path} with `file: {path.name}`",
            found="a map of another file" if map_path.is_file() else "no such file",
            where=Where(path=str(path)),
            fix="write a map.yaml that names its columns, and give that",
        )
    return map_path


def _from_table(path: Path) -> Companion:
    """Return the streams of a mapped table; several episodes in it are one stream."""
    episodes = sorted(table.read(path, allow_gaps=True), key=lambda e: int(e["time_ns"][0]))
    channels = [c for c in IMPORTED_CHANNELS if c in episodes[0]]
    skipped_channels = set(episodes[0].arrays) - {*IMPORTED_CHANNELS, "time_ns", "contact"}
    left_out = tuple(c for c in episodes[0].arrays if c in skipped_channels and not c.endswith("_valid"))
    streams = tuple(_stream(channel, episodes, path) for channel in channels)
    meta = episodes[0].meta
    return Companion(path.name, streams, table.digest(path), left_out, meta.scene, meta.object, meta.task)


def _stream(channel: str, episodes: list[Episode], path: Path) -> RecordedStream:
    """Return one channel of a table's episodes, in the order of time."""
    times, values = [], []
    for episode in episodes:
        time_ns, rows = episode["time_ns"], np.array(episode[channel], np.float64)
        rows[~episode.valid(channel)] = np.nan
        if channel == "action" and episode.meta.action == "previous":
            time_ns, rows = time_ns[:-1], rows[1:]  # row k was held from the stamp before it
        times.append(time_ns)
        values.append(rows)
    names = getattr(episodes[0].meta, _NAMES.get(channel, ""), ())
    return _check_stamps(RecordedStream(channel, names, np.concatenate(times), np.concatenate(values), path.name), path)


def _check_stamps(stream: RecordedStream, path: Path) -> RecordedStream:
    """Return a stream whose stamps do not run back."""
    falling_rows = np.flatnonzero(np.diff(stream.time_ns) < 0)
    if len(falling_rows):
        raise DataError(
            "the stamps run back",
            expected="one recording, in the order of time",
            found=f"{len(falling_rows)} steps back",
            where=Where(path=str(path), channel=stream.channel, index=int(falling_rows[0]) + 1),
            fix="sort the rows by time; give recordings of several clocks apart",
        )
    return stream


def _from_mcap(path: Path) -> Companion:
    """Return the poses and joints of an MCAP file: `foxglove.PoseInFrame` and `foxglove.JointStates`."""
    rows: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    schema_of: dict[str, str] = {}
    for topic, schema, log_time, data in _messages(path):
        reader = _READERS.get(schema)
        if reader is not None:
            schema_of[topic] = schema
            rows[topic].append(reader(data, log_time))
    _one_object(path, [topic for topic, schema in schema_of.items() if schema == _POSE])
    streams = tuple(_topic(path, topic, schema_of[topic], topic_rows) for topic, topic_rows in sorted(rows.items()))
    if not streams:
        raise DataError(
            "the file holds nothing to import",
            expected=" or ".join(_READERS),
            found="no such messages",
            where=Where(path=str(path)),
        )
    with path.open("rb") as file:
        return Companion(path.name, streams, hashlib.file_digest(file, "sha256").hexdigest())


def _messages(path: Path) -> Iterable[tuple[str, str, int, bytes]]:
    """Yield topic, schema name, log time [ns] and bytes of every message."""
    from mcap.records import Channel, Message, Schema

    from candata.formats._mcap_scan import Scan

    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    for record in Scan(path):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            channels[record.id] = (record.topic, schemas.get(record.schema_id, ""))
        elif isinstance(record, Message):
            topic, schema = channels.get(record.channel_id, ("", ""))
            yield topic, schema, record.log_time, record.data


_POSE, _JOINTS = "foxglove.PoseInFrame", "foxglove.JointStates"


def _pose(data: bytes, log_time: int) -> tuple[int, Any]:
    """Return the stamp and (m, w x y z) of a pose."""
    message = _decode(_POSE, data)
    at, turn = message.pose.position, message.pose.orientation
    return _stamp(message, log_time), (at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z)


def _joints(data: bytes, log_time: int) -> tuple[int, Any]:
    """Return the stamp, and positions by joint name."""
    message = _decode(_JOINTS, data)
    return _stamp(message, log_time), {joint.name: joint.position for joint in message.joints}


def _decode(name: str, data: bytes) -> Any:
    """Return a protobuf message; bytes that are none are refused."""
    from candata.formats._mcap_messages import message

    kind = message(name)
    from google.protobuf.message import DecodeError

    try:
        return kind.FromString(data)
    except DecodeError as error:
        raise DataError(f"a message is no {name}", found=str(error)) from None


def _stamp(message: Any, log_time: int) -> int:
    """Return the message's own stamp, or when it was logged if it has none."""
    return message.timestamp.ToNanoseconds() or log_time


_READERS: dict[str, Callable[[bytes, int], tuple[int, Any]]] = {_POSE: _pose, _JOINTS: _joints}


def _one_object(path: Path, topics: list[str]) -> None:
    """Refuse several poses: nothing says which of them is the object's."""
    if len(topics) > 1:
        raise DataError(
            "the file holds several poses",
            expected=f"one topic of {_POSE}: the object's",
            found=", ".join(sorted(topics)),
            where=Where(path=str(path)),
            fix="write the object's poses to a file of their own",
        )


def _topic(path: Path, topic: str, schema: str, topic_rows: list[tuple[int, Any]]) -> RecordedStream:
    """Return the stream of one topic; of joints, what is commanded bears `target` or `command` in its name."""
    topic_rows = sorted(topic_rows, key=lambda row: row[0])
    time_ns = np.array([stamp for stamp, _ in topic_rows], np.int64)
    origin = f"{path.name} {topic}"
    if schema == _POSE:
        return RecordedStream(
            "object_pose", (), time_ns, _unit(np.array([row for _, row in topic_rows]), path, topic), origin
        )
    names = tuple(topic_rows[0][1])
    for index, (_, row) in enumerate(topic_rows):
        if set(row) != set(names):
            raise DataError(
                f"the joints of {topic} change",
                expected=", ".join(names),
                found=", ".join(row),
                where=Where(path=str(path), index=index),
            )
    values = np.array([[row[name] for name in names] for _, row in topic_rows], np.float64)
    topic_name = topic.rsplit("/", 1)[-1]
    channel = "action" if "target" in topic_name or "command" in topic_name else "joint_position"
    return RecordedStream(channel, names, time_ns, values, origin)


def _unit(poses: NDArray[np.float64], path: Path, topic: str) -> NDArray[np.float64]:
    """Return poses whose quaternions are unit; a zero one (a message that was never filled) is refused."""
    norm = np.linalg.norm(poses[:, 3:], axis=1)
    bad_rows = np.flatnonzero(~(np.abs(norm - 1) < 0.01))
    if len(bad_rows):
        raise DataError(
            f"{topic} holds a quaternion that is not unit",
            expected="norm 1",
            found=f"norm {norm[bad_rows[0]]:.4g} ({len(bad_rows)} messages)",
            where=Where(path=str(path), channel="object_pose", index=int(bad_rows[0])),
        )
    poses[:, 3:] /= norm[:, None]
    return poses
