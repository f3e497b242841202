"""Residuals: recorded minus replayed, averaged over blocks, rotations in the tangent space, by phase."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import starts
from candata.rotation import exp, multiply

#: Rows of a 50 ms block at the arm's 100 Hz and the hand's 80 Hz.
ARM_BLOCK, HAND_BLOCK = 5, 4


@pytest.fixture
def arm_case(arm, plain_recordings):
    """Recordings of two episodes of the arm whose replay reads zero, their layout, and that replay."""

    def make(values: np.ndarray, lengths=None):
        recs = plain_recordings(commands=np.zeros_like(values), joint_position=values, lengths=lengths)
        still = {"joint_position": np.zeros_like(values), "touch": np.zeros(values.shape[:2])}
        return recs, layout(arm, recs, starts(arm, recs), still), still

    return make


def hand_case(hand, plain_recordings, force: np.ndarray, touch: np.ndarray | None = None):
    """Recordings of the hand with given forces `(E, T, F, 3)`, and their layout."""
    shape = force.shape[:2]
    joints = np.zeros((*shape, len(hand.file.joints)))
    pose = np.tile(hand.model.qpos0[hand.object_qpos : hand.object_qpos + 7], (*shape, 1))
    recs = plain_recordings(commands=joints, joint_position=joints, object_pose=pose, fingertip_force=force)
    nominal = {"touch": np.zeros(shape) if touch is None else touch}
    return recs, layout(hand, recs, starts(hand, recs), nominal)


def forces(rows: int, tip: int = 2, begin: int = 16, end: int = 48) -> np.ndarray:
    """Two newtons on one fingertip from one row to another `(1, rows, 5, 3)`."""
    force = np.zeros((1, rows, 5, 3))
    force[0, begin:end, tip, 2] = 2.0
    return force


def named(plan) -> list[str]:
    return [plan.phases[p] if p >= 0 else "-" for p in plan.phase[0]]


def test_a_residual_is_the_mean_of_recorded_minus_replayed_over_50_ms(arm_case, rng):
    values = rng.standard_normal((2, 23, 2))
    recs, plan, still = arm_case(values)
    found = residual(recs, plan, still)
    # 23 rows are four blocks; the three rows left over are not used.
    assert found.shape == (2, 4, 2)
    np.testing.assert_allclose(found, values[:, :20].reshape(2, 4, ARM_BLOCK, 2).mean(2), atol=1e-15)
    moved = {"joint_position": still["joint_position"] + 0.25}
    np.testing.assert_allclose(residual(recs, plan, moved), found - 0.25, atol=1e-15)


def test_a_block_counts_when_half_of_it_was_seen(arm_case):
    values = np.tile(np.arange(20.0)[:, None], (1, 1, 2))
    values[0, 1:3, 0] = np.nan  # three rows of five are left: 0, 3, 4
    values[0, 6:9, 0] = np.nan  # two are left
    recs, plan, still = arm_case(values)
    found = residual(recs, plan, still)[0]
    assert found[0, 0] == pytest.approx(7 / 3)
    assert np.isnan(found[1, 0])
    assert np.isfinite(found[:, 1]).all()


def test_a_replay_that_has_not_begun_counts_as_not_seen(arm_case):
    recs, plan, still = arm_case(np.ones((1, 20, 2)))
    still["joint_position"][0, :5] = np.nan
    assert np.isnan(residual(recs, plan, still)[0, 0]).all()
    assert np.isfinite(residual(recs, plan, still)[0, 1:]).all()


def test_rows_after_an_episode_s_end_are_in_no_phase(arm_case):
    values = np.ones((2, 20, 2))
    values[0, 12:] = np.nan
    recs, plan, still = arm_case(values, lengths=[12, 20])
    assert (plan.phase >= 0).tolist() == [[True, True, False, False], [True] * 4]
    assert np.isnan(residual(recs, plan, still)[0, 2:]).all()


def test_columns_name_channel_element_and_unit(hand, plain_recordings):
    _, plan = hand_case(hand, plain_recordings, forces(64))
    kinds = hand.model.jnt_type[hand.joint_ids]
    units = {name: "m" if kind == 2 else "rad" for name, kind in zip(hand.file.joints, kinds, strict=True)}
    assert set(units.values()) == {"m", "rad"}
    count = len(hand.file.joints)
    assert plan.columns[:count] == tuple(("joint_position", j, u) for j, u in units.items())
    assert plan.columns[count] == ("object_pose", "position x", "m")
    assert plan.columns[count + 5] == ("object_pose", "rotation z", "rad")
    assert plan.columns[count + 6 :][:3] == tuple(
        ("fingertip_force", f"{hand.file.fingertips[0]} {a}", "N") for a in "xyz"
    )


@pytest.mark.parametrize("turn", [(0.3, 0.0, 0.0), (0.0, -0.2, 0.1), (1.0, 2.0, -0.5)])
def test_a_turn_is_its_rotation_vector_in_the_world(hand, plain_recordings, turn):
    recs, plan = hand_case(hand, plain_recordings, forces(64))
    pose = recs.readings["object_pose"]
    attitude = exp(np.array([0.4, -0.7, 0.2]))
    replayed = np.concatenate([pose[..., :3], np.broadcast_to(attitude, pose[..., 3:].shape)], -1)
    recorded = replayed.copy()
    recorded[..., 3:] = multiply(exp(np.array(turn)), attitude)
    recorded[..., :3] += [0.01, 0.02, 0.03]
    other = replace(recs, readings=recs.readings | {"object_pose": recorded})
    found = residual(other, plan, recs.readings | {"object_pose": replayed})
    at = len(hand.file.joints)
    np.testing.assert_allclose(found[0, :, at : at + 3], np.tile([0.01, 0.02, 0.03], (16, 1)), atol=1e-12)
    np.testing.assert_allclose(found[0, :, at + 3 : at + 6], np.tile(turn, (16, 1)), atol=1e-12)


def test_a_quaternion_and_its_opposite_are_one_attitude(hand, plain_recordings):
    recs, plan = hand_case(hand, plain_recordings, forces(64))
    flipped = recs.readings["object_pose"] * np.array([1, 1, 1, -1, -1, -1, -1])
    found = residual(recs, plan, recs.readings | {"object_pose": flipped})
    assert np.abs(found).max() < 1e-12


def test_the_force_of_row_0_belongs_to_no_step(hand, plain_recordings):
    recs, plan = hand_case(hand, plain_recordings, forces(64))
    replayed = recs.readings | {"fingertip_force": recs.readings["fingertip_force"].copy()}
    replayed["fingertip_force"][:, 0] = 100.0
    assert not residual(recs, plan, replayed).any()


def test_phases_follow_the_recorded_contact(hand, plain_recordings):
    # Contact in rows 16 to 47 of 80 Hz: onset is its first 100 ms (8 rows), release the 100 ms around its end.
    _, plan = hand_case(hand, plain_recordings, forces(64))
    expected = ["free"] * 4 + ["onset"] * 2 + ["sustained"] * 5 + ["release"] * 2 + ["free"] * 3
    assert plan.rows == HAND_BLOCK
    assert named(plan) == expected


def test_a_fingertip_that_is_stuck_on_tells_nothing_about_phases(hand, plain_recordings):
    plain, stuck = forces(64), forces(64)
    stuck[0, :, 0, 0] = 1.0
    touch = (plain[0, :, 2, 2] > 0)[None].astype(float)
    _, expected = hand_case(hand, plain_recordings, plain, touch)
    _, plan = hand_case(hand, plain_recordings, stuck, touch)
    assert np.array_equal(plan.phase, expected.phase)


def test_simulated_contact_decides_where_all_fingertips_are_stuck(hand, plain_recordings):
    touch = np.zeros((1, 64))
    touch[0, 16:48] = 1
    _, expected = hand_case(hand, plain_recordings, forces(64), touch)
    _, plan = hand_case(hand, plain_recordings, forces(64) + 0.5, touch)
    assert np.array_equal(plan.phase, expected.phase)


def test_a_toss_flies_strikes_and_rests(cube, played):
    recs = recordings(cube, played(cube, count=4, duration_s=0.8, noise=False))
    begin = starts(cube, recs)
    plan = layout(cube, recs, begin, {})
    assert plan.rows == 7  # 50 ms at 148 Hz
    order = {"-": -1, "flight": 0, "impact": 1, "rest": 2}
    for e in range(len(recs)):
        codes = plan.phase[e]
        first = -(-int(begin.rows[e]) // plan.rows)
        assert (codes[:first] == -1).all()
        assert (codes[first:] >= 0).all()
        assert (np.diff(codes) >= 0).all()
        assert codes.max() >= order["impact"]


def test_a_cube_at_rest_is_at_rest(cube, plain_recordings):
    t = np.arange(140) / cube.file.rate_hz
    height = np.maximum(0.2 - 0.5 * 9.81 * t**2, 0.0524)
    pose = np.concatenate([np.zeros((140, 2)), height[:, None], np.tile([1.0, 0, 0, 0], (140, 1))], 1)[None]
    recs = plain_recordings(object_pose=pose)
    plan = layout(cube, recs, starts(cube, recs), {})
    landed = int(np.argmin(height))
    # The speed is taken over 50 ms, so rest is seen that much later.
    assert named(plan)[-1] == "rest"
    assert abs(named(plan).index("rest") - landed / plan.rows) <= 2
    assert "impact" in named(plan)
