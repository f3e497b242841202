"""Every device keeps what all devices must."""

from candata.record.devices import DEVICES, Device, StreamDevice
from candata.testing import DeviceConformance, StreamConformance
from tests.suites import suites

#: What some streams differ in: the values they are given, the resolution of their wire.
STREAMS: dict[str, dict] = {}

globals().update(suites(DeviceConformance, DEVICES, "device", Device))
globals().update(suites(StreamConformance, DEVICES, "device", StreamDevice, **STREAMS))
