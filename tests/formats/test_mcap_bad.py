"""Recordings and maps that are wrong: one clear error each."""

from __future__ import annotations

import struct

import pytest
import yaml

from candata.errors import CandataError, DataError, UnknownNameError, UsageError
from candata.formats import Reading
from candata.plugins import load
from tests.formats.made_bags import (
    POSE_MAP,
    POSE_TOPIC,
    START,
    STEP,
    joints,
    pose,
    poses,
    read,
    stamp,
    write_bag,
    write_ros2,
)

POSES, JOINTS = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/JointState"
FORMAT = load("candata.formats", "FORMAT", "mcap")
BARE = "geometry_msgs/msg/Pose"


def channels(**given):
    return {"rate_hz": 100, "channels": given}


def bare(count: int = 50) -> list:
    return [(START + k * STEP, pose(float(k))) for k in range(count)]


@pytest.mark.parametrize(
    ("mapping", "kind", "words"),
    [
        (channels(object_poses="/pose"), UnknownNameError, "did you mean 'object_pose'"),
        (channels(hand_pose="/pose"), UsageError, "one of object_pose, joint_position"),
        (channels(object_pose=["/pose", "/pose"]), UsageError, "needs one topic"),
        (channels(object_pose={"topic": "/pose", "joints": ["a"]}), UsageError, "has no joints"),
        (channels(object_pose={"topic": "/pose", "unit": "deg"}), UsageError, "cannot be in deg"),
        (channels(object_pose={"topic": "/pose", "unit": "metre"}), UnknownNameError, "unknown unit"),
        (channels(object_pose={"topic": "/pose", "clock": "wall"}), UsageError, r"object_pose\.clock"),
        (channels(object_pose={"topic": "/pose", "role": "speed"}), UsageError, "role"),
        (channels(object_pose={"topic": "/pose", "fields": ["pose..x"]}), UsageError, "no field path"),
        (channels(object_pose={"topic": "/pose", "fields": ["__class__"]}), UsageError, "no field path"),
        (channels(object_pose={"topic": "/pose", "fields": ["pose.positon.x"]}), DataError, "did you mean 'position'"),
        (channels(object_pose={"topic": "/pose", "fields": ["pose.position"]}), DataError, "does not hold numbers"),
        (channels(object_pose={"topic": "/pose", "fields": ["header.stamp.sec[0]"]}), DataError, "no such element"),
        (channels(object_pose={"topic": "/pose", "fields": ["pose.position.x"]}), DataError, "does not fit"),
        (channels(joint_position="/pose"), UsageError, "nothing says which fields"),
        (channels(object_pose="/pose") | {"rate_hz": 0}, UsageError, "rate_hz"),
        (channels(object_pose="/pose") | {"reference": "action"}, UnknownNameError, "reference channel"),
        (channels(object_pose="/pose") | {"rate": 100}, UsageError, "rate"),
        (channels(object_pose="/empty"), DataError, "topic /empty is empty"),
        (channels(object_pose="/bare"), DataError, "no header stamps"),
        (channels(object_pose="/pose", joint_position={"topic": "/j", "joints": ["a", "z"]}), DataError, "lacks"),
        (channels(object_pose="/pose", joint_position={"topic": "/j", "joints": ["q"]}), DataError, "holds nothing"),
        (channels(object_pose="/pose", joint_effort="/j"), DataError, "gives no effort"),
        (
            channels(joint_position="/j", joint_velocity={"topic": "/j", "joints": ["a"], "fields": ["position"]}),
            UsageError,
            "the joints differ",
        ),
        (channels(object_pose="/pose") | {"episodes": {"marker": "/none"}}, UnknownNameError, "unknown topic"),
        (channels(object_pose="/pose") | {"episodes": {"marker": "/bare", "ranges_s": [[0, 1]]}}, UsageError, "both"),
        ([], UsageError, "topics.yaml"),
    ],
)
def test_a_wrong_map_is_refused(tmp_path, mapping, kind, words):
    topics = POSE_TOPIC | {"/bare": (BARE, bare()), "/j": (JOINTS, joints())}
    bag = write_ros2(tmp_path / "run.mcap", topics)
    _with_empty_topic(bag, topics)
    path = tmp_path / "topics.yaml"
    path.write_text(yaml.safe_dump(mapping))
    with pytest.raises(kind, match=words):
        list(FORMAT.read(bag, Reading(mapping=path)))


def _with_empty_topic(bag, topics):
    """Register a topic in the file that has no message."""
    from unittest import mock

    from mcap_ros2.writer import Writer

    finish = Writer.finish

    def finish_with_empty(self):
        self._writer.register_channel("/empty", "cdr", 1)
        finish(self)

    with mock.patch.object(Writer, "finish", finish_with_empty):
        write_ros2(bag, topics)


def test_maps_that_are_no_maps(tmp_path):
    bag = write_ros2(tmp_path / "run.mcap", POSE_TOPIC)
    path = tmp_path / "t.yaml"
    for text in (b"\xff\xfe\x00", b"a: [", b"[" * 5000, b""):
        path.write_bytes(text)
        with pytest.raises(UsageError):
            list(FORMAT.read(bag, Reading(mapping=path)))
    with pytest.raises(UsageError, match="cannot be read"):
        list(FORMAT.read(bag, Reading(mapping=tmp_path / "none.yaml")))


def test_stamps_that_run_back_are_refused_by_their_number(tmp_path):
    messages = poses()
    messages[9][1]["header"]["stamp"] = stamp(START)
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, messages)})
    with pytest.raises(DataError, match="run back") as caught:
        read(bag, POSE_MAP)
    assert caught.value.where.index == 9
    assert len(read(bag, POSE_MAP | {"clock": "log"})) == 1


def test_repeated_messages_are_told_and_the_last_counts(tmp_path):
    messages = poses()
    messages.insert(5, (messages[4][0], {"header": {"stamp": stamp(START + 4 * STEP)}, "pose": pose(-1.0)}))
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, messages)})
    notes: list[str] = []
    (episode,) = read(bag, POSE_MAP, note=notes.append)
    assert episode["object_pose"][4, 0] == -1.0
    assert notes == ["/pose: 1 repeated stamps; of equal ones the last message counts"]


@pytest.mark.parametrize("zero", [True, False])
def test_stamps_never_filled_in_are_no_stamps(tmp_path, zero):
    value = stamp(0) if zero else stamp(START)
    messages = [(t, item | {"header": {"stamp": value}}) for t, item in poses()]
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, messages)})
    with pytest.raises(DataError, match="no header stamps" if zero else "too little"):
        read(bag, POSE_MAP)


def test_what_is_no_rotation_is_no_pose(tmp_path):
    messages = [(t, item | {"pose": pose(w=0.5)}) for t, item in poses()]
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, messages)})
    for allow_gaps in (True, False):
        with pytest.raises(DataError, match="not unit"):
            read(bag, POSE_MAP, allow_gaps=allow_gaps)


def test_an_encoding_that_is_not_read_is_refused_only_where_it_is_wanted(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/x", "cbor", writer.register_schema("T", "", b""))
        writer.add_message(channel, START, b"\xa0", START)
        writer.finish()
    with pytest.raises(DataError, match="an encoding that is not read"):
        read(path, {"rate_hz": 1, "channels": {"object_pose": {"topic": "/x", "fields": ["a"]}}})
    with pytest.raises(UsageError, match="a map is needed"):
        read(path)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.97])
def test_a_cut_file_is_refused_or_read_up_to_its_cut(tmp_path, share):
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, poses(400))}, chunk_size=4096)
    raw = bag.read_bytes()
    bag.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(DataError, match="the recording is damaged"):
        read(bag, POSE_MAP)
    notes: list[str] = []
    (episode,) = read(bag, POSE_MAP, allow_gaps=True, note=notes.append)
    assert 10 < len(episode) <= 400
    assert (episode["object_pose"][:, 0] == range(len(episode))).all()
    assert any("has no end" in line for line in notes)


def test_a_broken_chunk_is_refused_or_a_gap(tmp_path):
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, poses(400))}, chunk_size=4096)
    raw = bytearray(bag.read_bytes())
    raw[len(raw) // 3] ^= 0xFF
    bag.write_bytes(bytes(raw))
    with pytest.raises(DataError, match="damaged"):
        read(bag, POSE_MAP)
    (episode,) = read(bag, POSE_MAP, allow_gaps=True)
    valid = episode.valid("object_pose")
    assert 0 < (~valid).sum() < 100
    assert (episode["object_pose"][valid, 0] == [k for k in range(400) if valid[k]]).all()


def test_a_lost_message_is_known_by_the_count(tmp_path):
    from mcap.writer import CompressionType

    topics = {"/pose": (POSES, poses(60))}
    bag = write_ros2(tmp_path / "run.mcap", topics, compression=CompressionType.NONE, enable_crcs=False)
    raw = bytearray(bag.read_bytes())
    body = struct.pack("<HIQQ", 1, 7, START + 7 * STEP, START + 7 * STEP - 1)
    at = raw.index(body) - 9
    assert raw[at] == 5  # a message
    raw[at] = 0x80  # a record of another's, which readers pass over
    bag.write_bytes(bytes(raw))
    with pytest.raises(DataError, match="59 messages where its statistics say 60"):
        read(bag, POSE_MAP)
    (episode,) = read(bag, POSE_MAP, allow_gaps=True)
    assert episode.meta.invalid_counts == {"object_pose": 1}


def test_a_topic_that_never_says_anything_finite_is_refused(tmp_path):
    messages = [(t, item | {"pose": pose(float("nan"))}) for t, item in poses()]
    topics = {"/pose": (POSES, messages), "/j": (JOINTS, joints())}
    bag = write_ros2(tmp_path / "run.mcap", topics)
    with pytest.raises(DataError, match="no row has a valid object_pose"):
        read(bag, channels(object_pose="/pose", joint_position="/j"), allow_gaps=True)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        (b"\x89MCAP", "no MCAP file"),
        (b"SQLite format 3\0", "ros2 bag convert"),
        (b"#ROSBAG V2.0", "mcap convert"),
        (b"\x28\xb5\x2f\xfd1234", "zstd -d"),
    ],
)
def test_files_that_are_no_recordings(tmp_path, content, words):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with pytest.raises(DataError, match=words):
        read(path, POSE_MAP)


def test_folders_that_are_no_bags(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    for source in (folder, tmp_path / "nothing"):
        with pytest.raises(DataError, match=r"no recording|no such recording"):
            read(source, POSE_MAP)
    bag = write_bag(tmp_path / "good", [POSE_TOPIC])
    for text in ("a: [", "{}", "rosbag2_bagfile_information: {relative_file_paths: [../../x.mcap]}", "[]"):
        (bag / "metadata.yaml").write_text(text)
        with pytest.raises(DataError):
            read(bag, POSE_MAP)


def test_every_error_says_where(tmp_path):
    bag = write_ros2(tmp_path / "run.mcap", {"/bare": (BARE, bare())})
    with pytest.raises(CandataError) as caught:
        read(bag, channels(object_pose="/bare"))
    text = str(caught.value)
    assert "run.mcap" in text
    assert "clock: log" in text
