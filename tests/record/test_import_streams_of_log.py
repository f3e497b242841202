"""Streams of a log in an import: joints and poses become channels, gaps stay gaps, what is not taken is told."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import CandataError
from candata.record.import_recipe import ImportRecipe
from candata.record.importing import import_log
from candata.record.log_streams import LoggedStream, SignalMeta, StreamMeta
from tests.record.made_logs import JOINTS, RECIPE, START, make_log, scene, swing

ARM = (
    SignalMeta(name="joint_position", shape=(2,), unit="rad", names=("w0", "w1")),
    SignalMeta(name="joint_target", shape=(2,), unit="rad", names=("w0", "w1")),
)
POSE = (SignalMeta(name="object_pose", shape=(7,), unit="m"),)
WRENCH = (SignalMeta(name="wrench", shape=(6,), unit="N"),)


def stream(name: str, signals: tuple[SignalMeta, ...], rate_hz: float, seconds: float, **values) -> LoggedStream:
    """A stream of constants unless `values` are given as functions of the time [ns]."""
    time_ns = START + np.round(np.arange(0, seconds, 1 / rate_hz) * 1e9).astype(np.int64)
    given = {s.name: values.get(s.name, lambda t, s=s: np.zeros((len(t), *s.shape)))(time_ns) for s in signals}
    meta = StreamMeta(name=name, device="line", link="udp", port="127.0.0.1:1", rate_hz=rate_hz, signals=signals)
    return LoggedStream(meta, time_ns, given, None, time_ns)


def pose_of(time_ns: np.ndarray) -> np.ndarray:
    pose = np.zeros((len(time_ns), 7))
    pose[:, 0], pose[:, 3] = (time_ns - START) * 1e-9, 1.0
    return pose


def imported(*streams: LoggedStream, **recipe):
    log = make_log(streams=streams)
    return import_log("run.mcap", log, RECIPE.model_copy(update=recipe))


def test_the_arms_joints_and_targets_stand_beside_the_hands():
    arm = stream(
        "arm", ARM, 200.0, 10.0, joint_position=lambda t: swing(t)[:, :2], joint_target=lambda t: swing(t)[:, 1:]
    )
    episode = imported(arm, roles=scene(rate_hz=50)).episode
    assert episode.meta.joint_names == ("w0", "w1", *JOINTS)
    assert episode.meta.actuator_names == ("w0", "w1", *JOINTS)
    np.testing.assert_allclose(episode["joint_position"][:, :2], swing(episode["time_ns"])[:, :2], atol=1e-3)
    step = episode["time_ns"] + 10_000_000  # a command counts by the middle of its step
    np.testing.assert_allclose(episode["action"][:, :2], swing(step)[:, 1:], atol=0.02)


def test_poses_are_not_bridged_over_a_gap_and_a_silent_end_shortens_nothing():
    pose = stream("pose", POSE, 15.0, 8.0, object_pose=pose_of)
    keep = (pose.time_ns < START + 5_000_000_000) | (pose.time_ns > START + 5_400_000_000)
    holed = LoggedStream(
        pose.meta, pose.time_ns[keep], {"object_pose": pose.values["object_pose"][keep]}, None, pose.time_ns
    )
    episode = imported(holed).episode
    seconds = (episode["time_ns"] - START) * 1e-9
    valid = episode.valid("object_pose")
    assert seconds[-1] > 9.9
    assert not valid[(seconds > 5.01) & (seconds < 5.39)].any()
    assert not valid[seconds > 8.0].any()
    assert valid[seconds < 4.9].all()
    np.testing.assert_allclose(episode["object_pose"][valid, 0], seconds[valid], atol=1e-4)


def test_a_quaternion_that_is_none_is_a_gap_and_told():
    def broken(time_ns):
        pose = pose_of(time_ns)
        pose[60, 3:] = 0.0
        return pose

    result = imported(stream("pose", POSE, 15.0, 10.0, object_pose=broken))
    assert "/pose: 1 poses without a unit quaternion are taken for gaps" in result.notes
    seconds = (result.episode["time_ns"] - START) * 1e-9
    assert not result.episode.valid("object_pose")[np.abs(seconds - 4.0) < 0.05].any()


def test_what_no_channel_holds_stays_in_the_log_and_is_told():
    result = imported(stream("wrench", WRENCH, 100.0, 10.0))
    assert any(note.startswith("/wrench: wrench stays in the log") for note in result.notes)
    assert set(result.episode.arrays) == set(imported().episode.arrays)


def test_a_gap_of_no_more_than_a_period_is_refused():
    with pytest.raises(CandataError, match="max_gap_periods"):
        ImportRecipe.parse({"episode": "e", "max_gap_periods": 0.5}, "options")
