"""Poses of a tracker: slower, late, drifting, lost at times; and scenes without one are as they were."""

from __future__ import annotations

import numpy as np
import pytest

from candata.scenes import load_scene
from candata.schema.scene import Noise, Tracker
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.simulate.tracker import tracked_pose

RATE_HZ = 50.0


def moving_pose(rows):
    """A pose whose x is the row it belongs to, which does not turn."""
    return np.c_[np.arange(rows), np.zeros((rows, 2)), np.ones(rows), np.zeros((rows, 3))].astype(float)


def tracked(rows=400, seed=0, **settings):
    return tracked_pose(moving_pose(rows), Tracker(**settings), RATE_HZ, np.random.default_rng(seed))


@pytest.mark.parametrize("rate_hz", [7.0, 15.0, 30.0])
def test_a_slow_tracker_holds_what_it_read_and_is_never_late(rate_hz):
    pose, valid = tracked(rate_hz=rate_hz)
    captured = pose[:, 0]
    new_rows = 1 + np.flatnonzero(np.diff(captured))
    assert valid.all()
    assert np.array_equal(captured[new_rows], new_rows)  # read in the row in which it is new
    assert len(new_rows) == pytest.approx(400 * rate_hz / RATE_HZ, abs=1)
    assert np.ptp(np.diff(new_rows)) <= 1


def test_a_tracker_as_fast_as_the_log_changes_nothing():
    assert np.array_equal(tracked(rate_hz=50.0)[0], moving_pose(400))


def test_a_delay_shifts_the_readings_by_whole_rows():
    prompt, _ = tracked(rate_hz=10.0)
    late, _ = tracked(rate_hz=10.0, delay_s=0.06)
    assert np.array_equal(late[3:, 0], prompt[:-3, 0])
    assert (late[:3, 0] == 0).all()


def test_a_drift_grows_with_the_root_of_the_time():
    rows = 100
    still = np.tile([0.0, 0, 0, 1, 0, 0, 0], (rows, 1))
    tracker = Tracker(rate_hz=50.0, drift=(0.01, 0.05))
    ends = np.array([tracked_pose(still, tracker, RATE_HZ, np.random.default_rng(k))[0] for k in range(200)])
    turn = 2 * np.arccos(np.clip(np.abs(ends[..., 3]), 0, 1)) / np.sqrt(3)  # rms of a component, small angles
    for row in (24, 99):
        root_s = np.sqrt((row + 1) / RATE_HZ)
        # a standard deviation from 600 numbers is known to 3 %
        assert ends[:, row, :3].std() == pytest.approx(0.01 * root_s, rel=0.12)
        assert np.sqrt((turn[:, row] ** 2).mean()) == pytest.approx(0.05 * root_s, rel=0.12)


def test_drop_outs_have_their_share_and_length_and_hold_no_pose():
    pose, valid = tracked(rows=40_000, rate_hz=25.0, dropout_share=0.2, dropout_s=0.4)
    starts = np.flatnonzero(np.diff(valid.astype(int)) == -1)
    # some 400 drop-outs: their mean length is known to a twentieth
    assert 1 - valid.mean() == pytest.approx(0.2, rel=0.15)
    assert (~valid).sum() / len(starts) / RATE_HZ == pytest.approx(0.4, rel=0.15)
    assert np.isnan(pose[~valid]).all()
    assert np.isfinite(pose[valid]).all()


def test_an_episode_says_where_its_pose_was_lost_and_all_else_is_as_without():
    scene, job = load_scene("gripper_tabletop"), EpisodeJob("e", 0, "squeeze", 1)
    tracker = Tracker(rate_hz=15.0, dropout_share=0.3)
    noise = scene.file.noise
    (plain,) = make_episodes(scene, [job], duration_s=1.0, noise=noise)
    (held,) = make_episodes(scene, [job], duration_s=1.0, noise=noise.model_copy(update={"tracker": tracker}))
    valid = held["object_pose_valid"]
    assert 0 < valid.sum() < len(valid)
    assert held.meta.invalid_counts == {"object_pose": (~valid).sum()}
    assert all(np.array_equal(plain[name], held[name]) for name in plain.arrays if name != "object_pose")
    known = {tuple(pose) for pose in plain["object_pose"]}
    assert {tuple(pose) for pose in held["object_pose"][valid]} < known  # noise of a reading, not of a row


def test_a_scene_without_a_tracker_says_nothing_of_it():
    assert "tracker" not in Noise(object_pose=(0.001, 0.01)).model_dump_json()
    assert Noise.model_validate({"tracker": {"rate_hz": 15}}).tracker == Tracker(rate_hz=15.0)


@pytest.mark.parametrize("wrong", [{"rate_hz": 0}, {"rate_hz": 15, "delay_s": -1}, {"rate_hz": 15, "dropout_share": 1}])
def test_impossible_trackers_are_refused(wrong):
    with pytest.raises(ValueError, match="tracker"):
        Noise.model_validate({"tracker": wrong})
