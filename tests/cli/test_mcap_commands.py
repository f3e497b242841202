"""`import mcap` and `export mcap`: what they print, what they leave, and their exit codes."""

from __future__ import annotations

import numpy as np
import pytest

from candata.datasets import append, content_hash, create_dataset, get_cloud, open_dataset, put_cloud
from candata.schema.manifest import Lineage
from tests.cli.command import exit_code
from tests.formats.made_bags import POSE_TOPIC, poses, write_bag, write_ros2


@pytest.fixture
def out(tmp_path):
    return tmp_path / "made" / "ds"


def test_a_bag_is_imported_by_its_map_which_the_lineage_keeps(tmp_path, out, capsys):
    bag = write_bag(tmp_path / "flight", [POSE_TOPIC])
    text = "rate_hz: 100\nchannels: {object_pose: /pose}  # the can\n"
    (tmp_path / "topics.yaml").write_text(text)
    command = ("import", "mcap", bag, "--map", tmp_path / "topics.yaml", "--out", out, "--object", "can")
    assert exit_code(*command) == 0
    assert capsys.readouterr().out == f"{out}: 1 episodes added, 1 in version 1\n"
    data = open_dataset(out)
    assert data.ids == ("flight",)
    assert data.lineage[0].details["map"] == text
    assert exit_code(*command, "--append") == 0
    assert len(open_dataset(out)) == 1


def test_without_a_map_one_is_offered_and_nothing_is_left(tmp_path, out, capsys):
    bag = write_bag(tmp_path / "flight", [POSE_TOPIC])
    assert exit_code("import", "mcap", bag, "--out", out) == 2
    assert "object_pose: {topic: /pose}" in capsys.readouterr().err
    assert not out.parent.exists()


def test_of_several_recordings_all_or_none_are_imported(tmp_path, out, capsys):
    folder = tmp_path / "all"
    folder.mkdir()
    write_ros2(folder / "a.mcap", POSE_TOPIC)
    torn = poses()
    del torn[20:30]
    write_ros2(folder / "b.mcap", {"/pose": ("geometry_msgs/msg/PoseStamped", torn)})
    (tmp_path / "topics.yaml").write_text("rate_hz: 100\nchannels: {object_pose: /pose}\n")
    command = ("import", "mcap", folder, "--map", tmp_path / "topics.yaml", "--out", out)
    assert exit_code(*command) == 2
    assert "episode b, channel object_pose, index 20" in capsys.readouterr().err
    assert not list(out.parent.glob("*"))
    assert not list(out.parent.glob(".*"))
    assert exit_code(*command, "--allow-gaps") == 0
    printed = capsys.readouterr()
    assert "b: rows marked invalid by gaps: object_pose 10 of 50" in printed.err
    assert open_dataset(out).ids == ("a", "b")


def test_an_export_comes_back_whole_with_its_cloud(tmp_path, out, episode, capsys):
    root = create_dataset(tmp_path / "sim")
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    cloud = put_cloud(root, points)
    append(root, [episode("one", seed=1, point_cloud=cloud), episode("two", seed=2)], Lineage(operation="test"))
    assert exit_code("export", "mcap", root, "--out", tmp_path / "fox") == 0
    assert [path.suffix for path in sorted((tmp_path / "fox").iterdir())] == [".mcap", ".mcap"]
    assert exit_code("import", "mcap", tmp_path / "fox", "--out", out) == 0
    before, after = open_dataset(root), open_dataset(out)
    assert [content_hash(e) for e in after.episodes()] == [content_hash(e) for e in before.episodes()]
    assert (get_cloud(out, cloud) == points).all()
    assert exit_code("validate", out, "--rule", "hashes", "--deep") == 0


def test_foundationpose_needs_its_map(tmp_path, out, capsys):
    (tmp_path / "seq" / "ob_in_cam").mkdir(parents=True)
    for k in range(3):
        np.savetxt(tmp_path / "seq" / "ob_in_cam" / f"{k}.txt", np.eye(4))
    assert exit_code("import", "foundationpose", tmp_path / "seq", "--out", out) == 2
    assert "rate_hz: 30" in capsys.readouterr().err
    (tmp_path / "frames.yaml").write_text("rate_hz: 30\n")
    assert exit_code("import", "foundationpose", tmp_path / "seq", "--map", tmp_path / "frames.yaml", "--out", out) == 0
    assert len(next(iter(open_dataset(out).episodes()))) == 3
