"""Recordings in MCAP files: which files are one, what topics they hold, and the readings that are asked for."""

from __future__ import annotations

import dataclasses
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from candata.errors import DataError, UsageError, Where
from candata.formats._mcap_decode import decode_message, decoder, type_name
from candata.formats._mcap_fields import LATEST_NS, Extract
from candata.formats._mcap_fields import Reading as Values
from candata.formats._mcap_scan import MAGIC, Scan
from candata.lfs import refuse_pointer
from candata.schema.yaml_text import read_yaml

METADATA = "metadata.yaml"
#: First bytes of other files that bags come in, what they are, and what to do.
_FOREIGN_MAGICS = (
    (b"SQLite", "a bag of kind sqlite3", "convert it: `ros2 bag convert` with storage_id mcap"),
    (b"#ROSBAG", "a bag of ROS 1", "convert it: `mcap convert`"),
    (b"\x28\xb5\x2f\xfd", "a file packed by zstd", "unpack it: `zstd -d`, and correct its name in metadata.yaml"),
)


@dataclass(frozen=True)
class Recording:
    """One recording: its name, and its files in order."""

    name: str
    files: tuple[Path, ...]

    @property
    def where(self) -> Where:
        """Place for messages: the file, or the folder of several."""
        return Where(path=str(self.files[0] if len(self.files) == 1 else self.files[0].parent))


@dataclass
class Topic:
    """What a recording holds of a topic: type, encoding, messages; with samples, log times [ns] and a first message."""

    kind: str
    encoding: str
    count: int = 0
    sample: Any = None
    logged_ns: array[int] = field(default_factory=lambda: array("q"))

    @property
    def rate_hz(self) -> float:
        """Messages a second by the middle step, which no pause changes; by the mean where most come in bursts."""
        if len(self.logged_ns) < 2:
            return 0.0
        times = np.sort(np.asarray(self.logged_ns))
        step = float(np.median(np.diff(times))) or float(times[-1] - times[0]) / (len(times) - 1)
        return 1e9 / step if step > 0 else 0.0


@dataclass(frozen=True)
class TopicRow:
    """One reading with its three times [ns] (-1: no stamp), the names beside its values, and its message's number."""

    header_ns: int
    log_ns: int
    publish_ns: int
    names: tuple[str, ...]
    values: tuple[float, ...]
    index: int


@dataclass
class Bag:
    """What was read: topics, the rows of each wanted reading, and what is wrong with the files, in words."""

    topics: dict[str, Topic] = field(default_factory=dict)
    rows: list[list[TopicRow]] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class TopicRequest:
    """A topic, and what makes its extractor once the type is known."""

    topic: str
    make: Callable[[str], Extract]


def recordings(source: Path) -> tuple[Recording, ...]:
    """Return the recordings in a source.

    A file is one. A folder with a `metadata.yaml` is one, with the files that it names. In another folder, each `.mcap`
    file and each such folder is one.

    Raises
    ------
    DataError
        When there is none, a file is missing, empty or no MCAP file.
    """
    location = Where(path=str(source))
    if source.is_file():
        result = [Recording(source.stem, (source,))]
    elif (source / METADATA).is_file():
        result = [Recording(source.resolve().name, _bag_files(source))]
    elif source.is_dir():
        files = [Recording(path.stem, (path,)) for path in sorted(source.glob("*.mcap"))]
        bags = sorted(path.parent for path in source.glob(f"*/{METADATA}"))
        result = files + [Recording(bag.name, _bag_files(bag)) for bag in bags]
    else:
        raise DataError("no such recording", expected="a .mcap file or a bag's folder", where=location)
    if not result:
        raise DataError("the folder holds no recording", expected=".mcap files, or folders of bags", where=location)
    for recording in result:
        for path in recording.files:
            _require_mcap(path)
    return tuple(result)


def _bag_files(folder: Path) -> tuple[Path, ...]:
    """Return the files that a bag's `metadata.yaml` names."""
    path = folder / METADATA
    try:
        value = read_yaml(path)
        names = value["rosbag2_bagfile_information"]["relative_file_paths"]
        names = [Path(name).name for name in names]
    except (LookupError, TypeError, ValueError, UsageError) as error:
        raise DataError(
            "the bag's metadata.yaml cannot be read",
            expected="rosbag2_bagfile_information: relative_file_paths",
            found=f"{type(error).__name__}: {error}".splitlines()[0],
            where=Where(path=str(path)),
            fix="give the .mcap file itself",
        ) from None
    if not names:
        raise DataError("the bag's metadata.yaml names no file", where=Where(path=str(path)))
    return tuple(folder / name for name in names)


def _require_mcap(path: Path) -> None:
    """Refuse what is no MCAP file."""
    refuse_pointer(path)
    location = Where(path=str(path))
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
    except (OSError, ValueError) as error:
        description = getattr(error, "strerror", None) or str(error)
        raise DataError("the recording cannot be read", found=description, where=location) from None
    if head == MAGIC:
        return
    description, fix = next(
        ((words, fix) for start, words, fix in _FOREIGN_MAGICS if head.startswith(start)), (repr(head), None)
    )
    raise DataError(
        "the file is no MCAP file" if head else "the file is empty",
        expected="a file that begins with the MCAP magic",
        found=description,
        where=location,
        fix=fix,
    )


def read_bag(recording: Recording, requests: Sequence[TopicRequest] = (), samples: bool = False) -> Bag:
    """Return what a recording holds: counts of all topics, and the rows of the wanted ones in the order of log time.

    With `samples` the first message of each topic is kept, decoded, where it can be.

    Raises
    ------
    DataError
        When a wanted topic's message cannot be decoded, or lacks a field.
    UsageError
        When the map does not say what to take from a type.
    """
    bag = Bag(rows=[[] for _ in requests])
    for path in recording.files:
        _read_file(path, bag, requests, samples)
    for rows in bag.rows:
        rows.sort(key=lambda row: row.log_ns)
    return bag


class _File:
    """The channels of one file while it is read."""

    def __init__(self, path: Path, bag: Bag, requests: Sequence[TopicRequest], samples: bool) -> None:
        self.where, self.bag, self.samples = Where(path=str(path)), bag, samples
        self.requests = requests
        self.schemas: dict[int, Any] = {}
        self.channels: dict[int, Any] = {}
        self.takers: dict[int, tuple[Callable[[bytes], Any] | None, list[tuple[int, Extract]]]] = {}
        self.orphans = self.read = 0

    def channel(self, channel: Any) -> None:
        """Take note of a channel; the same topic must be of one type."""
        schema = self.schemas.get(channel.schema_id)
        kind = type_name(schema.name) if schema is not None else ""
        topic = self.bag.topics.setdefault(channel.topic, Topic(kind, channel.message_encoding))
        if topic.kind != kind:
            raise DataError(
                f"{channel.topic} is of two types", expected=topic.kind or "no type", found=kind, where=self.where
            )
        self.channels[channel.id] = channel

    def message(self, message: Any) -> None:
        """Count a message, and take from it what is wanted."""
        channel = self.channels.get(message.channel_id)
        if channel is None or max(message.log_time, message.publish_time) >= LATEST_NS:
            self.orphans += 1
            return
        self.read += 1
        topic = self.bag.topics[channel.topic]
        if self.samples:
            topic.logged_ns.append(message.log_time)
        if channel.id not in self.takers:
            self.takers[channel.id] = self._taker(channel, topic)
        decode, takers = self.takers[channel.id]
        if decode is not None and (takers or (self.samples and topic.sample is None)):
            self._take(message, decode, takers, channel.topic, topic)
        topic.count += 1

    def _taker(self, channel: Any, topic: Topic) -> tuple[Callable[[bytes], Any] | None, list[tuple[int, Extract]]]:
        """Return the decoder of a channel and what is taken from its messages."""
        extractors = [(k, w.make(topic.kind)) for k, w in enumerate(self.requests) if w.topic == channel.topic]
        if not extractors and not self.samples:
            return None, []
        try:
            schema = self.schemas.get(channel.schema_id)
            return decoder(channel.topic, channel.message_encoding, schema, self.where), extractors
        except DataError:
            if extractors:
                raise
            return None, []

    def _take(self, message: Any, decode: Callable, takers: list, name: str, topic: Topic) -> None:
        """Decode a message and keep its readings."""
        index = topic.count
        try:
            value = decode_message(decode, message.data, name, index, self.where)
        except DataError:
            if takers:
                raise
            return
        topic.sample = value if topic.sample is None else topic.sample
        for k, take in takers:
            for header_ns, names, values in _located_readings(take, value, name, index):
                row = TopicRow(header_ns, message.log_time, message.publish_time, names, values, index)
                self.bag.rows[k].append(row)


def _located_readings(take: Extract, value: Any, topic: str, index: int) -> list[Values]:
    """Return the readings of a message; what is wrong with it is said with topic and number."""
    try:
        return take(value)
    except DataError as error:
        location = dataclasses.replace(error.where, channel=topic, index=index)
        facts = {"expected": error.expected, "found": error.found, "fix": error.fix}
        raise DataError(error.problem, where=location, **facts) from None


def _read_file(path: Path, bag: Bag, requests: Sequence[TopicRequest], samples: bool) -> None:
    """Read one file into the bag."""
    from mcap.records import Channel, Message, Schema, Statistics

    file, scan = _File(path, bag, requests, samples), Scan(path)
    claimed_count: int | None = None
    for record in scan:
        if isinstance(record, Message):
            file.message(record)
        elif isinstance(record, Schema):
            file.schemas[record.id] = record
        elif isinstance(record, Channel):
            file.channel(record)
        elif isinstance(record, Statistics):
            claimed_count = record.message_count
    bag.damage += _damage(path, scan, file.orphans, file.read, claimed_count)


def _damage(path: Path, scan: Scan, orphans: int, read_count: int, claimed_count: int | None) -> Iterator[str]:
    """Yield what is wrong with a file."""
    if not scan.whole:
        yield f"{path.name} has no end: it is cut, or its writer was killed; whole records end at byte {scan.end}"
    if scan.damaged_chunks:
        yield f"{path.name}: {scan.damaged_chunks} damaged chunks"
    if orphans:
        yield f"{path.name}: {orphans} messages of no known topic, or of no possible time"
    if claimed_count is not None and claimed_count != read_count + orphans and not scan.damaged_chunks:
        yield f"{path.name}: {read_count} messages where its statistics say {claimed_count}"


def metadata(path: Path, name: str) -> Mapping[str, str] | None:
    """Return the metadata record `name` that stands before the messages of a file, None where there is none."""
    from mcap.records import Header, Message, Metadata

    for record in Scan(path):
        if isinstance(record, Metadata) and record.name == name:
            return record.metadata
        if isinstance(record, Message) or not isinstance(record, Header | Metadata):
            return None
    return None
