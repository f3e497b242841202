"""Recovery: what can be read of a torn log, as a whole new one beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from candata.datasets.drafts import draft_beside, place, refuse_standing
from candata.datasets.durable import sync
from candata.datasets.writing import refused
from candata.formats._mcap_scan import Scan


@dataclass(frozen=True)
class RecoveredLog:
    """What was saved of a log.

    Attributes
    ----------
    log, out : str
        The original, untouched, and the new file.
    torn : bool
        Whether the original has no end.
    damaged_chunks : int
        Chunks that could not be read.
    messages : dict
        Topic to the number of messages saved.
    duration_s : float
        From the first message saved to the last [s].
    read_bytes, total_bytes : int
        How much of the original was read, and its size.
    """

    log: str
    out: str
    torn: bool
    damaged_chunks: int
    messages: Mapping[str, int]
    duration_s: float
    read_bytes: int
    total_bytes: int


def recover(log: Path, out: Path | None = None) -> RecoveredLog:
    """Write what can be read of `log` as a whole file and return what was saved; any MCAP file will do.

    Parameters
    ----------
    log : Path
        The file; it is only read.
    out : Path, optional
        New file; by default `NAME.recovered.mcap` beside the log.

    Raises
    ------
    DataError
        When there is no such file, or it is empty or no MCAP file.
    UsageError
        When `out` exists.
    SetupError
        When it cannot be written.
    """
    scan = Scan(log)
    out = out or log.with_name(f"{log.stem}.recovered.mcap")
    refuse_standing(out)
    with refused(out, "recovered log", "choose another --out"), draft_beside(out) as folder:
        counts, duration_s = _copy(scan, folder / out.name)
        place(folder / out.name, out)
    size = log.stat().st_size
    return RecoveredLog(str(log), str(out), not scan.whole, scan.damaged_chunks, counts, duration_s, scan.end, size)


def _copy(scan: Scan, draft: Path) -> tuple[dict[str, int], float]:
    """Write every record of the scan that holds data; return messages by topic and the time they span [s]."""
    from mcap.writer import Writer

    counts: dict[str, int] = {}
    first_ns, last_ns = 0, 0
    with draft.open("xb") as file:
        copy = _Copy(Writer(file))
        for record in scan:
            topic = copy.add(record)
            if topic is not None:
                first_ns = min(first_ns, record.log_time) if counts else record.log_time
                last_ns = max(last_ns, record.log_time)
                counts[topic] = counts.get(topic, 0) + 1
        copy.finish()
    sync(draft)
    return counts, (last_ns - first_ns) / 1e9


class _Copy:
    """A writer that is handed the records of another file; numbers of schemas and channels are dealt anew."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, tuple[int, str]] = {}
        self._started = False

    def add(self, record: Any) -> str | None:
        """Write a record if it holds data; return the topic of a message."""
        from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema

        if isinstance(record, Header):
            self._start(record.profile, record.library)
        elif isinstance(record, Schema):
            if record.id not in self._schemas:
                self._schemas[record.id] = self._writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            self._channel(record)
        elif isinstance(record, Message):
            return self._message(record)
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        return None

    def finish(self) -> None:
        """Write the end of the file."""
        if not self._started:
            self._start("", "")
        self._writer.finish()

    def _start(self, profile: str, library: str) -> None:
        self._started = True
        self._writer.start(profile, library)

    def _channel(self, record: Any) -> None:
        if record.id not in self._channels and record.schema_id in self._schemas:
            schema = self._schemas[record.schema_id]
            number = self._writer.register_channel(record.topic, record.message_encoding, schema, record.metadata)
            self._channels[record.id] = (number, record.topic)

    def _message(self, record: Any) -> str | None:
        """Write a message; one whose channel stood in a damaged chunk is left out."""
        channel = self._channels.get(record.channel_id)
        if channel is None:
            return None
        self._writer.add_message(channel[0], record.log_time, record.data, record.publish_time, record.sequence)
        return channel[1]
