"""Poses that jump out and back are left out; bounces, spins and noise are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.faults import without_spikes
from candata.gap.data.recordings import recordings
from candata.rotation import exp
from candata.schema.episode import Episode


def flying(rows=100, spin=0.0):
    """Two episodes of an object that is thrown at 1 m/s and turns, at 100 Hz."""
    t = np.arange(rows) / 100
    position = np.stack([t, 0 * t, 1 + t - 4.9 * t**2], axis=1)
    turn = exp(np.stack([0 * t, 0 * t, spin * t], axis=1))
    return np.tile(np.concatenate([position, turn], axis=1), (2, 1, 1))


def left_out(poses):
    found, notes = without_spikes(poses)
    assert bool(notes) == bool(np.isnan(found).sum() > np.isnan(poses).sum())
    return [tuple(at) for at in np.argwhere(np.isnan(found).any(2) & np.isfinite(poses).all(2))]


def test_a_pose_that_jumps_out_and_back_is_left_out():
    poses = flying()
    poses[1, 40, 0] += 0.03
    found, notes = without_spikes(poses)
    assert left_out(poses) == [(1, 40)]
    assert np.isnan(found[1, 40]).all()
    assert notes == ("object_pose: 1 of 200 poses jump out for one row and back, and are left out",)


def test_so_is_a_rotation_that_does():
    poses = flying(spin=3.0)
    poses[0, 30, 3:] = exp(np.array([0.8, 0.0, 0.9]))
    assert left_out(poses) == [(0, 30)]


@pytest.mark.parametrize("spin", [0.0, 6.0])
def test_flight_and_spin_go_on(spin):
    assert left_out(flying(spin=spin)) == []


def test_a_rest_half_a_turn_from_the_start_is_no_spike():
    """Half a turn may be told either way round: 0.01 rad of noise changes which."""
    poses = flying()
    off = np.zeros(100)
    off[[40, 60, 61]] = 0.02
    poses[:, 20:, 3:] = exp(np.stack([np.zeros(100), np.zeros(100), np.pi - 0.01 + off], axis=1))[20:]
    assert left_out(poses) == []


def test_a_bounce_goes_on_from_there():
    poses = flying()
    height = np.abs(np.arange(100) / 100 - 0.5) * 2.0
    poses[..., 2] = height
    assert left_out(poses) == []


def test_a_step_for_good_is_no_spike():
    poses = flying()
    poses[0, 50:, 0] += 0.05
    assert left_out(poses) == []


def test_noise_is_no_spike(rng):
    poses = flying()
    poses[..., :3] += 0.003 * rng.standard_normal((2, 100, 3))
    assert left_out(poses) == []


def test_missing_poses_stay_missing_and_hide_their_neighbours():
    poses = flying()
    poses[0, 20:25] = np.nan
    poses[0, 25, 0] += 0.05
    assert left_out(poses) == []
    assert np.isnan(without_spikes(poses)[0]).any(2).sum() == 5
    assert left_out(np.full((2, 100, 7), np.nan)) == []
    assert left_out(flying(rows=4)) == []


def test_recordings_leave_them_out_and_say_so(cube, played):
    episodes = played(cube, count=2, duration_s=0.5)
    pose = np.array(episodes[0]["object_pose"])
    pose[10, 1] += 0.1
    episodes[0] = replace(episodes[0], arrays={**episodes[0].arrays, "object_pose": pose})
    recs = recordings(cube, episodes)
    assert np.argwhere(np.isnan(recs.readings["object_pose"][..., 0])).tolist() == [[0, 10]]
    assert any("jump out for one row and back" in note for note in recs.notes)


def test_a_misread_encoder_is_left_out_too(arm, arm_episodes):
    """One row half a turn away; what a joint does when it is stopped is no spike."""
    clean = arm_episodes(count=2)
    joints = np.array(clean[1]["joint_position"])
    joints[70, 1] -= 3.14
    joints[100:, 0] = joints[100, 0]
    broken = Episode(clean[1].meta, {**clean[1].arrays, "joint_position": joints})
    found = recordings(arm, [clean[0], broken])
    assert np.argwhere(np.isnan(found.readings["joint_position"])).tolist() == [[1, 70, 1]]
    assert "joint_position of elbow jumps out for one row and back 1 times: left out" in found.notes
