"""An episode is checked when it is made; every refusal says what, where and what to do."""

import numpy as np
import pytest

from candata.errors import DataError
from candata.schema.episode import Episode, EpisodeMeta, problems

META = EpisodeMeta(id="e1", source="real", rate_hz=100.0)


def arrays(rows: int = 4, **more):
    pose = np.zeros((rows, 7))
    pose[:, 3] = 1.0
    return {"time_ns": np.arange(rows) * 10_000_000, "object_pose": pose} | more


def refusal(meta=META, **changed) -> str:
    held = {name: value for name, value in arrays(**changed).items() if value is not None}
    with pytest.raises(DataError) as caught:
        Episode(meta, held)
    return str(caught.value)


def test_an_episode_casts_orders_and_freezes():
    episode = Episode(META, {"joint_position": [[0.0], [1.0]], "time_ns": [0, 5_000_000]})
    assert list(episode.arrays) == ["time_ns", "joint_position"]
    assert episode["joint_position"].dtype == np.float32
    assert len(episode) == 2
    assert "action" not in episode
    np.testing.assert_array_equal(episode.time_s, [0.0, 0.005])
    with pytest.raises(ValueError, match="read-only"):
        episode["time_ns"][0] = 1


def test_the_caller_s_array_is_not_kept():
    given = arrays()
    episode = Episode(META, given)
    given["object_pose"][0, 0] = 5.0
    assert episode["object_pose"][0, 0] == 0.0


def test_valid_rows_default_to_all():
    flags = np.array([True, False, True, True])
    pose = arrays()["object_pose"]
    pose[1] = np.nan
    episode = Episode(META, arrays(object_pose=pose, object_pose_valid=flags))
    np.testing.assert_array_equal(episode.valid("object_pose"), flags)
    assert episode.valid("action").all()


def test_a_channel_that_is_not_there_lists_those_that_are():
    with pytest.raises(DataError) as caught:
        Episode(META, arrays())["action"]
    assert str(caught.value) == (
        "episode has no channel action\n  expected: action\n  found: time_ns, object_pose\n  where: episode e1"
    )


def test_unknown_channel():
    assert refusal(pose=np.zeros(4)).splitlines()[0] == "unknown channel 'pose'"
    assert refusal(pose=np.zeros(4)).splitlines()[-1] == "  where: episode e1, channel pose"


def test_required_channels():
    assert refusal(object_pose=None) == (
        "an episode needs time_ns and one of object_pose, joint_position\n  found: time_ns\n  where: episode e1"
    )
    assert refusal(time_ns=None).splitlines()[1] == "  found: object_pose"


def test_wrong_width():
    assert refusal(object_velocity=np.zeros((4, 3))) == (
        "object_velocity has the wrong shape\n  expected: (T = 4, 6)\n  found: (4, 3)\n"
        "  where: episode e1, channel object_velocity"
    )


def test_wrong_length_and_wrong_rank():
    assert "expected: (T = 4, A)\n  found: (3, 2)" in refusal(action=np.zeros((3, 2)))
    assert "expected: (T = 4)\n  found: (4, 1)" in refusal(contact=np.zeros((4, 1), bool))
    assert "expected: (T = 4)\n  found: (2,)" in refusal(object_pose_valid=np.ones(2, bool))


def test_wrong_count_of_joints():
    meta = META.model_copy(update={"joint_names": ("a", "b")})
    assert refusal(meta, joint_position=np.zeros((4, 3))) == (
        "joint_position has the wrong shape\n  expected: (T = 4, J = 2)\n  found: (4, 3)\n"
        "  where: episode e1, channel joint_position"
    )


@pytest.mark.parametrize("second", [10, 9])
def test_time_must_increase(second):
    assert refusal(time_ns=np.array([0, 10, second, 30])) == (
        f"time does not increase\n  expected: more than 10 ns\n  found: {second} ns\n"
        "  where: episode e1, channel time_ns, index 2\n  do: sort the rows by time and drop repeated stamps"
    )


def test_no_rows():
    assert refusal(rows=0) == "episode has no rows\n  expected: at least 1 row\n  where: episode e1"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_not_finite(value):
    pose = arrays()["object_pose"]
    pose[2, 1] = value
    assert refusal(object_pose=pose) == (
        "object_pose is not finite\n  expected: finite numbers where valid\n  found: 1 such rows\n"
        "  where: episode e1, channel object_pose, index 2\n"
        "  do: mark gaps as invalid: import with --allow-gaps"
    )


@pytest.mark.parametrize("channel", ["object_pose", "hand_pose"])
def test_quaternions_must_be_unit(channel):
    pose = arrays()["object_pose"]
    pose[1:3, 3] = 1.1
    assert refusal(**{channel: pose}) == (
        f"{channel} holds a quaternion that is not unit\n  expected: norm 1 +- 0.001\n"
        f"  found: norm 1.1000 (2 rows)\n  where: episode e1, channel {channel}, index 1\n"
        "  do: check the order (w x y z) and the columns of the quaternion"
    )


def test_a_quaternion_in_an_invalid_row_is_not_looked_at():
    pose = arrays()["object_pose"]
    pose[1, 3] = 2.0
    flags = np.array([True, False, True, True])
    assert len(Episode(META, arrays(object_pose=pose, object_pose_valid=flags))) == 4


def test_problems_reports_all_and_does_not_raise():
    pose = arrays()["object_pose"]
    pose[0, 0], pose[1, 3] = np.nan, 2.0
    held = arrays(object_pose=pose, time_ns=np.array([0, 5, 5, 9]), action=np.zeros((1, 2)))
    assert [problem.problem for problem in problems(META, held)] == [
        "action has the wrong shape",
        "time does not increase",
        "object_pose is not finite",
        "object_pose holds a quaternion that is not unit",
    ]
