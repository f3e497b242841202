"""The log of a recording: an MCAP file of profile `candata`, written as it comes and read back as arrays.

Times in a log are unix nanoseconds: the monotonic stamp of the reader plus one offset taken at the start, so that
intervals are those of the monotonic clock. `/wire` holds every byte as it was read; the other topics say the same
decoded, one message a frame, and messages of one state frame bear one sequence number.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, Where
from candata.formats._mcap_messages import descriptors, message
from candata.formats._mcap_scan import Scan
from candata.record.calibration import Calibration, from_metadata, to_metadata
from candata.record.devices._contract import Commands, Device, States
from candata.record.log_messages import (
    EVENTS,
    FORCES,
    JOINTS,
    MOTORS,
    STATISTICS,
    TARGETS,
    TAXELS,
    WIRE,
    state_arrays,
    target_arrays,
)
from candata.record.log_streams import STREAM, LoggedStream, logged_stream, stream_metas
from candata.record.sink import Sink
from candata.schema.json_text import parse_json
from candata.schema.record import Record

PROFILE = "candata"
META, CALIBRATION = "candata.log", "candata.calibration"
_MESSAGES = {
    WIRE: "candata.WireBytes",
    JOINTS: "foxglove.JointStates",
    TARGETS: "foxglove.JointStates",
    FORCES: "candata.FingertipForces",
    TAXELS: "candata.TactileFrame",
    MOTORS: "candata.MotorState",
}
_JSON = {STATISTICS: "candata.Statistics", EVENTS: "candata.Event"}
_CHUNK_BYTES = 64 * 1024


class LogMeta(Record):
    """What a log says of itself, in its metadata record `candata.log`.

    `wall_offset_ns` is unix time minus monotonic time at the start; `port` and `baud` say where the bytes came from;
    `session` names the session that the log is of, and is empty for a recording without marks.
    """

    device: str
    joint_names: tuple[str, ...]
    fingertip_names: tuple[str, ...]
    taxels: int
    newton_per_count: float
    count_low: tuple[int, int, int]
    count_high: tuple[int, int, int]
    rate_hz: float
    baud: int = 0
    port: str = ""
    wall_offset_ns: int = 0
    version: str = ""
    session: str = ""


@dataclass(frozen=True, eq=False)
class Log:
    """A whole log in memory; times are unix nanoseconds, rows are state frames.

    Attributes
    ----------
    meta : LogMeta
        Device, names and scales.
    calibration : Calibration or None
        What the resting hand read; None where it was not calibrated.
    state_time_ns : (n,) int64 [ns]
        When each state frame began on the wire.
    joint_position : (n, J) float64 [rad]
        Joint positions.
    motor_current : (n, J) float64 [A]
        Motor currents.
    force_counts : (n, F, 3) int16
        Total force of each fingertip in counts, nothing subtracted.
    taxel_counts : (n, F, N, 3) int16 or None
        Force of each taxel in counts, nothing subtracted.
    command_time_ns : (m,) int64 [ns]
        When each command frame began on the wire.
    joint_target : (m, J) float64 [rad]
        Joint targets.
    statistics : tuple of dict
        What the recorder noted each second, oldest first.
    sha256 : str
        Hash of the file.
    torn : bool
        True where the file has no end (its writer was killed): what stands before the tear was read.
    damaged_chunks : int
        Chunks that could not be read and are missing here.
    read_time_ns : (k,) int64 [ns]
        When bytes were read from the port.
    events : tuple of (int, dict)
        What was marked in a session and when [ns], in the order in which it was written.
    streams : tuple of LoggedStream
        What was recorded beside the hand, raw, in the order in which it was opened.
    """

    meta: LogMeta
    calibration: Calibration | None
    state_time_ns: NDArray[np.int64]
    joint_position: NDArray[np.float64]
    motor_current: NDArray[np.float64]
    force_counts: NDArray[np.int16]
    taxel_counts: NDArray[np.int16] | None
    command_time_ns: NDArray[np.int64]
    joint_target: NDArray[np.float64]
    statistics: tuple[dict[str, Any], ...]
    sha256: str
    torn: bool = False
    damaged_chunks: int = 0
    read_time_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    events: tuple[tuple[int, dict[str, Any]], ...] = ()
    streams: tuple[LoggedStream, ...] = ()


def meta_of(device: Device, name: str, **settings: Any) -> LogMeta:
    """Return the metadata of a log of `device`, registered as `name`; `settings` replace the device's own."""
    from candata import __version__

    names = "joint_names fingertip_names taxels newton_per_count count_low count_high rate_hz baud"
    device_fields = {field: getattr(device, field) for field in names.split()}
    return LogMeta.model_validate({"device": name, "version": __version__, **device_fields, **settings})


class LogWriter:
    """Writes a log; every method raises SetupError when the disk takes no more, and then keeps what was flushed.

    Stamps are monotonic nanoseconds; the offset in `meta` makes them unix time.
    """

    def __init__(self, path: Path, meta: LogMeta) -> None:
        """Create the file, which must not exist, with its metadata on the disk.

        Raises
        ------
        UsageError
            When the file exists.
        SetupError
            When it cannot be written.
        """
        from mcap.writer import Writer

        classes = {topic: message(name) for topic, name in _MESSAGES.items()}
        self.meta, self.path = meta, path
        self._syncer = ThreadPoolExecutor(1, "log-sync")
        self._syncing: Future[None] | None = None
        self._class = classes
        self._frames = {JOINTS: 0, TARGETS: 0}
        self._sink = Sink(path)
        self._writer = Writer(self._sink, chunk_size=_CHUNK_BYTES)  # type: ignore[arg-type]
        with self._sink.guarded():
            self._writer.start(PROFILE, library=f"candata {meta.version}")
        self.metadata(META, meta.model_dump(mode="json"))
        self._channels = {topic: self._channel(topic, "protobuf", name) for topic, name in _MESSAGES.items()}
        for topic, name in _JSON.items():
            schema = self._writer.register_schema(name, "jsonschema", b'{"type": "object"}')
            self._channels[topic] = self._writer.register_channel(topic, "json", schema)
        self.flush()
        self.sync()

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._sink.tell()

    @property
    def failed(self) -> bool:
        """Whether the disk took no more: nothing can be written any longer."""
        return self._sink.failed

    def wire(self, data: bytes, stamp_ns: int) -> None:
        """Write bytes as they were read at `stamp_ns`."""
        self.message(WIRE, stamp_ns, self._class[WIRE](data=data))

    def states(self, stamps_ns: Sequence[int], states: States) -> None:
        """Write n decoded state frames that began at `stamps_ns`."""
        for i, stamp_ns in enumerate(stamps_ns):
            self._frames[JOINTS] += 1
            self._state(stamp_ns, self._frames[JOINTS], states, i)

    def commands(self, stamps_ns: Sequence[int], commands: Commands) -> None:
        """Write n decoded command frames that began at `stamps_ns`."""
        for stamp_ns, target in zip(stamps_ns, commands.joint_target, strict=True):
            self._frames[TARGETS] += 1
            self.message(TARGETS, stamp_ns, self._joints(TARGETS, stamp_ns, target), self._frames[TARGETS])

    def statistics(self, stamp_ns: int, values: Mapping[str, Any]) -> None:
        """Write what the recorder counted so far, as JSON."""
        self._add_bytes(STATISTICS, stamp_ns, json.dumps(values, allow_nan=False).encode(), 0)

    def event(self, stamp_ns: int, values: Mapping[str, Any]) -> None:
        """Write what was marked in a session, as JSON."""
        self._add_bytes(EVENTS, stamp_ns, json.dumps(values, allow_nan=False).encode(), 0)

    def calibration(self, calibration: Calibration) -> None:
        """Write the calibration as a metadata record, and flush."""
        self.metadata(CALIBRATION, to_metadata(calibration))
        self.flush()

    def metadata(self, name: str, values: Mapping[str, Any]) -> None:
        """Write a metadata record, each value as JSON."""
        with self._sink.guarded():
            self._writer.add_metadata(name, {key: json.dumps(value) for key, value in values.items()})

    def topic(self, topic: str, message_name: str) -> None:
        """Begin a topic of protobuf messages."""
        with self._sink.guarded():
            self._channels[topic] = self._channel(topic, "protobuf", message_name)

    def message(self, topic: str, stamp_ns: int, value: Any, number: int = 0) -> None:
        """Write a message of a topic that was begun; messages of one frame bear one `number`."""
        self._add_bytes(topic, stamp_ns, value.SerializeToString(), number)

    def unix_ns(self, stamp_ns: int) -> int:
        """Return a monotonic stamp as unix time [ns]."""
        return stamp_ns + self.meta.wall_offset_ns

    def flush(self) -> None:
        """Hand everything so far to the operating system: a kill of this process loses none of it."""
        with self._sink.guarded():
            self._writer.flush()
        self._sink.commit()

    def sync(self) -> None:
        """Force what was flushed to the disk: a power cut loses none of it."""
        with self._sink.guarded():
            self._sink.sync()

    def sync_behind(self) -> None:
        """Start a `sync` in a thread, so that a slow disk delays no flush; an error is raised by the next call."""
        if self._syncing is not None and not self._syncing.done():
            return
        with self._sink.guarded():
            if self._syncing is not None:
                self._syncing.result()
            self._syncing = self._syncer.submit(self._sink.sync)

    def close(self) -> None:
        """Write the end of the file and close it; after an error of the disk, only close it."""
        self._syncer.shutdown()
        try:
            if not self._sink.failed:
                with self._sink.guarded():
                    if self._syncing is not None:
                        self._syncing.result()  # the kernel tells an error of the disk once
                    self._writer.finish()
                    self._sink.sync()
        finally:
            self._sink.close()

    def _channel(self, topic: str, encoding: str, name: str) -> int:
        schema = self._writer.register_schema(name, encoding, descriptors(name))
        return self._writer.register_channel(topic, encoding, schema)

    def _state(self, stamp_ns: int, number: int, states: States, i: int) -> None:
        self.message(JOINTS, stamp_ns, self._joints(JOINTS, stamp_ns, states.joint_position[i]), number)
        motors = self._class[MOTORS](
            current_ampere=states.motor_current[i].tolist(), temperature_celsius=states.motor_temperature[i].tolist()
        )
        self.message(MOTORS, stamp_ns, motors, number)
        scale = self.meta.newton_per_count
        forces = self._class[FORCES](counts=states.force_counts[i].ravel().tolist(), newton_per_count=scale)
        self.message(FORCES, stamp_ns, forces, number)
        if self.meta.taxels:
            taxels = np.ascontiguousarray(states.taxel_counts[i], dtype="<i2")
            frame = self._class[TAXELS](counts=taxels.tobytes(), shape=taxels.shape, newton_per_count=scale)
            self.message(TAXELS, stamp_ns, frame, number)

    def _joints(self, topic: str, stamp_ns: int, positions: NDArray[np.float64]) -> Any:
        joints = self._class[topic]()
        joints.timestamp.FromNanoseconds(self.unix_ns(stamp_ns))
        for name, position in zip(self.meta.joint_names, positions.tolist(), strict=True):
            joints.joints.add(name=name, position=position)
        return joints

    def _add_bytes(self, topic: str, stamp_ns: int, data: bytes, number: int) -> None:
        time_ns = self.unix_ns(stamp_ns)
        with self._sink.guarded():
            self._writer.add_message(self._channels[topic], time_ns, data, time_ns, number)


def read_log(path: str | Path) -> Log:
    """Return the log at `path`; of a torn one (killed writer) what stands before the tear, with `torn` set.

    Raises
    ------
    DataError
        When there is no such file, it is empty, is no MCAP file or was not written by candata.
    """
    path = Path(path)
    scan = Scan(path)
    messages, metadata, reads = _collect(scan)
    place = Where(path=str(path))
    if META not in metadata:
        raise DataError(
            "the file is no log of candata", expected=f"the metadata record {META!r}", found="none", where=place
        )
    meta = LogMeta.parse(parse_values(metadata[META], place), path)
    try:
        calibration = from_metadata(parse_values(metadata[CALIBRATION], place)) if CALIBRATION in metadata else None
        joints, fingertips = len(meta.joint_names), len(meta.fingertip_names)
        arrays = state_arrays(messages, joints, fingertips, meta.taxels) | target_arrays(messages, joints)
        statistics = tuple(parse_json(data, finite=False) for _, data in messages[STATISTICS].values())
        events = tuple((time_ns, dict(parse_json(data, finite=False))) for time_ns, data in messages[EVENTS].values())
        records = {name: values for name, values in metadata.items() if name.startswith(STREAM)}
        metas = stream_metas({name: parse_values(values, place) for name, values in records.items()}, place)
        streams = tuple(logged_stream(m, messages, reads.get(f"/{m.name}/wire", [])) for m in metas.values())
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DataError("the log does not hold what its metadata says", found=str(error), where=place) from None
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return Log(
        meta=meta,
        calibration=calibration,
        statistics=statistics,
        sha256=sha256,
        torn=not scan.whole,
        damaged_chunks=scan.damaged_chunks,
        read_time_ns=np.array(reads.get(WIRE, []), np.int64),
        streams=streams,
        events=events,
        **arrays,
    )


def _collect(
    scan: Scan,
) -> tuple[dict[str, dict[int, tuple[int, bytes]]], dict[str, Mapping[str, str]], dict[str, list[int]]]:
    """Return the messages by topic and number, the metadata records by name, and when bytes were read by topic."""
    from mcap.records import Channel, Message, Metadata

    topics: dict[int, str] = {}
    messages: dict[str, dict[int, tuple[int, bytes]]] = {
        topic: {} for topic in (JOINTS, TARGETS, FORCES, TAXELS, MOTORS, STATISTICS, EVENTS)
    }
    metadata: dict[str, Mapping[str, str]] = {}
    reads: dict[str, list[int]] = {}
    for record in scan:
        if isinstance(record, Message):
            topic = topics.get(record.channel_id, "")
            if topic.endswith(WIRE):
                reads.setdefault(topic, []).append(record.log_time)
            elif topic:
                topic_messages = messages.setdefault(topic, {})
                topic_messages[record.sequence or len(topic_messages)] = (record.log_time, record.data)
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
    return messages, metadata, reads


def parse_values(values: Mapping[str, str], place: Where) -> dict[str, Any]:
    """Return the values of a metadata record, each of which is JSON.

    Raises
    ------
    DataError
        When one is not.
    """
    try:
        return {name: parse_json(value, finite=False) for name, value in values.items()}
    except ValueError as error:
        raise DataError("a metadata record of the log is not JSON", found=str(error), where=place) from None
