"""Devices: one file each; the folder is the registry."""

from candata.plugins import Registry
from candata.record.devices._contract import Commands, Device, Encoder, Frame, Framer, States
from candata.record.devices._wire import FrameLayout, HeadFramer

DEVICES = Registry("devices", "candata.record.devices", "DEVICE", Device, "summary")

__all__ = [
    "DEVICES",
    "Commands",
    "Device",
    "Encoder",
    "Frame",
    "FrameLayout",
    "Framer",
    "HeadFramer",
    "States",
    "device",
    "device_names",
]


def device_names() -> tuple[str, ...]:
    """Return the names of all devices: the files of the folder, and those of other packages."""
    return DEVICES.names()


def device(name: str) -> Device:
    """Return the device called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    PluginError
        When it comes from another package and cannot be used.
    """
    return DEVICES.load(name)
