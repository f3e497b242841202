"""Every device keeps what all devices must."""

import numpy as np

from candata.record.devices import DEVICES, Device, StreamDevice
from candata.testing import DeviceConformance, StreamConformance
from tests.suites import suites

POSE = (0.4, -0.1, 0.02, 0.96, 0.0, 0.0, 0.28)

#: What some streams differ in: the values they are given, the resolution of their wire.
STREAMS: dict[str, dict] = {
    "ft300": {"step": 0.0051},  # half a count of 0.01 N
    "cobs": {"values": {"joint_position": np.linspace(-1, 1, 24 * 3).reshape(24, 3)}},
    "pose_lines": {"values": {"device_time": 66_000_000 * np.arange(24), "object_pose": np.tile(POSE, (24, 1))}},
}

globals().update(suites(DeviceConformance, DEVICES, "device", Device))
globals().update(suites(StreamConformance, DEVICES, "device", StreamDevice, **STREAMS))
