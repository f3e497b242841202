"""Where replays start: the mean of a still start, the first row of a moving one, the flight before an impact."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.replay.hand_starts import STILL_ROWS
from candata.gap.replay.starts import ROWS_BEFORE, reach, starts
from candata.policies import policy
from candata.rotation import difference, exp, multiply
from candata.scenes import load_scene
from candata.scenes.traits import is_toss, support_height

NOISE = 1e-3
#: Start of the cube's flight: position [m], velocity [m/s], body-frame spin [rad/s].
POSITION, VELOCITY, SPIN = np.array([0.1, -0.2, 0.21]), np.array([1.0, -0.4, 0.1]), np.array([2.0, -3.0, 5.0])
ATTITUDE = exp(np.array([0.3, 0.8, -0.5]))
#: A body with `explicitinertial` and no `ipos` gets the body's own place as its centre of mass.


def noisy(rng: np.random.Generator, count: int, rows: int = 20) -> np.ndarray:
    return 0.3 + NOISE * rng.standard_normal((count, rows, 2))


def flight(scene, rows: int) -> np.ndarray:
    """A parabola with a constant spin `(1, rows, 7)`, in closed form."""
    t = np.arange(rows)[:, None] / scene.file.rate_hz
    position = POSITION + VELOCITY * t + 0.5 * np.array(scene.model.opt.gravity) * t**2
    return np.concatenate([position, multiply(np.broadcast_to(ATTITUDE, (rows, 4)), exp(SPIN * t))], axis=1)[None]


def resting_pose(scene) -> np.ndarray:
    return np.array(scene.model.qpos0[scene.object_qpos : scene.object_qpos + 7], float)


def hand_recordings(hand, plain_recordings, pose: np.ndarray):
    joints = np.zeros((*pose.shape[:2], len(hand.file.joints)))
    return plain_recordings(commands=joints, joint_position=joints, object_pose=pose)


def test_a_still_start_is_averaged(arm, plain_recordings, rng):
    found = starts(arm, plain_recordings(joint_position=noisy(rng, 1000))).qpos
    # The mean of 8 rows keeps 1 / sqrt(8) = 0.354 of the noise; a few starts that look like a trend by chance keep
    # all of it, which lifts the whole to 0.38. The standard deviation of 2000 values is known to 1.6 %.
    assert 0.34 * NOISE < (found - 0.3).std() < 0.42 * NOISE
    assert abs((found - 0.3).mean()) < 5 * NOISE / np.sqrt(8 * 2000)


def test_rows_after_the_first_few_do_not_count(arm, plain_recordings, rng):
    rows = noisy(rng, 4)
    moved = rows.copy()
    moved[:, STILL_ROWS:] += 1.0
    assert np.array_equal(
        *(starts(arm, plain_recordings(joint_position=r)).qpos[:, arm.joint_qpos] for r in (rows, moved))
    )


def test_what_rises_from_rest_starts_where_its_first_row_was(arm, plain_recordings, rng):
    rows = noisy(rng, 500) + 2 * NOISE * np.arange(20)[:, None] ** 2
    found = starts(arm, plain_recordings(joint_position=rows)).qpos[:, arm.joint_qpos]
    # Three terms through eight rows keep 0.7 of the noise; the mean of the rows would be 35 times it off.
    assert abs((found - 0.3).mean()) < 0.1 * NOISE
    assert (found - 0.3).std() < 0.8 * NOISE


def test_a_start_that_was_not_recorded_is_the_model_s(arm, plain_recordings):
    rows = np.full((1, 20, 2), np.nan)
    found = starts(arm, plain_recordings(joint_position=rows))
    assert np.array_equal(found.qpos[0], arm.model.qpos0)
    assert not found.qvel.any()


def test_a_still_object_s_pose_is_averaged(hand, plain_recordings, rng):
    pose, count, size = resting_pose(hand), 300, 0.01
    shift = NOISE * rng.standard_normal((count, 20, 3))
    turn = multiply(exp(size * rng.standard_normal((count, 20, 3))), np.broadcast_to(pose[3:], (count, 20, 4)))
    at = hand.object_qpos
    found = starts(hand, hand_recordings(hand, plain_recordings, np.concatenate([pose[:3] + shift, turn], -1))).qpos
    angle = difference(found[:, at + 3 : at + 7], np.broadcast_to(pose[3:], (count, 4)))
    # As for joints; 900 values are known to 2.4 %.
    assert 0.33 * NOISE < (found[:, at : at + 3] - pose[:3]).std() < 0.43 * NOISE
    assert 0.33 * size < angle.std() < 0.43 * size


def test_a_gap_in_the_first_poses_keeps_the_recorded_place(hand, plain_recordings):
    pose = np.tile(resting_pose(hand), (1, 20, 1))
    pose[..., :2] += 0.05
    pose[0, 3] = np.nan
    found = starts(hand, hand_recordings(hand, plain_recordings, pose)).qpos[0]
    np.testing.assert_allclose(found[hand.object_qpos : hand.object_qpos + 2], pose[0, 0, :2], atol=1e-9)


def test_a_gap_in_the_first_row_starts_at_the_next(arm, plain_recordings):
    rows = np.full((1, 20, 2), 0.3)
    rows[0, 0] = np.nan
    found = starts(arm, plain_recordings(joint_position=rows)).qpos[0]
    np.testing.assert_allclose(found[arm.joint_qpos], 0.3, atol=1e-9)


def test_an_object_without_actuators_is_a_toss(arm, hand, cube):
    assert [is_toss(s) for s in (arm, hand, cube)] == [False, False, True]


def test_the_cube_reaches_half_its_space_diagonal(cube):
    assert reach(cube) == pytest.approx(np.sqrt(3) * 0.1048 / 2, rel=1e-9)
    assert support_height(cube) == 0.0


def test_a_table_s_height_is_its_top(tmp_path):
    table = '<geom name="table" type="box" size=".3 .3 .02" pos="0 0 .4"/>'
    ball = '<body name="ball" pos="0 0 .6"><freejoint/><geom type="sphere" size=".03"/></body>'
    (tmp_path / "scene.xml").write_text(f"<mujoco><worldbody>{table}{ball}</worldbody></mujoco>")
    (tmp_path / "scene.yaml").write_text("model: scene.xml\nrate_hz: 100\nobject: ball\nsupport: table\n")
    scene = load_scene(tmp_path / "scene.yaml")
    assert support_height(scene) == pytest.approx(0.42)
    assert reach(scene) == pytest.approx(0.03)


def test_a_flight_is_fitted_exactly(cube, plain_recordings):
    rows = 40
    found = starts(cube, plain_recordings(object_pose=flight(cube, rows)))
    row = int(found.rows[0])
    for at, qpos, qvel in ((row, found.qpos[0], found.qvel[0]), (0, found.qpos0[0], found.qvel0[0])):
        t = at / cube.file.rate_hz
        # Least squares on exact data: rounding only.
        np.testing.assert_allclose(qpos[:3], flight(cube, rows)[0, at, :3], atol=1e-12)
        assert np.linalg.norm(difference(qpos[3:], flight(cube, rows)[0, at, 3:])) < 1e-9
        np.testing.assert_allclose(qvel[:3], VELOCITY + np.array(cube.model.opt.gravity) * t, atol=1e-9)
        np.testing.assert_allclose(qvel[3:], SPIN, atol=1e-9)


def test_a_toss_starts_three_rows_before_it_comes_within_reach(cube, plain_recordings):
    pose = flight(cube, 40)
    first = int(np.argmax(pose[0, :, 2] < reach(cube)))
    assert first > ROWS_BEFORE
    assert starts(cube, plain_recordings(object_pose=pose)).rows[0] == first - 3


def test_a_toss_that_begins_within_reach_starts_at_its_first_row(cube, plain_recordings):
    pose = flight(cube, 40)
    pose[..., 2] -= pose[0, 0, 2] - reach(cube) + 0.001
    assert starts(cube, plain_recordings(object_pose=pose)).rows[0] == 0


def test_what_follows_the_impact_does_not_change_the_start(cube, plain_recordings, rng):
    pose = flight(cube, 40)
    row = int(starts(cube, plain_recordings(object_pose=pose)).rows[0])
    other = pose.copy()
    other[0, row + ROWS_BEFORE + 1 :, :3] = [0.3, 0.3, 0.05]
    a, b = (starts(cube, plain_recordings(object_pose=p)) for p in (pose, other))
    assert np.array_equal(a.qpos, b.qpos)
    assert np.array_equal(a.qvel, b.qvel)


def test_a_gap_in_a_flight_does_not_spoil_its_start(cube, plain_recordings):
    pose = flight(cube, 40)
    whole = starts(cube, plain_recordings(object_pose=pose))
    pose[0, 2] = np.nan
    found = starts(cube, plain_recordings(object_pose=pose))
    # The rest of the flight is exact.
    np.testing.assert_allclose(found.qpos, whole.qpos, atol=1e-9)
    np.testing.assert_allclose(found.qvel, whole.qvel, atol=1e-9)


def test_averaging_takes_the_noise_out_of_a_flight(cube, plain_recordings, rng):
    pose = np.repeat(flight(cube, 40), 200, axis=0)
    pose[..., :3] += NOISE * rng.standard_normal(pose[..., :3].shape)
    found = starts(cube, plain_recordings(object_pose=pose))
    n = int(np.median(found.rows)) + 1
    # Slope of n equally spaced points: s f sqrt(12 / (n (n^2 - 1))); 600 values know it to 3 %, and the row
    # of the start wanders by one.
    expected = NOISE * cube.file.rate_hz * np.sqrt(12 / (n * (n**2 - 1)))
    assert found.qvel0[:, :3].std(0) == pytest.approx(expected, rel=0.2)


def test_a_simulated_flight_starts_as_it_was_thrown(cube, played):
    recs = recordings(cube, played(cube, count=6, duration_s=0.4, seed=3, noise=False))
    found = starts(cube, recs)
    plans = [policy("toss").plan(cube, np.random.default_rng([3, i, 0]), 0.4) for i in range(6)]
    # Semi-implicit Euler lags the parabola by g h / 2 in speed; readings are stored as float32.
    lag = 9.81 * cube.model.opt.timestep / 2
    np.testing.assert_allclose(found.qvel0, [p.qvel for p in plans], atol=lag + 1e-4)
    np.testing.assert_allclose(found.qpos0[:, :3], [p.qpos[:3] for p in plans], atol=1e-5)


def test_every_toss_starts_before_its_first_impact(cube, played):
    found = []
    for seed in (3, 4, 5):
        recs = recordings(cube, played(cube, count=12, duration_s=0.8, seed=seed, noise=False))
        found.append((recs.readings["object_pose"], starts(cube, recs).rows))
    pose, rows = np.concatenate([p for p, _ in found]), np.concatenate([r for _, r in found])
    # In flight the height has second differences of -g / f^2; a bounce changes the speed by far more than a tenth of
    # that of a fall from 1 cm.
    bend = np.diff(pose[..., 2], n=2, axis=1) * cube.file.rate_hz + 9.81 / cube.file.rate_hz
    impact = np.argmax(np.abs(bend) > 0.05, axis=1) + 1
    assert (rows <= impact).all()
