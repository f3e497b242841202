"""Damaged recordings: a real bag under mutations, and damage that once gave more than an error of candata's."""

from __future__ import annotations

import contextlib
import random

import numpy as np
import pytest

from candata.errors import CandataError
from tests.formats.made_bags import joints, poses, read, write_ros2
from tests.mutated.mutations import mutated

VICON = "/vicon/Group466CF/Group466CF/pose"


def test_shifted_bytes_that_make_numbers_whose_squares_overflow(tmp_path):
    from mcap.writer import CompressionType

    pose, joint = ("geometry_msgs/msg/PoseStamped", poses(30)), ("sensor_msgs/msg/JointState", joints(30))
    path = tmp_path / "run.mcap"
    write_ros2(path, {"/pose": pose, "/j": joint}, compression=CompressionType.NONE, enable_crcs=False)
    raw = path.read_bytes()
    at = int(0.1875 * len(raw))
    path.write_bytes(raw[:at] + raw[at + 1 :])
    channels = {"object_pose": "/pose", "joint_position": {"topic": "/j", "clock": "log"}}
    with contextlib.suppress(CandataError):
        assert all(len(episode) > 1 for episode in read(path, {"rate_hz": 100, "channels": channels}, allow_gaps=True))


@pytest.mark.parametrize("bag", ["flybag", "yx4bag"])
def test_a_real_bag_is_read_or_refused_and_stays_as_it_is(tmp_path, shared, bag):
    source = shared / "realdata" / "crazyflie_vicon_mcap" / bag / f"{bag}_0.mcap"
    if not source.is_file():
        pytest.skip("no crazyflie bags")
    path, start = tmp_path / "bad.mcap", source.read_bytes()[:120_000]
    for number in range(25):
        bad = mutated(start, [start[60_000:]], random.Random(number))
        path.write_bytes(bad)
        with contextlib.suppress(CandataError):
            for episode in read(path, {"rate_hz": 100, "channels": {"object_pose": VICON}}, allow_gaps=True):
                assert len(episode) > 1
                assert np.isfinite(episode["time_ns"]).all()
        assert path.read_bytes() == bad
