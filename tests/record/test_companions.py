"""Files beside a log: tables with their map, MCAP with poses, joints and commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from candata.errors import DataError, UsageError
from candata.formats._mcap_messages import descriptors, message
from candata.record.companions import read_companion
from candata.record.importing import import_log
from tests.record.made_logs import JOINTS, RECIPE, START, make_log


def write_mcap(path: Path, topics: dict[str, tuple[str, list]]) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "test")
        for topic, (name, messages) in topics.items():
            schema = writer.register_schema(name, "protobuf", descriptors(name))
            channel = writer.register_channel(topic, "protobuf", schema)
            for time_ns, data in messages:
                writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()
    return path


def pose_message(time_ns: int, stamped: bool = True, w: float = 1.0) -> tuple[int, bytes]:
    found = message("foxglove.PoseInFrame")()
    if stamped:
        found.timestamp.FromNanoseconds(time_ns)
    found.pose.position.x, found.pose.orientation.w = 0.25, w
    return time_ns + (5_000_000 if stamped else 0), found.SerializeToString()


def joints_message(time_ns: int, **positions: float) -> tuple[int, bytes]:
    found = message("foxglove.JointStates")()
    for name, position in positions.items():
        found.joints.add(name=name, position=position)
    return time_ns, found.SerializeToString()


TIMES = [START + k * 10_000_000 for k in range(1000)]


@pytest.mark.parametrize("stamped", [True, False])
def test_an_mcap_file_brings_poses_joints_and_commands(tmp_path, stamped):
    path = write_mcap(
        tmp_path / "arm.mcap",
        {
            "/tracker/can": ("foxglove.PoseInFrame", [pose_message(t, stamped) for t in TIMES]),
            "/arm/joint_states": ("foxglove.JointStates", [joints_message(t, w0=1.5) for t in TIMES]),
            "/arm/joint_targets": ("foxglove.JointStates", [joints_message(t, w0=2.5) for t in TIMES]),
        },
    )
    companion = read_companion(path)
    assert all(stream.time_ns.tolist() == TIMES for stream in companion.streams)
    episode = import_log("run.mcap", make_log(), RECIPE, [companion]).episode
    assert episode.meta.joint_names == episode.meta.actuator_names == ("w0", *JOINTS)
    assert (episode["joint_position"][:, 0] == 1.5).all()
    assert (episode["action"][:, 0] == 2.5).all()
    assert (episode["object_pose"] == [0.25, 0, 0, 1, 0, 0, 0]).all()


def test_wrong_mcap_files_are_refused(tmp_path):
    poses = [pose_message(t) for t in TIMES[:9]]
    two = {f"/{name}": ("foxglove.PoseInFrame", poses) for name in "ab"}
    with pytest.raises(DataError, match="several poses"):
        read_companion(write_mcap(tmp_path / "two.mcap", two))
    with pytest.raises(DataError, match="nothing to import"):
        read_companion(write_mcap(tmp_path / "none.mcap", {}))
    zero = {"/a": ("foxglove.PoseInFrame", [pose_message(TIMES[0], w=0.0)])}
    with pytest.raises(DataError, match="not unit"):
        read_companion(write_mcap(tmp_path / "zero.mcap", zero))
    other = {"/a": ("foxglove.JointStates", [joints_message(1, a=1.0), joints_message(2, b=1.0)])}
    with pytest.raises(DataError, match="change"):
        read_companion(write_mcap(tmp_path / "other.mcap", other))
    broken = {"/a": ("foxglove.JointStates", [(1, b"\xff\xff\xff")])}
    with pytest.raises(DataError, match=r"no foxglove\.JointStates"):
        read_companion(write_mcap(tmp_path / "broken.mcap", broken))
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(DataError, match="empty"):
        read_companion(tmp_path / "empty.mcap")


def write_table(folder: Path, time_s, file: str = "t.csv", **fields) -> Path:
    lines = ["t,px,py,pz,qw,qx,qy,qz,a_w0"] + [f"{t!r},{k},0,0,1,0,0,0,{k}" for k, t in enumerate(time_s)]
    (folder / file).write_text("\n".join(lines))
    head = f"file: {file}\ntime_s: t\nrate_hz: 100\n" + "".join(f"{k}: {v}\n" for k, v in fields.items())
    (folder / "map.yaml").write_text(f"{head}channels: {{object_pose: [px, py, pz, qw, qx, qy, qz], action: [a_w0]}}\n")
    return folder / file


def test_a_table_is_found_by_itself_or_by_its_map(tmp_path):
    table = write_table(tmp_path, [1.0, 1.01, 1.02], task="push", object="can")
    for path in (table, tmp_path / "map.yaml"):
        companion = read_companion(path)
        assert [s.channel for s in companion.streams] == ["object_pose", "action"]
        assert companion.streams[1].time_ns.tolist() == [1_000_000_000, 1_010_000_000, 1_020_000_000]
        assert companion.streams[1].names == ("w0",)
        assert (companion.task, companion.object) == ("push", "can")


def test_an_action_of_the_step_before_bears_the_stamp_at_which_it_began(tmp_path):
    companion = read_companion(write_table(tmp_path, [1.0, 1.01, 1.02], action="previous"))
    action = companion.streams[1]
    assert action.time_ns.tolist() == [1_000_000_000, 1_010_000_000]
    assert action.values[:, 0].tolist() == [1, 2]


def test_other_files_are_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot import a log with this file"):
        read_companion(tmp_path / "poses.txt")
    with pytest.raises(UsageError, match="the table has no map"):
        read_companion(tmp_path / "poses.parquet")
    write_table(tmp_path, [1.0, 1.01])
    with pytest.raises(UsageError, match="a map of another file"):
        read_companion(tmp_path / "poses.parquet")
    with pytest.raises(UsageError, match="the map cannot be read"):
        read_companion(tmp_path / "absent.yaml")
