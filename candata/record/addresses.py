"""Where a device is heard: a serial port, a TCP server, a UDP socket, or a log that is played again."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal
from urllib.parse import parse_qsl

from candata.errors import UsageError
from candata.record.devices import Link, StreamDevice, stream

#: Names of streams begin the topics of a log; these stand for the hand and for the recorder itself.
RESERVED_NAMES = ("hand", "wire", "statistics", "events")
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_HOST_PORT = re.compile(r"(?P<host>\[[0-9a-fA-F:.]+\]|[^:/\[\]\s]+)(?::(?P<port>[0-9]+))?")


@dataclass(frozen=True)
class Address:
    """Where bytes come from.

    Attributes
    ----------
    link : str
        `serial`, `tcp`, `udp`, or `log`.
    place : str
        Serial port; HOST:PORT of a server to connect to, or of this machine's socket to bind; path of a log.
    baud : int
        Bits a second of a serial port; else 0.
    topic : str
        Topic of a log that holds the bytes.
    start_ns : int
        When the first bytes of a log are played, on the monotonic clock [ns].
    """

    link: Link | Literal["log"]
    place: str
    baud: int = 0
    topic: str = ""
    start_ns: int = 0

    @property
    def host(self) -> str:
        """Host of a network address, without brackets."""
        return self.place.rpartition(":")[0].strip("[]")

    @property
    def number(self) -> int:
        """Port number of a network address."""
        return int(self.place.rpartition(":")[2])

    def __str__(self) -> str:
        """Return it as a user types it."""
        if self.link == "log":
            return f"{self.topic} of {self.place}"
        return self.place if self.link == "serial" else f"{self.link}://{self.place}"


@dataclass(frozen=True)
class StreamSource:
    """A stream to record: its name in the log, the device's registered name and contract, its address.

    `settings` are those that stood behind the address; `device` is under them already.
    """

    name: str
    device_name: str
    device: StreamDevice
    address: Address
    settings: Mapping[str, Any] = field(default_factory=dict)


def parse_stream(text: str) -> StreamSource:
    """Return the stream that `NAME=DEVICE` or `NAME=DEVICE@ADDRESS` names.

    ADDRESS is a serial port or `tcp://HOST:PORT`, `udp://HOST:PORT`, or HOST[:PORT] for a device of the network;
    `?setting=value&setting=value` may stand behind it, and `baud` is a setting of every serial device.

    Raises
    ------
    UsageError
        When it is written otherwise, or the device is a hand or lacks a setting.
    UnknownNameError
        When there is no such device.
    """
    name, equals, rest = text.partition("=")
    device_name, _, place = rest.partition("@")
    if not equals or not device_name:
        raise UsageError("--stream says no device", expected="NAME=DEVICE@ADDRESS", found=text)
    if not _NAME.fullmatch(name) or name in RESERVED_NAMES:
        raise UsageError(
            f"{name!r} is no name for a stream",
            expected=f"letters a-z, digits and _, not {', '.join(RESERVED_NAMES)}",
            found=text,
        )
    return stream_source(name, device_name, place)


def stream_source(name: str, device_name: str, place: str) -> StreamSource:
    """Return the stream of a device at an address as it is typed, empty for the device's own; raises as `parse_stream`.

    Raises
    ------
    UsageError, UnknownNameError
        As `parse_stream`.
    """
    device = stream(device_name)
    place, _, query = place.partition("?")
    settings = dict(parse_qsl(query, keep_blank_values=True))
    baud = settings.pop("baud", None) if device.baud else None
    if settings and device.configured is None:
        raise UsageError(f"{device_name} has no settings", found=query, fix="leave out what stands behind the ?")
    configured = device.configured(settings) if settings and device.configured else device
    address = _address(device_name, configured, place)
    if address.link == "serial":
        address = Address("serial", address.place, _baud(baud) if baud is not None else configured.baud)
    return StreamSource(name, device_name, configured, address, settings)


def require_distinct(sources: Sequence[StreamSource]) -> None:
    """Refuse streams that share a name or an address.

    Raises
    ------
    UsageError
        Names both.
    """
    for number, source in enumerate(sources):
        for other in sources[:number]:
            if source.name == other.name:
                raise UsageError(f"two streams are called {source.name}", fix="give them names: --stream NAME=DEVICE")
            if str(source.address) == str(other.address):
                raise UsageError(
                    "two streams have one address", found=f"{other.name} and {source.name}: {source.address}"
                )


def _baud(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise UsageError("a baud rate is a whole number above zero", found=text)
    return int(text)


def _address(device_name: str, device: StreamDevice, place: str) -> Address:
    """Return the address of a device: its own link unless the text says another one of the network."""
    scheme, marks, rest = place.partition("://")
    link, place = (scheme, rest) if marks else (device.link, place)
    if not place and not device.port:
        raise UsageError(f"{device_name} has no address of its own", fix=f"give one: NAME={device_name}@ADDRESS")
    if link not in ("serial", "tcp", "udp") or (link == "serial") != (device.link == "serial"):
        expected = "a serial port" if device.link == "serial" else "tcp://HOST:PORT or udp://HOST:PORT"
        raise UsageError(f"{device_name} is not heard so", expected=expected, found=f"{scheme}://{rest}")
    if link == "serial":
        return Address("serial", place or device.port)
    return Address("tcp" if link == "tcp" else "udp", _host_and_port(place or device.port, device.port))


def _host_and_port(text: str, default: str) -> str:
    """Return HOST:PORT with the device's own port where none is given."""
    match = _HOST_PORT.fullmatch(text)
    number = (match["port"] or default.rpartition(":")[2]) if match else ""
    if not match or not number.isdecimal() or not 0 < int(number) < 65536:
        raise UsageError("not an address of the network", expected="HOST:PORT, PORT from 1 to 65535", found=text)
    return f"{match['host']}:{int(number)}"
