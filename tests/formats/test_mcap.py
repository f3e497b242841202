"""Recordings become episodes: standard messages, clocks, roles, gaps, windows."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import DataError, UnknownNameError, UsageError
from candata.formats import Reading
from candata.plugins import load
from tests.formats.made_bags import (
    POSE_MAP,
    POSE_TOPIC,
    START,
    STEP,
    fox_pose,
    joints,
    pose,
    poses,
    read,
    stamp,
    write_bag,
    write_foxglove,
    write_ros2,
)

POSES, JOINTS = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/JointState"
TIMES = START + STEP * np.arange(50)


def test_a_stamped_pose_becomes_the_object_s(tmp_path):
    (episode,) = read(write_ros2(tmp_path / "run.mcap", POSE_TOPIC), POSE_MAP, object="can")
    assert (episode.meta.id, episode.meta.object, episode.meta.source) == ("run", "can", "real")
    assert (episode["time_ns"] == TIMES).all()
    assert (episode["object_pose"] == np.c_[np.arange(50), [[2, 3, 1, 0, 0, 0]] * 50]).all()
    assert episode.meta.invalid_counts == {}


def test_joints_are_matched_by_the_message_s_own_names(tmp_path):
    other = [(t + 1, value) for t, value in joints(names=("x", "y"))]
    mixed = sorted(joints(names=("b", "a"), effort=[7.0, 8.0]) + other, key=lambda m: m[0])
    bag = write_ros2(tmp_path / "run.mcap", {"/j": (JOINTS, mixed)})
    entry = {"topic": "/j", "joints": ["a", "b"]}
    (episode,) = read(bag, {"rate_hz": 100, "channels": {"joint_position": entry, "joint_effort": entry}})
    assert episode.meta.joint_names == ("a", "b")
    assert episode["joint_position"] == pytest.approx(np.arange(50)[:, None] + [0.1, 0.0], abs=1e-5)  # float32
    assert (episode["joint_effort"] == [8.0, 7.0]).all()


def test_two_topics_stand_side_by_side_in_one_channel(tmp_path):
    topics = {"/arm": (JOINTS, joints(names=["w"])), "/hand": (JOINTS, joints(names=["f", "g"]))}
    channels = {"joint_position": [{"topic": "/hand", "joints": ["g"]}, {"topic": "/arm"}]}
    (episode,) = read(write_ros2(tmp_path / "run.mcap", topics), {"rate_hz": 100, "channels": channels})
    assert episode.meta.joint_names == ("g", "w")
    assert episode["joint_position"][3] == pytest.approx([3.1, 3.0])


def test_units_and_signs_are_the_map_s(tmp_path):
    force = {"x": 1.0, "y": 2.0, "z": -3.0}
    wrench = [(t, {"header": {"stamp": stamp(t)}, "wrench": {"force": force}}) for t in TIMES.tolist()]
    topics = {"/j": (JOINTS, joints()), "/thumb": ("geometry_msgs/msg/WrenchStamped", wrench)}
    channels = {
        "joint_position": {"topic": "/j", "unit": "deg"},
        "fingertip_force": [{"topic": "/thumb", "fingertips": ["thumb"], "scale": -1, "unit": "mN"}],
    }
    (episode,) = read(write_ros2(tmp_path / "run.mcap", topics), {"rate_hz": 100, "channels": channels})
    assert episode["joint_position"][10, 0] == pytest.approx(np.deg2rad(10), rel=1e-6)  # float32
    assert episode["fingertip_force"][10, 0] == pytest.approx([-1e-3, -2e-3, 3e-3])
    assert episode.meta.fingertip_names == ("thumb",)
    assert not episode["contact"].any()


def test_a_force_over_the_threshold_is_contact(tmp_path):
    data = [(t, {"data": [0.0, 0.0, float(k >= 25)]}) for k, t in enumerate(TIMES.tolist())]
    topics = POSE_TOPIC | {"/f": ("std_msgs/msg/Float64MultiArray", data)}
    entry = {"topic": "/f", "clock": "log", "fingertips": ["tip"]}
    mapping = {"rate_hz": 100, "channels": {"object_pose": "/pose", "fingertip_force": entry}}
    (episode,) = read(write_ros2(tmp_path / "run.mcap", topics), mapping)
    assert int(np.argmax(episode["contact"])) == 25
    assert episode.meta.contact_rule is not None


def test_a_transform_is_found_by_its_child_frame(tmp_path):
    def item(child, parent, x, t):
        at = {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": pose()["orientation"]}
        return {"header": {"stamp": stamp(t), "frame_id": parent}, "child_frame_id": child, "transform": at}

    messages = [
        (t, {"transforms": [item("cup", "map", 9.0, t), item("can", "map", 1.0, t), item("can", "odom", 2.0, t)]})
        for t in TIMES.tolist()
    ]
    bag = write_ros2(tmp_path / "run.mcap", {"/tf": ("tf2_msgs/msg/TFMessage", messages)})
    entry = {"topic": "/tf", "child": "can", "parent": "map"}
    (episode,) = read(bag, {"rate_hz": 100, "channels": {"object_pose": entry}})
    assert (episode["object_pose"][:, 0] == 1.0).all()
    with pytest.raises(UsageError, match="which frame"):
        read(bag, {"rate_hz": 100, "channels": {"object_pose": "/tf"}})
    with pytest.raises(DataError, match="holds nothing for object_pose"):
        read(bag, {"rate_hz": 100, "channels": {"object_pose": {"topic": "/tf", "child": "mug"}}})


def test_foxglove_s_protobuf_and_json_are_read_alike(tmp_path):
    found = [fox_pose(t, float(k)) for k, t in enumerate(TIMES.tolist())]
    plain = [
        (
            t,
            {
                "timestamp": {"sec": t // 10**9, "nsec": t % 10**9},
                "pose": {"position": {"x": k, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
            },
        )
        for k, t in enumerate(TIMES.tolist())
    ]
    kind = "foxglove.PoseInFrame"
    (one,) = read(write_foxglove(tmp_path / "p.mcap", {"/pose": (kind, found)}), POSE_MAP)
    (two,) = read(write_foxglove(tmp_path / "j.mcap", {"/pose": (kind, plain)}, "json"), POSE_MAP)
    assert all((one[name] == two[name]).all() for name in ("time_ns", "object_pose"))


def test_field_paths_reach_into_any_message(tmp_path):
    data = [(t, {"data": [9.0, *map(float, (k, 2, 3, 1, 0, 0, 0))]}) for k, t in enumerate(TIMES.tolist())]
    bag = write_ros2(tmp_path / "run.mcap", {"/raw": ("std_msgs/msg/Float64MultiArray", data)})
    for fields in (["data[1:8]"], ["data[1]", "data[2:-2]", "data[6:]"]):
        entry = {"topic": "/raw", "clock": "log", "fields": fields}
        (episode,) = read(bag, {"rate_hz": 100, "channels": {"object_pose": entry}})
        assert (episode["object_pose"][:, 0] == np.arange(50)).all()


def test_the_recorder_s_clock_is_measured_and_moves_only_what_asks_for_it(tmp_path):
    drift = [(t + 5_000_000 + 100 * k, value) for k, (t, value) in enumerate(poses())]  # 100 ns in 10 ms: 10 ppm
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, drift)})
    times = {}
    for clock in ("header", "log", "publish", "fitted"):
        (episode,) = read(bag, POSE_MAP | {"clock": clock})
        times[clock] = episode["time_ns"]
        assert episode.meta.alignment.drift_ppm == pytest.approx(10, rel=1e-6)
        assert episode.meta.alignment.offset_s == pytest.approx(5e-3, abs=1e-5)  # the median lies half way
        assert f"by {clock}" in episode.meta.alignment.method
    assert times["header"][0] == START
    assert times["log"][0] == START + 5_000_000
    assert times["publish"][0] == times["log"][0] - 1
    assert abs(times["fitted"][0] - times["log"][0]) <= 1  # rounding to a nanosecond


def test_a_device_with_a_clock_of_its_own_is_fitted_onto_the_recorder_s(tmp_path):
    boot = [(t + START, value) for t, value in poses(start=0)]
    data = [(t, {"data": [float(k)]}) for k, t in enumerate(TIMES.tolist())]
    topics = {"/pose": (POSES, boot), "/cmd": ("std_msgs/msg/Float64MultiArray", data)}
    channels = {"object_pose": {"topic": "/pose"}, "action": {"topic": "/cmd", "clock": "log"}}
    bag = write_ros2(tmp_path / "run.mcap", topics)
    with pytest.raises(DataError, match="not recorded at one time"):
        read(bag, {"rate_hz": 100, "channels": channels})
    channels["object_pose"]["clock"] = "fitted"
    (episode,) = read(bag, {"rate_hz": 100, "channels": channels})
    assert (episode["object_pose"][:, 0] == episode["action"][:, 0]).all()


def test_rows_may_lie_at_the_stamps_of_a_channel(tmp_path, rng):
    jitter = rng.integers(-(10**6), 10**6, 50).tolist()
    shaken = [
        (t, {"header": {"stamp": stamp(t + j)}, "pose": pose(float(k))})
        for k, (t, j) in enumerate(zip(TIMES.tolist(), jitter, strict=True))
    ]
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, shaken)})
    (episode,) = read(bag, POSE_MAP | {"reference": "object_pose"})
    assert (episode["time_ns"] == TIMES + jitter).all()
    assert (episode["object_pose"][:, 0] == np.arange(50)).all()
    with pytest.raises(UsageError, match="do not come at rate_hz"):
        read(bag, POSE_MAP | {"reference": "object_pose", "rate_hz": 50})


def test_slow_and_fast_topics_meet_by_their_roles(tmp_path):
    fast = [(START + k * STEP // 4, {"data": [float(k)] * 3}) for k in range(200)]
    slow = [(START + k * STEP * 2, {"data": [float(k)]}) for k in range(26)]
    array = "std_msgs/msg/Float64MultiArray"
    topics = POSE_TOPIC | {"/force": (array, fast), "/cmd": (array, slow)}
    channels = {
        "object_pose": {"topic": "/pose"},
        "fingertip_force": {"topic": "/force", "clock": "log"},
        "action": {"topic": "/cmd", "clock": "log", "max_gap_periods": 2},
    }
    (episode,) = read(write_ros2(tmp_path / "run.mcap", topics), {"rate_hz": 100, "channels": channels})
    row = episode["object_pose"][:, 0].astype(int)
    assert (episode["action"][:, 0] == row // 2).all()
    # Of the four readings before a row, each stands for the eighth of the step around it: 4 k - 3 to 4 k.
    assert (episode["fingertip_force"][1:, 0, 0] == 4 * row[1:] - 1.5).all()


@pytest.mark.parametrize("reference", [None, "object_pose"])
def test_a_gap_is_refused_or_marked_and_never_filled(tmp_path, reference):
    torn = [message for k, message in enumerate(poses()) if not 20 <= k < 30]
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, torn)})
    mapping = POSE_MAP | ({"reference": reference} if reference else {})
    with pytest.raises(DataError, match="/pose has a gap") as caught:
        read(bag, mapping)
    assert caught.value.where.index == 20
    notes: list[str] = []
    (episode,) = read(bag, mapping, allow_gaps=True, note=notes.append)
    valid = episode.valid("object_pose")
    if reference:
        assert len(episode) == 40
        assert valid.all()
        assert any("time jumps at 1 gaps" in line for line in notes)
    else:
        assert np.flatnonzero(~valid).tolist() == list(range(20, 30))
        assert episode.meta.invalid_counts == {"object_pose": 10}
        assert np.isnan(episode["object_pose"][~valid]).all()


def test_what_counts_as_a_gap_is_the_map_s(tmp_path):
    torn = [message for k, message in enumerate(poses()) if not 20 <= k < 30]
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, torn)})
    entry = {"topic": "/pose", "max_gap_periods": 11}
    (episode,) = read(bag, {"rate_hz": 100, "channels": {"object_pose": entry}})
    assert episode["object_pose"][:, 0] == pytest.approx(np.arange(50), rel=1e-6)  # linear between its ends, float32
    with pytest.raises(DataError, match="has a gap"):
        read(bag, {"rate_hz": 100, "channels": {"object_pose": entry | {"max_gap_periods": 10}}})


def test_messages_need_not_stand_in_the_order_of_time(tmp_path):
    shuffled = [poses()[k] for k in (*range(25, 50), *range(25))]
    (episode,) = read(write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, shuffled)}), POSE_MAP)
    assert (episode["object_pose"][:, 0] == np.arange(50)).all()


@pytest.mark.parametrize("broken", [pose(float("nan")), pose(w=0.0), pose(1e300)])
def test_what_is_not_finite_is_refused_by_its_number_or_counts_as_not_read(tmp_path, broken):
    messages = poses()
    messages[7][1]["pose"] = broken
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, messages)})
    with pytest.raises(DataError, match="/pose is not finite") as caught:
        read(bag, POSE_MAP)
    assert (caught.value.where.channel, caught.value.where.index) == ("/pose", 7)
    (episode,) = read(bag, POSE_MAP, allow_gaps=True)
    assert np.flatnonzero(~episode.valid("object_pose")).tolist() == [7]


def test_a_flag_sent_on_change_is_held(tmp_path):
    flags = [(START, {"data": False}), (START + 20 * STEP, {"data": True}), (START + 60 * STEP, {"data": False})]
    topics = POSE_TOPIC | {"/grasp": ("std_msgs/msg/Bool", flags)}
    entry = {"topic": "/grasp", "clock": "log", "role": "command", "max_gap_periods": float("inf")}
    mapping = {"rate_hz": 100, "channels": {"object_pose": "/pose", "contact": entry}}
    (episode,) = read(write_ros2(tmp_path / "run.mcap", topics), mapping)
    assert np.flatnonzero(episode["contact"]).tolist() == list(range(20, 50))


def test_episodes_are_cut_by_ranges(tmp_path):
    bag = write_ros2(tmp_path / "run.mcap", POSE_TOPIC)
    found = read(bag, POSE_MAP | {"episodes": {"ranges_s": [[0.1, 0.2], [0.3, 9.0]]}})
    assert [episode.meta.id for episode in found] == ["run-0", "run-1"]
    assert found[0]["object_pose"][:, 0].tolist() == list(range(10, 21))
    assert len(found[1]) == 20
    with pytest.raises(UsageError, match="range holds nothing"):
        read(bag, POSE_MAP | {"episodes": {"ranges_s": [[0.2, 0.1]]}})


def test_episodes_are_cut_by_a_flag_or_by_messages(tmp_path):
    flags = [
        (START + 10 * STEP, {"data": True}),
        (START + 20 * STEP, {"data": False}),
        (START + 30 * STEP, {"data": True}),
    ]
    words = [(START + k * STEP, {"data": "go"}) for k in (10, 20, 30)]
    topics = POSE_TOPIC | {"/flag": ("std_msgs/msg/Bool", flags), "/word": ("std_msgs/msg/String", words)}
    bag = write_ros2(tmp_path / "run.mcap", topics)
    by_flag = read(bag, POSE_MAP | {"episodes": {"marker": "/flag"}})
    assert [e["object_pose"][[0, -1], 0].tolist() for e in by_flag] == [[10, 20], [30, 49]]
    by_word = read(bag, POSE_MAP | {"episodes": {"marker": "/word"}})
    assert [e["object_pose"][[0, -1], 0].tolist() for e in by_word] == [[10, 20], [20, 30], [30, 49]]


def test_the_files_of_a_bag_are_one_recording_and_a_folder_of_bags_several(tmp_path):
    folder = tmp_path / "all"
    folder.mkdir()
    halves = [{"/pose": (POSES, poses()[:25])}, {"/pose": (POSES, poses()[25:])}]
    write_bag(folder / "first", halves)
    write_ros2(folder / "second.mcap", POSE_TOPIC)
    (one,) = read(folder / "first", POSE_MAP)
    assert len(one) == 50
    assert [episode.meta.id for episode in read(folder, POSE_MAP)] == ["second", "first"]


def test_a_pause_does_not_change_the_rate_that_is_offered(tmp_path):
    """Vicon lost the vehicle for half a minute: the stream is still one of 100 Hz."""
    early = poses()
    late = [(stamp + 30 * 10**9, value) for stamp, value in early]
    bag = write_ros2(tmp_path / "run.mcap", {"/pose": (POSES, early + late)})
    with pytest.raises(UsageError) as caught:
        read(bag)
    assert "100 messages  100.0 Hz" in str(caught.value)
    assert "rate_hz: 100.0" in caught.value.fix


def test_without_a_map_the_topics_and_a_map_are_offered_and_that_map_works(tmp_path):
    topics = POSE_TOPIC | {"/j": (JOINTS, joints()), "/word": ("std_msgs/msg/String", [(START, {"data": "x"})])}
    bag = write_ros2(tmp_path / "run.mcap", topics)
    with pytest.raises(UsageError) as caught:
        read(bag)
    assert "/pose  geometry_msgs/PoseStamped  50 messages  100.0 Hz, stamped" in str(caught.value)
    path = tmp_path / "topics.yaml"
    path.write_text(caught.value.fix.split("\n\n", 1)[1])
    (episode,) = load("candata.formats", "FORMAT", "mcap").read(bag, Reading(mapping=path))
    assert episode.meta.joint_names == ("b", "a")
    assert episode.meta.rate_hz == 100


def test_what_the_map_leaves_out_is_told(tmp_path):
    topics = POSE_TOPIC | {"/word": ("std_msgs/msg/String", [(START, {"data": "x"})])}
    notes: list[str] = []
    read(write_ros2(tmp_path / "run.mcap", topics), POSE_MAP, note=notes.append)
    assert notes == ["run: left out, not in the map: /word (std_msgs/String, 1 messages)"]


def test_a_missing_topic_names_the_nearest(tmp_path):
    with pytest.raises(UnknownNameError, match="did you mean '/pose'"):
        read(write_ros2(tmp_path / "run.mcap", POSE_TOPIC), {"rate_hz": 100, "channels": {"object_pose": "/pos"}})
