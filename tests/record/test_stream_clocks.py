"""Clocks of streams beside the hand: found by motion or by the device's own, refused where nothing tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.record.companions import RecordedStream
from candata.record.import_streams import WIRE
from candata.record.importing import import_log
from candata.record.stream_clocks import clock_notes, set_clocks
from tests.record.made_logs import RECIPE, START, beside, make_log

#: A hand on a rate of its own, and a tracker.
HAND_HZ, POSE_HZ = 83.0, 15.0


def motion(seconds, rng_seed=3):
    """Positions at given times [s] of something that moves in all directions and never repeats itself."""
    rng = np.random.default_rng(rng_seed)
    frequencies, phases = rng.uniform(0.05, 0.8, 12), rng.uniform(0, 6.28, 12)
    amplitude = rng.normal(size=(12, 3)) / (6.28 * frequencies[:, None])
    return np.sin(6.28 * seconds[:, None] * frequencies + phases) @ amplitude


def hand(seconds, moves=motion, span_s=60.0):
    time_s = np.arange(0, span_s, 1 / HAND_HZ)
    return RecordedStream("joint_position", ("a", "b", "c"), stamps(time_s), moves(time_s) + seconds, WIRE)


def stamps(time_s):
    return START + np.round(np.asarray(time_s) * 1e9).astype(np.int64)


def tracker(late_s=0.0, drift_ppm=0.0, moves=motion, span_s=60.0, noise_m=0.0005):
    """A tracker whose stamps are late by so much at the start, and by more each second."""
    time_s = np.arange(0, span_s, 1 / POSE_HZ)
    pose = np.zeros((len(time_s), 7))
    pose[:, :3] = 0.05 * moves(time_s) + np.random.default_rng(5).normal(0, noise_m, (len(time_s), 3))
    pose[:, 3] = 1.0
    return RecordedStream("object_pose", (), stamps(time_s + late_s + drift_ppm * 1e-6 * time_s), pose, "poses")


def true_s(stream, found):
    """By how much the stamps that were found are off, at most [s]."""
    time_s = np.arange(0, 60.0, 1 / POSE_HZ)[: len(stream.time_ns)]
    return np.abs((found.time_ns - stamps(time_s)) * 1e-9).max()


@pytest.mark.parametrize(("late_s", "drift_ppm"), [(0.0, 0.0), (0.3, 0.0), (-0.12, 0.0), (0.05, 2000.0)])
def test_offset_and_drift_are_found_by_motion(late_s, drift_ppm):
    late = tracker(late_s, drift_ppm)
    (_, found), (clock,) = set_clocks([hand(0.0), late], by_motion=True)
    assert clock.method == "motion"
    assert clock.offset_s == pytest.approx(late_s, abs=0.01)
    assert clock.windows >= 3
    assert clock.correlation > 0.5
    assert clock.sharpness > 0.1
    # A fifth of the tracker's period, at the ends of the line.
    assert true_s(late, found) < 0.2 / POSE_HZ
    (note,) = clock_notes([clock])
    assert "sharpness" in note
    assert f"drift {clock.drift_ppm:+.0f} ppm" in note


@pytest.mark.slow
def test_many_recordings_are_aligned_and_none_that_share_no_motion():
    worst_s = []
    for seed in range(40):
        late = tracker(
            np.random.default_rng(seed).uniform(-0.8, 0.8), 50.0, lambda s, k=seed: motion(s, 100 + k), 60, 1e-3
        )
        (_, found), (clock,) = set_clocks([hand(0.0, lambda s, k=seed: motion(s, 100 + k)), late], by_motion=True)
        assert clock.method == "motion"
        worst_s.append(true_s(late, found))
    assert max(worst_s) < 0.008
    fitted = 0
    for seed in range(200, 500):
        pair = [hand(0.0, lambda s, k=seed: motion(s, k)), tracker(moves=lambda s, k=seed: motion(s, 300 + k))]
        fitted += set_clocks(pair, by_motion=True)[1][0].method == "motion"
    assert fitted == 0


def periodic(seconds):
    return np.sin(6.28 * 0.7 * seconds[:, None] + np.array([0.0, 0.0, 0.0])) * [1.0, 0.5, 0.2]


def still(seconds):
    return np.zeros((len(seconds), 3))


@pytest.mark.parametrize(
    ("hand_moves", "pose_moves", "words"),
    [
        (periodic, periodic, "periodic"),
        (still, still, "still"),
        (motion, lambda s: motion(s, 8), "no common motion"),
    ],
)
def test_what_does_not_tell_leaves_the_stamps_and_says_why(hand_moves, pose_moves, words):
    late = tracker(0.2, moves=pose_moves)
    (_, found), (clock,) = set_clocks([hand(0.0, hand_moves), late], by_motion=True)
    assert clock.method == "stamps"
    assert words in clock.reason
    assert (clock.offset_s, clock.drift_ppm) == (0.0, 0.0)
    assert np.array_equal(found.time_ns, late.time_ns)


def test_a_clock_that_steps_in_the_middle_is_refused():
    late = tracker()
    stepped = replace(late, time_ns=late.time_ns + np.where(np.arange(len(late.time_ns)) > 450, 400_000_000, 0))
    _, (clock,) = set_clocks([hand(0.0), stepped], by_motion=True)
    assert clock.method == "stamps"
    assert "windows disagree" in clock.reason


def device_stream(device_s):
    """A tracker heard with a jitter of up to 20 ms, 5 ms late at least, that reports its own clock."""
    late = tracker(noise_m=0.0)
    rng = np.random.default_rng(2)
    heard = late.time_ns + np.round(rng.uniform(5e6, 25e6, len(late.time_ns))).astype(np.int64)
    return replace(late, time_ns=heard, device_time_ns=np.round(device_s * 1e9).astype(np.int64)), late.time_ns


def test_a_devices_own_clock_takes_off_jitter_and_drift():
    time_s = np.arange(0, 60.0, 1 / POSE_HZ)
    stream, sent_ns = device_stream(12.0 + time_s * (1 + 100e-6))
    (_, found), (clock,) = set_clocks([hand(0.0), stream], by_motion=True)
    assert clock.method == "device_clock"
    assert clock.drift_ppm == pytest.approx(100, abs=30)  # 20 ms of jitter over a minute
    off_s = (found.time_ns - sent_ns) * 1e-9
    assert off_s.std() < 0.001
    assert off_s.mean() == pytest.approx(0.005, abs=0.003)
    assert "by its own clock" in clock_notes([clock])[0]


def test_a_devices_clock_that_steps_back_is_found_and_motion_tells_instead():
    time_s = np.arange(0, 60.0, 1 / POSE_HZ)
    stream, _ = device_stream(np.where(time_s > 30, time_s - 20, time_s))
    _, (clock,) = set_clocks([hand(0.0), stream], by_motion=True)
    assert clock.method == "motion"
    _, (clock,) = set_clocks([hand(0.0, still), stream], by_motion=True)
    assert clock.method == "stamps"
    assert "steps back 1 times, first at frame 451" in clock.reason


@pytest.mark.parametrize(
    ("device_s", "words"),
    [
        (lambda s: np.floor(s), "coarse"),
        (lambda s: s + 0.4 * (s > 30), "steps or wanders"),
        (lambda s: 1000 * s, "another unit"),
    ],
)
def test_a_devices_clock_that_would_mislead_is_refused_and_the_stamps_stay(device_s, words):
    stream, _ = device_stream(device_s(np.arange(0, 60.0, 1 / POSE_HZ)))
    (_, found), (clock,) = set_clocks([hand(0.0), stream], by_motion=False)
    assert clock.method == "stamps"
    assert words in clock.reason
    assert np.array_equal(found.time_ns, stream.time_ns)


def test_jitter_of_arrival_makes_no_gap_where_a_device_has_a_clock_and_a_lost_frame_does():
    log = make_log(10.0)
    time_s = np.delete(np.arange(0, 10.0, 1 / 200), [1000, 1001])
    delay_s = np.random.default_rng(4).exponential(0.004, len(time_s))
    heard_ns = stamps(np.maximum.accumulate(time_s + delay_s))
    values = np.sin(time_s)[:, None]
    arm = RecordedStream("joint_position", ("w0",), heard_ns, values, "/arm", np.round(time_s * 1e9).astype(np.int64))
    plain = import_log("run.mcap", log, RECIPE, [beside(arm)])
    (clock,) = plain.episode.meta.alignment.streams
    assert (clock.stream, clock.method) == ("/arm", "device_clock")
    at_s = (plain.episode["time_ns"] - START) * 1e-9
    invalid_s = at_s[~plain.episode.valid("joint_position")]
    assert 1 <= len(invalid_s) <= 2
    assert np.abs(invalid_s - 5.0).max() < 0.02
    by_stamps = import_log("run.mcap", log, RECIPE.model_copy(update={"align": "stamps"}), [beside(arm)])
    assert by_stamps.episode.meta.alignment.streams == ()
    assert by_stamps.digest != plain.digest
    assert (~by_stamps.episode.valid("joint_position")).sum() > 50


def test_an_import_by_clocks_keeps_how_and_bridges_no_gap_of_the_poses():
    seconds = 30.0
    log = make_log(seconds)
    log = replace(log, joint_position=motion((log.state_time_ns - START) * 1e-9))
    late = tracker(0.25, span_s=seconds)
    keep = np.ones(len(late.time_ns), bool)
    keep[300:306] = False  # six frames of 15 Hz
    poses = replace(late, time_ns=late.time_ns[keep], values=late.values[keep])
    imported = import_log("run.mcap", log, RECIPE.model_copy(update={"align": "clocks"}), [beside(poses)])
    episode = imported.episode
    (clock,) = episode.meta.alignment.streams
    assert (clock.method, clock.stream) == ("motion", "poses")
    at_s = (episode["time_ns"] - START) * 1e-9
    valid = episode.valid("object_pose")
    gap = (at_s > 299 / POSE_HZ + 0.01) & (at_s < 306 / POSE_HZ - 0.01)
    assert not valid[gap].any()
    assert valid[~((at_s > 298.5 / POSE_HZ) & (at_s < 306.5 / POSE_HZ))].all()
    truth = 0.05 * motion(at_s)
    assert np.abs(episode["object_pose"][valid, :3] - truth[valid]).max() < 0.01
    assert any(note.startswith("clock of poses: late by +2") for note in imported.notes)

    plain = import_log("run.mcap", log, RECIPE, [beside(poses)])
    assert plain.episode.meta.alignment.streams == ()
    assert plain.digest != imported.digest
