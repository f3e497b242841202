"""Devices: one file each; the folder is the registry."""

from candata.errors import UsageError
from candata.plugins import Registry
from candata.record.devices._contract import (
    AnyDevice,
    Commands,
    Device,
    Encoder,
    Frame,
    Framer,
    Link,
    Signal,
    States,
    StreamDevice,
)
from candata.record.devices._wire import FrameLayout, HeadFramer

DEVICES = Registry("devices", "candata.record.devices", "DEVICE", AnyDevice, "summary")

__all__ = [
    "DEVICES",
    "AnyDevice",
    "Commands",
    "Device",
    "Encoder",
    "Frame",
    "FrameLayout",
    "Framer",
    "HeadFramer",
    "Link",
    "Signal",
    "States",
    "StreamDevice",
    "device",
    "device_names",
    "hand",
    "stream",
]


def device_names() -> tuple[str, ...]:
    """Return the names of all devices: the files of the folder, and those of other packages."""
    return DEVICES.names()


def device(name: str) -> AnyDevice:
    """Return the device called `name`, a hand or a stream.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    PluginError
        When it comes from another package and cannot be used.
    """
    return DEVICES.load(name)


def hand(name: str) -> Device:
    """Return the hand called `name`.

    Raises
    ------
    UsageError
        When that device is a stream; else as `device`.
    """
    known = device(name)
    if isinstance(known, Device):
        return known
    raise UsageError(f"{name!r} is no hand", found=known.summary, fix=f"record it with --stream {name}={name}@ADDRESS")


def stream(name: str) -> StreamDevice:
    """Return the stream device called `name`.

    Raises
    ------
    UsageError
        When that device is a hand; else as `device`.
    """
    known = device(name)
    if isinstance(known, StreamDevice):
        return known
    raise UsageError(f"{name!r} is a hand, not a stream", found=known.summary, fix=f"record it with --device {name}")
