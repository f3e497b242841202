"""Cuts and flipped bits of recordings: only the project's own errors come out, and the source stays as it is."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from candata.errors import CandataError
from candata.formats import Reading, Writing
from candata.plugins import load
from tests.conftest import make_episode
from tests.formats.made_bags import POSE_MAP, fox_pose, joints, poses, read, write_foxglove, write_ros2

MCAP, FRAMES = (load("candata.formats", "FORMAT", name) for name in ("mcap", "foundationpose"))
VICON = "/vicon/Group466CF/Group466CF/pose"
JOINTS = {"topic": "/j", "clock": "log"}
#: The files are made once a test; each example writes its own damaged copy over the last.
FUZZ = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])

damages = st.one_of(
    st.tuples(st.just("cut"), st.floats(0, 1), st.just(0)),
    st.tuples(st.just("flip"), st.floats(0, 1, exclude_max=True), st.integers(1, 255)),
    st.tuples(st.just("zero"), st.floats(0, 1, exclude_max=True), st.integers(1, 64)),
    st.tuples(st.just("drop"), st.floats(0, 1, exclude_max=True), st.integers(1, 64)),
)


def damaged(raw: bytes, damage: tuple[str, float, int]) -> bytes:
    kind, share, size = damage
    at = int(share * len(raw))
    if kind == "cut":
        return raw[:at]
    if kind == "flip":
        return raw[:at] + bytes([raw[at] ^ size]) + raw[at + 1 :]
    return raw[:at] + bytes(size if kind == "zero" else 0) + raw[at + size :]


def refused_or_whole(path, mapping, allow_gaps: bool) -> None:
    """Read a damaged file: it gives sound episodes, or one of the project's errors; its bytes stay."""
    before = path.read_bytes()
    with contextlib.suppress(CandataError):
        for episode in read(path, mapping, allow_gaps=allow_gaps):
            assert len(episode) > 1
            assert np.isfinite(episode["time_ns"]).all()
    assert path.read_bytes() == before


@pytest.fixture
def ros2(tmp_path):
    """A bag as rosbag2 writes it: neither compressed nor with check sums, so that damage reaches the messages."""
    from mcap.writer import CompressionType

    topics = {
        "/pose": ("geometry_msgs/msg/PoseStamped", poses(30)),
        "/j": ("sensor_msgs/msg/JointState", joints(30)),
    }
    path = tmp_path / "run.mcap"
    return write_ros2(path, topics, compression=CompressionType.NONE, enable_crcs=False).read_bytes()


@FUZZ
@given(damage=damages, allow_gaps=st.booleans())
@example(damage=("cut", 0.0, 0), allow_gaps=True)
@example(damage=("drop", 0.1875, 1), allow_gaps=True)  # shifted bytes make numbers whose squares overflow
def test_a_damaged_bag(tmp_path, ros2, damage, allow_gaps):
    path = tmp_path / "bad.mcap"
    path.write_bytes(damaged(ros2, damage))
    mapping = {"rate_hz": 100, "channels": {"object_pose": "/pose", "joint_position": JOINTS}}
    refused_or_whole(path, mapping, allow_gaps)


@FUZZ
@given(damage=damages)
def test_a_damaged_bag_without_a_map(tmp_path, ros2, damage):
    path = tmp_path / "bad.mcap"
    path.write_bytes(damaged(ros2, damage))
    with pytest.raises(CandataError):
        read(path)


@FUZZ
@given(damage=damages, encoding=st.sampled_from(["protobuf", "json"]))
def test_a_damaged_foxglove_file(tmp_path, damage, encoding):
    items = [fox_pose(10**9 + k * 10**7, float(k)) for k in range(20)]
    if encoding == "json":
        pose = {"position": {"x": 1, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
        items = [(t, {"timestamp": {"sec": 1, "nsec": t - 10**9}, "pose": pose}) for t, _ in items]
    path = write_foxglove(tmp_path / "bad.mcap", {"/pose": ("foxglove.PoseInFrame", items)}, encoding)
    path.write_bytes(damaged(path.read_bytes(), damage))
    refused_or_whole(path, POSE_MAP, True)


@FUZZ
@given(damage=damages)
def test_a_damaged_export_is_restored_whole_or_refused(tmp_path, damage):
    folder = tmp_path / "out"
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    made = make_episode("run", rows=8)
    MCAP.write(iter([made]), folder, Writing("ds", "d" * 64))
    (path,) = folder.iterdir()
    path.write_bytes(damaged(path.read_bytes(), damage))
    try:
        (again,) = read(path)
    except CandataError:
        return
    assert again.meta == made.meta
    assert all((again[name] == made[name]).all() for name in made.arrays)


@FUZZ
@given(damage=damages)
def test_a_damaged_map(tmp_path, ros2, damage):
    (tmp_path / "run.mcap").write_bytes(ros2)
    text = (
        b"rate_hz: 100\nchannels:\n  object_pose: {topic: /pose, fields: ['pose.position.x', 'pose.orientation.w']}\n"
    )
    path = tmp_path / "map.yaml"
    path.write_bytes(damaged(text, damage))
    with pytest.raises(CandataError):
        list(MCAP.read(tmp_path / "run.mcap", Reading(mapping=path)))


@settings(FUZZ, max_examples=25)
@given(damage=damages, bag=st.sampled_from(["flybag", "yx4bag"]))
def test_a_damaged_real_bag(tmp_path, shared, damage, bag):
    source = shared / "realdata" / "crazyflie_vicon_mcap" / bag / f"{bag}_0.mcap"
    if not source.is_file():
        pytest.skip("no crazyflie bags")
    path = tmp_path / "bad.mcap"
    path.write_bytes(damaged(source.read_bytes()[:120_000], damage))
    refused_or_whole(path, {"rate_hz": 100, "channels": {"object_pose": VICON}}, True)


@FUZZ
@given(damage=damages, text=st.binary(max_size=60))
def test_a_damaged_frame(tmp_path, damage, text):
    folder = tmp_path / "s"
    (folder / "ob_in_cam").mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / "ob_in_cam" / "0.txt", np.eye(4))
    path = folder / "ob_in_cam" / "1.txt"
    np.savetxt(path, np.eye(4))
    path.write_bytes(damaged(path.read_bytes(), damage) if len(text) % 2 else text)
    (tmp_path / "frames.yaml").write_text("rate_hz: 30\n")
    try:
        (episode,) = FRAMES.read(folder, Reading(mapping=tmp_path / "frames.yaml", allow_gaps=True))
    except CandataError:
        return
    assert len(episode) == 2
