"""Every device keeps what all devices must."""

from candata.record.devices import DEVICES
from candata.testing import DeviceConformance
from tests.suites import suites

globals().update(suites(DeviceConformance, DEVICES, "device"))
