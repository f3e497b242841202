"""Devices: one file each; the folder is the registry."""

from candata.plugins import load, names
from candata.record.devices._contract import Commands, Device, Frame, Framer, States

PACKAGE = "candata.record.devices"

__all__ = ["Commands", "Device", "Frame", "Framer", "States", "device", "device_names"]


def device_names() -> tuple[str, ...]:
    """Return the names of all devices: the files of the folder."""
    return names(PACKAGE)


def device(name: str) -> Device:
    """Return the device called `name`.

    Raises
    ------
    UnknownNameError
        When there is none; lists those there are.
    """
    registered_device: Device = load(PACKAGE, "DEVICE", name)
    return registered_device
