"""What carries the hand: an arm follows a path in space by its own kinematics, rails as they always did."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from candata.errors import ReachError
from candata.policies import _drive as drive
from candata.policies import policy
from candata.policies._carrier import MOST_OFF_M, carrier
from candata.policies._chain import HAND_M, NEAR_M
from candata.policies._postures import along, blend, finish
from candata.rotation import difference, exp
from candata.scenes import load_scene
from candata.scenes.assemble import assemble
from candata.scenes.contract import ARMS
from candata.scenes.library import xarm7_xhand
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.policies.unknown_hands import JAWS, JAWS_ROLES, write

ROWS = 60


@pytest.fixture(scope="module")
def arm():
    return load_scene("xarm7_xhand")


def hand_poses(scene, commands: np.ndarray, body: str = "palm") -> tuple[np.ndarray, np.ndarray]:
    """Mean of the fingertips `(T, 3)` [m] and the turn of the palm `(T, 4)`, by MuJoCo, where the servos rest."""
    data, tips, palm = mujoco.MjData(scene.model), [], []
    for row in commands:
        data.qpos[:] = drive.start_qpos(scene, row)
        mujoco.mj_kinematics(scene.model, data)
        tips.append(data.xpos[scene.fingertip_bodies].mean(0))
        palm.append(data.body(body).xquat.copy())
    return np.array(tips), np.array(palm)


def way(target: list[float]) -> np.ndarray:
    """A smooth path to a displacement and back again."""
    t = np.arange(ROWS) / ROWS
    return (blend(t, 0.05, 0.4) - blend(t, 0.5, 0.4))[:, None] * np.array(target)


@pytest.mark.parametrize(
    "target",
    [[0, 0, 0.15, 0, 0, 0], [-0.1, 0.12, 0.05, 0, 0, 0], [0, 0, 0.1, 0, 0.4, 0], [-0.05, 0, 0.08, 0.3, -0.3, 0.5]],
    ids=["up", "across", "tipped", "all at once"],
)
def test_the_hand_goes_where_its_path_says(arm, target):
    hand, path = carrier(arm), way(target)
    tips, palm = hand_poses(arm, hand.commands(hand.start, path))
    (start_tips,), (start_palm,) = hand_poses(arm, hand.start[None])
    # The search ends within 0.1 mm, and 0.1 mm over the length of a hand.
    assert np.abs(tips - start_tips - path[:, :3]).max() < NEAR_M
    assert np.abs(difference(palm, np.broadcast_to(start_palm, palm.shape)) - path[:, 3:]).max() < NEAR_M / HAND_M


def test_a_hand_that_comes_back_has_its_posture_back_and_never_jumps(arm):
    hand, path = carrier(arm), way([-0.1, 0.1, 0.1, 0.2, 0.2, -0.3])
    commands = hand.commands(hand.start, path)
    assert np.allclose(commands[0], hand.start)
    assert np.allclose(commands[-1], hand.start)
    assert np.allclose(np.delete(commands, hand.columns, axis=1), np.delete(hand.start, hand.columns))
    # A joint has a lever arm of 0.1 m at least: it turns by 10 rad for a metre, and one for a radian.
    step = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1) + np.linalg.norm(np.diff(path[:, 3:], axis=0), axis=1)
    assert (np.abs(np.diff(commands, axis=0)).max(1) <= 10 * step + 1e-9).all()


def test_an_arm_carries_a_hand_from_another_base_too(arm):
    """The path is about where the hand is, not where it began."""
    hand = carrier(arm)
    raised = hand.commands(hand.start, np.array([[0, 0, 0.1, 0, 0, 0]]))[0]
    (before,), _ = hand_poses(arm, raised[None])
    tips, _ = hand_poses(arm, hand.commands(raised, way([0, 0.1, 0, 0, 0, 0])))
    assert np.abs(tips - before - way([0, 0.1, 0, 0, 0, 0])[:, :3]).max() < NEAR_M


def test_a_path_out_of_reach_is_refused_with_how_far_off_and_when(arm):
    hand = carrier(arm)
    with pytest.raises(ReachError, match="cannot follow its path") as caught:
        hand.commands(hand.start, way([0, 0, 1.2, 0, 0, 0]))
    text = str(caught.value)
    assert "within 10 mm and 5 degrees" in text
    assert "mm and" in text
    assert "degrees off after 0." in text
    with pytest.raises(ReachError):
        finish(arm, np.repeat(hand.start[None], ROWS, axis=0), np.random.default_rng(0), path=way([0, 0, 1.2, 0, 0, 0]))


def test_a_joint_at_the_end_of_its_range_is_named():
    spec = xarm7_xhand.build()
    for number, start in enumerate(ARMS.load("xarm7").start[:4], 1):
        name = f"joint{number}"
        spec.joint(name).range = spec.actuator(name).ctrlrange = (start - 0.02, start + 0.02)
    scene = assemble("narrow", xarm7_xhand.SCENE.file, spec)
    with pytest.raises(ReachError, match="joint4 at the end of the range"):
        carrier(scene).commands(carrier(scene).start, way([0, 0, 0.15, 0, 0, 0]))


def test_an_arm_lifts_moves_away_and_strokes_as_the_rails_in_its_place_do(arm):
    rails, hand = carrier(load_scene("xhand_tabletop")), carrier(arm)
    assert hand.reach.all()
    assert rails.reach.tolist() == [True] * 3 + [False] * 3
    for role in ("lift", "away", "stroke"):
        assert np.allclose(getattr(hand, role), getattr(rails, role))
    assert hand.sideways
    assert rails.sideways


def test_rails_move_by_what_is_asked_along_them():
    scene = load_scene("gripper_tabletop")
    hand, path = carrier(scene), way([0.05, 0.2, 0.1, 0, 0, 0])
    commands = hand.commands(hand.start, path)
    assert hand.columns.tolist() == [0, 1]
    assert np.array_equal(commands[:, :2], hand.start[:2] + path[:, [0, 2]]), "nothing moves it across"
    assert (commands[:, 2:] == hand.start[2:]).all()


def test_a_rail_and_a_wrist_hinge_share_a_path(tmp_path):
    turned = JAWS.replace('<geom type="box" size=".06', '<joint name="roll" axis="0 0 1"/><geom type="box" size=".06')
    turned = turned.replace("<position ", '<position name="roll" joint="roll" kp="5" kv=".2"/><position ')
    scene = write(tmp_path, turned, JAWS_ROLES.replace("[jaws, lift]", "[jaws, lift, roll]"))
    hand, path = carrier(scene), way([0, 0, 0.05, 0, 0, 0.6])
    assert hand.reach.tolist() == [False, False, True, False, False, True]
    assert np.allclose(hand.commands(hand.start, path)[:, 1:], path[:, [2, 5]] * [-1, 1], atol=NEAR_M / HAND_M)
    with pytest.raises(ReachError):
        hand.commands(hand.start, way([0.05, 0, 0, 0, 0, 0]))


def test_command_noise_moves_a_hand_on_an_arm_by_millimetres(arm):
    still = np.repeat(carrier(arm).start[None], 200, axis=0)
    noisy = finish(arm, still, np.random.default_rng(4)).commands
    tips, palm = hand_poses(arm, noisy)
    rest, turn = hand_poses(arm, still[:1])
    off = np.linalg.norm(tips - rest, axis=1)
    # 2 mm and 4 mrad (1 sd) in all; 0.4 % of the joints' ranges would be 50 mrad, and centimetres.
    assert 0.0005 < off.std() + off.mean() < 0.006
    assert off.max() < MOST_OFF_M
    assert np.linalg.norm(difference(palm, np.broadcast_to(turn[0], palm.shape)), axis=1).max() < 0.02


def test_the_hand_on_an_arm_grasps_lifts_and_touches_the_table_with_no_link(arm):
    jobs = [EpisodeJob(f"g{i}", i, "grasp_lift_shake", 11) for i in range(3)]
    for e in make_episodes(arm, jobs, duration_s=3.2):
        held = e["object_pose"][:, 2] - e["object_pose"][0, 2]
        assert held.max() > 0.05
        assert held[e["fingertip_contact"].sum(1) >= 2].max() > 0.05, "by the fingers"
        assert np.abs(e["joint_position"][:, :7] - e["action"][:, :7]).max() < 0.1, "the arm follows [rad]"


def test_every_variant_is_within_the_reach_of_the_arm(arm):
    low, high = drive.command_range(arm).T
    for name in arm.policies:
        for variant in policy(name).variants:
            plan = variant.plan(arm, np.random.default_rng(1), 2.0)
            assert ((low <= plan.commands) & (plan.commands <= high)).all(), variant.words


def test_a_plan_without_a_path_leaves_the_arm_where_it_is(arm):
    plan = policy("roll").plan(arm, np.random.default_rng(1), 1.0)
    moved = np.abs(plan.commands[:, :7] - carrier(arm).start[:7]).max()
    assert moved < 0.01, "noise alone [rad]"


def test_a_direction_that_nothing_can_go_gives_a_still_path():
    assert not along(None, np.ones(4)).any()
    assert np.allclose(exp(along(np.array([0, 0, 1.0]), np.ones(4))[:, 3:])[:, 0], 1.0)
