"""Streams beside the hand in a log: topics under `/NAME/`, raw bytes and decoded values, one sequence number a frame.

`/NAME/wire` holds the bytes. Joints are `foxglove.JointStates`, poses `foxglove.PoseInFrame`, every other signal is
`candata.Values`; the device's own clock is `candata.DeviceTime`. What a stream is stands in a metadata record
`candata.stream.NAME`, written when it opens and again when a frame first says what it holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from candata.errors import DataError, Where
from candata.formats._mcap_messages import message
from candata.record.addresses import StreamSource
from candata.record.devices import Signal
from candata.schema.record import Record

STREAM = "candata.stream."
_BYTES, _JOINTS, _POSE = "candata.WireBytes", "foxglove.JointStates", "foxglove.PoseInFrame"
_VALUES, _CLOCK = "candata.Values", "candata.DeviceTime"
#: Signals of joints that Foxglove shows under these topics.
_JOINT_TOPICS = {"joint_position": "joint_states", "joint_target": "joint_targets"}


class SignalMeta(Record):
    """A signal of a stream, as in `Signal`."""

    name: str
    shape: tuple[int, ...]
    unit: str
    names: tuple[str, ...] = ()


class StreamMeta(Record):
    """What a log says of a stream: device, address, nominal rate, and its signals once they are known."""

    name: str
    device: str
    link: str
    port: str
    rate_hz: float
    baud: int = 0
    settings: Mapping[str, str] = Field(default_factory=dict)
    signals: tuple[SignalMeta, ...] = ()
    device_time: str | None = None


@dataclass(frozen=True, eq=False)
class LoggedStream:
    """A stream of a log as it was heard: nothing is aligned, resampled or left out.

    Attributes
    ----------
    meta : StreamMeta
        Device, address, signals.
    time_ns : (n,) int64 [unix ns]
        When each frame began to arrive, on the clock of the log.
    values : dict
        Signal to its `(n, *shape)` float64; NaN where a frame lacked it.
    device_time_ns : (n,) int64 [ns] or None
        The device's own clock at each frame, with its own zero; None where it has none. It may step.
    read_time_ns : (k,) int64 [unix ns]
        When bytes were read.
    """

    meta: StreamMeta
    time_ns: NDArray[np.int64]
    values: dict[str, NDArray[np.float64]]
    device_time_ns: NDArray[np.int64] | None
    read_time_ns: NDArray[np.int64]


def stream_meta(source: StreamSource, signals: Sequence[Signal] = ()) -> StreamMeta:
    """Return what a log says of a stream that is to be recorded."""
    address, device = source.address, source.device
    return StreamMeta(
        name=source.name,
        device=source.device_name,
        link=address.link,
        port=address.place,
        baud=address.baud,
        rate_hz=device.rate_hz,
        settings=dict(source.settings),
        signals=tuple(
            SignalMeta(name=s.name, shape=s.shape, unit=s.unit, names=s.names) for s in signals or device.signals
        ),
        device_time=device.device_time,
    )


class TopicWriter(Protocol):
    """What a log's writer offers to its streams."""

    def topic(self, topic: str, message_name: str) -> None:
        """Begin a topic of protobuf messages."""

    def metadata(self, name: str, values: Mapping[str, Any]) -> None:
        """Write a metadata record, each value as JSON."""

    def message(self, topic: str, stamp_ns: int, value: Any, number: int = 0) -> None:
        """Write a message that is stamped with monotonic time."""

    def unix_ns(self, stamp_ns: int) -> int:
        """Return monotonic time as unix time."""


class StreamWriter:
    """Writes one stream into a log; its methods raise SetupError when the disk takes no more."""

    def __init__(self, log: TopicWriter, source: StreamSource) -> None:
        """Write what the stream is, and begin its topics."""
        self._log, self._source, self._frames = log, source, 0
        self._topics: dict[str, tuple[Signal, str]] = {}
        self._wire = f"/{source.name}/wire"
        log.topic(self._wire, _BYTES)
        self._declare(source.device.signals)

    def wire(self, data: bytes, stamp_ns: int) -> None:
        """Write bytes as they were read."""
        self._log.message(self._wire, stamp_ns, message(_BYTES)(data=data))

    def values(self, stamps_ns: Sequence[int], signals: Sequence[Signal], values: Mapping[str, NDArray]) -> None:
        """Write n decoded frames; a frame that first says what it holds completes what the log says of the stream.

        Raises
        ------
        DataError
            When frames hold other signals than those before.
        """
        if not self._topics:
            self._declare(signals)
        expected_signals = tuple(signal for signal, _ in self._topics.values())
        if tuple(signals) != expected_signals:
            raise DataError(
                f"{self._source.name} changed what it sends",
                expected=", ".join(s.name for s in expected_signals),
                found=", ".join(s.name for s in signals),
                fix="record again after a change of the device's signals",
            )
        for row, stamp_ns in enumerate(stamps_ns):
            self._frames += 1
            for topic, (signal, kind) in self._topics.items():
                value = self._value(signal, kind, values[signal.name][row], stamp_ns)
                self._log.message(topic, stamp_ns, value, self._frames)

    def _declare(self, signals: Sequence[Signal]) -> None:
        meta = stream_meta(self._source, signals)
        self._log.metadata(STREAM + meta.name, meta.model_dump(mode="json"))
        for signal in signals:
            topic, kind = topic_of(meta, signal)
            self._log.topic(topic, kind)
            self._topics[topic] = signal, kind

    def _value(self, signal: Signal, kind: str, value: NDArray, stamp_ns: int) -> Any:
        built = message(kind)()
        if kind == _CLOCK:
            built.time_ns = int(value)
        elif kind == _VALUES:
            built.values.extend(value.ravel().tolist())
            built.shape.extend(value.shape)
        else:
            built.timestamp.FromNanoseconds(self._log.unix_ns(stamp_ns))
            if kind == _JOINTS:
                for name, position in zip(signal.names, value.tolist(), strict=True):
                    built.joints.add(name=name, position=position)
            else:
                _fill_pose(built, value.tolist())
        return built


def topic_of(meta: StreamMeta, signal: Signal | SignalMeta) -> tuple[str, str]:
    """Return the topic of a signal and the name of its messages."""
    if signal.name == meta.device_time:
        return f"/{meta.name}/device_time", _CLOCK
    if signal.name in _JOINT_TOPICS and signal.names:
        return f"/{meta.name}/{_JOINT_TOPICS[signal.name]}", _JOINTS
    if signal.name.endswith("_pose") and tuple(signal.shape) == (7,):
        return f"/{meta.name}/{signal.name}", _POSE
    return f"/{meta.name}/{signal.name}", _VALUES


#: Topic to its messages by number: time [ns] and bytes.
Messages = Mapping[str, Mapping[int, tuple[int, bytes]]]


def logged_stream(meta: StreamMeta, messages: Messages, reads: Sequence[int]) -> LoggedStream:
    """Return a stream of a log from the messages of its topics; frames of which a message is missing are left out.

    Raises
    ------
    DataError
        When the messages are not what the log says of the stream.
    """
    topics = {signal.name: (signal, *topic_of(meta, signal)) for signal in meta.signals}
    seen_numbers = [set(messages.get(topic, {})) for _, topic, _ in topics.values()]
    numbers = sorted(set.intersection(*seen_numbers)) if seen_numbers else []
    values: dict[str, NDArray[np.float64]] = {}
    device_time_ns = None
    time_ns = np.zeros(0, np.int64)
    for name, (signal, topic, kind) in topics.items():
        rows = [messages[topic][number] for number in numbers]
        time_ns = np.array([stamp for stamp, _ in rows], np.int64)
        try:
            decoded = [_READ[kind](message(kind).FromString(data)) for _, data in rows]
            shape = (len(rows), *signal.shape)
            if kind == _CLOCK:
                device_time_ns = np.array(decoded, np.int64)
            else:
                values[name] = np.array(decoded, np.float64).reshape(shape)
        except ValueError as error:
            raise DataError(f"{topic} does not hold what the log says of it", found=str(error)) from None
    return LoggedStream(meta, time_ns, values, device_time_ns, np.array(reads, np.int64))


def stream_metas(metadata: Mapping[str, Mapping[str, Any]], place: Where) -> dict[str, StreamMeta]:
    """Return what the metadata records of streams say, by name."""
    metas = [StreamMeta.parse(dict(values), place.path or "") for values in metadata.values()]
    return {meta.name: meta for meta in metas}


def _fill_pose(built: Any, value: Sequence[float]) -> None:
    built.frame_id = "world"
    at, turn = built.pose.position, built.pose.orientation
    at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z = value


def _pose(built: Any) -> list[float]:
    at, turn = built.pose.position, built.pose.orientation
    return [at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z]


_READ: dict[str, Any] = {
    _CLOCK: lambda built: built.time_ns,
    _VALUES: lambda built: list(built.values),
    _JOINTS: lambda built: [joint.position for joint in built.joints],
    _POSE: _pose,
}
