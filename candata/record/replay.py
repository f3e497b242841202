"""A log that is played as if it were a port: its bytes, at the pace at which they were read.

Run as a module it is a reader as `reader.py` is: it passes the bytes of one topic on, with stamps as far apart as the
log's, and ends with the log.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from candata.errors import DataError, Where
from candata.formats._mcap_messages import message
from candata.formats._mcap_scan import Scan
from candata.record import reader
from candata.record.addresses import Address, StreamSource
from candata.record.devices import Device, hand, stream
from candata.record.log_messages import WIRE
from candata.record.log_streams import STREAM, StreamMeta, stream_metas
from candata.record.logs import META, LogMeta, parse_values
from candata.schema.json_text import parse_json

#: What `--device` calls it.
REPLAY = "replay"
#: Playing begins so long after the log was looked at [s]: the readers of all its streams need that to start.
START_S = 2.0


@dataclass(frozen=True)
class HandSource:
    """A hand to record.

    Attributes
    ----------
    name : str
        Registered name of its device.
    device : Device
        Its contract.
    port : str or Address
        Serial port, or the address of a log that is played.
    settings : dict
        Values of the log's metadata that replace the device's own.
    streams : tuple of StreamSource
        What a played log holds beside the hand.
    """

    name: str
    device: Device
    port: str | Address
    settings: dict[str, Any] = field(default_factory=dict)
    streams: tuple[StreamSource, ...] = ()


def hand_source(device_name: str, port: str) -> HandSource:
    """Return the hand that a device's name and a port mean; of `replay`, that of the log on the `port`.

    Raises
    ------
    DataError
        When the log to play is none of candata, or holds no bytes of a hand.
    UsageError
        When the device is no hand.
    UnknownNameError
        When a device is not registered here.
    """
    if device_name != REPLAY:
        return HandSource(device_name, hand(device_name), port)
    path = Path(port)
    metadata: dict[str, dict[str, Any]] = {}
    place = Where(path=str(path))
    for record in Scan(path):
        if type(record).__name__ == "Metadata":
            metadata[record.name] = parse_values(record.metadata, place)
        elif type(record).__name__ == "Message":
            break
    if META not in metadata:
        raise DataError(
            "the file is no log of candata", expected=f"the metadata record {META!r}", found="none", where=place
        )
    if next(wire_reads(path, WIRE), None) is None:
        raise DataError("the log holds no bytes to play", expected=f"messages of {WIRE}", where=place)
    meta = LogMeta.parse(metadata[META], path)
    settings = {"newton_per_count": meta.newton_per_count, "rate_hz": meta.rate_hz, "baud": meta.baud}
    start_ns = time.monotonic_ns() + round(1e9 * START_S)
    records = {name: values for name, values in metadata.items() if name.startswith(STREAM)}
    streams = tuple(_source(path, start_ns, stream_meta) for stream_meta in stream_metas(records, place).values())
    address = Address("log", str(path), meta.baud, WIRE, start_ns)
    return HandSource(meta.device, hand(meta.device), address, settings, streams)


def _source(path: Path, start_ns: int, meta: StreamMeta) -> StreamSource:
    """Return a stream of a log as a stream to record."""
    device = stream(meta.device)
    if meta.settings and device.configured:
        device = device.configured(meta.settings)
    address = Address("log", str(path), meta.baud, f"/{meta.name}{WIRE}", start_ns)
    return StreamSource(meta.name, meta.device, replace(device, rate_hz=meta.rate_hz), address, meta.settings)


def wire_reads(path: Path, topic: str) -> Iterator[tuple[int, bytes]]:
    """Yield what was read: time since the first bytes of the log, of whatever topic, [ns], and bytes of `topic`."""
    from mcap.records import Channel, Message

    topics: dict[int, str] = {}
    first_ns: int | None = None
    parse = message("candata.WireBytes").FromString
    for record in Scan(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and topics.get(record.channel_id, "").endswith(WIRE):
            first_ns = record.log_time if first_ns is None else first_ns
            if topics[record.channel_id] == topic:
                yield record.log_time - first_ns, parse(record.data).data


def main(arguments: list[str]) -> int:
    """Play the topic of `{"port", "topic", "start_ns"}` to standard output; return an exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    settings = parse_json(arguments[1].encode(), finite=True)
    outlet = reader.Outlet(sys.stdout.fileno())
    try:
        outlet.tell(reader.EVENT_OPENED, note=None)
        for after_ns, data in wire_reads(Path(settings["port"]), settings["topic"]):
            stamp_ns = settings["start_ns"] + after_ns
            time.sleep(max(0, stamp_ns - time.monotonic_ns()) * 1e-9)
            outlet.put(reader.DATA, stamp_ns, data)
        outlet.finish()
    except BrokenPipeError:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
