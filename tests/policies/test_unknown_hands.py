"""The policies play hands that candata does not know: they find the grasp, the rails and what a command means."""

from __future__ import annotations

import numpy as np
import pytest

from candata.policies import _drive as drive
from candata.policies import policy
from candata.policies._carrier import carrier
from candata.policies._grasp import grasp
from candata.policies._postures import postures
from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.policies.unknown_hands import FOUR_FINGERS, JAWS, JAWS_ROLES, without_keyframes, write


@pytest.fixture(scope="module")
def jaws(tmp_path_factory):
    return write(tmp_path_factory.mktemp("jaws"), JAWS, JAWS_ROLES)


def lifted(scene) -> list[float]:
    """How high two grasps raise the object, held by two fingertips or more [m]."""
    made = make_episodes(scene, [EpisodeJob(f"g{i}", i, "grasp_lift_shake", 11) for i in range(2)], duration_s=2.5)
    middle = slice(len(made[0]) // 2, 2 * len(made[0]) // 3)
    assert all((e["fingertip_contact"][middle].mean(0) > 0.8).sum() >= 2 for e in made)
    return [float(np.ptp(e["object_pose"][:, 2])) for e in made]


@pytest.mark.parametrize("scene", [without_keyframes, lambda: load_scene(FOUR_FINGERS)], ids=["xhand", "four fingers"])
def test_a_grasp_found_without_keyframes_lifts_the_object(scene):
    # The motion raises the rail by 4 to 7 cm, and shakes it: what slips stays below 3 cm.
    assert min(lifted(scene())) > 0.03


def test_a_grasp_found_for_jaws_on_a_tendon_lifts_the_object(jaws):
    assert min(lifted(jaws)) > 0.03


def test_a_tendons_id_is_not_a_joints(jaws):
    """The tendon has the id 0, as the rail's slide has: only the second column is the rail."""
    assert carrier(jaws).columns.tolist() == [1]
    assert np.allclose(drive.useful_range(jaws)[0], [0, 255])
    for name in jaws.policies or ("grasp_lift_shake", "free_sweep", "push", "roll", "squeeze"):
        plan = policy(name).plan(jaws, np.random.default_rng(2), 1.0)
        low, high = drive.command_range(jaws).T
        assert ((low <= plan.commands) & (plan.commands <= high)).all()
        assert np.allclose(plan.qpos[jaws.joint_qpos[1:]], 0), "what a tendon pulls is left to the settling"
        assert np.isclose(plan.qpos[jaws.joint_qpos[0]], plan.commands[0, 1])


def test_a_rail_that_points_down_lifts_by_going_back(jaws):
    assert carrier(jaws).lift == pytest.approx([0, 0, 1])
    assert carrier(jaws).reach.tolist() == [False, False, True, False, False, False]
    plan = policy("grasp_lift_shake").plan(jaws, np.random.default_rng(2), 2.5)
    assert plan.commands[:, 1].min() < -0.03
    assert plan.commands[:, 1].max() < 0.02, "only the shaking goes down"


def test_the_fingers_of_an_unknown_hand_sweep_free_of_the_object():
    scene = load_scene(FOUR_FINGERS)
    for e in make_episodes(scene, [EpisodeJob(f"s{i}", i, "free_sweep", 5) for i in range(2)], duration_s=2.0):
        assert not e["contact"].any()
        assert (e["action"][:, 1:].std(0) > 0.02).all(), "every joint moves, or its faults could not be seen"


def test_wrist_hinges_that_carry_the_whole_hand_do_not_grasp(tmp_path):
    turned = JAWS.replace('<geom type="box" size=".06', '<joint name="roll" axis="0 0 1"/><geom type="box" size=".06')
    turned = turned.replace("<position ", '<position name="roll" joint="roll" kp="5" kv=".2"/><position ')
    scene = write(tmp_path, turned, JAWS_ROLES.replace("[jaws, lift]", "[jaws, lift, roll]"))
    hand = postures(scene)
    assert hand.closed[2] == hand.open[2] == hand.sweep[2] == 0
    assert hand.closed[0] > hand.open[0]


def test_motors_without_a_servo_get_a_small_share_of_their_range(tmp_path):
    motors = JAWS.replace('biastype="affine" gainprm=".1" biasprm="0 -637.5 -5" ctrlrange="0 255"', 'ctrlrange="-9 9"')
    scene = write(tmp_path, motors, JAWS_ROLES)
    hand = postures(scene)
    assert grasp(scene) is None, "nothing tells where a motor's finger stops"
    assert hand.open[0] == 0
    assert hand.closed[0] == pytest.approx(0.2 * 9)


def test_an_object_out_of_reach_is_no_reason_to_fail(tmp_path):
    far = write(tmp_path, JAWS.replace('name="cube" pos="0 0 .05"', 'name="cube" pos="1 0 .05"'), JAWS_ROLES)
    assert grasp(far) is None
    assert postures(far).closed[0] == pytest.approx(0.6 * 255)


def test_unlimited_unnamed_joints_move_a_radian_at_most(tmp_path):
    bare = """<mujoco><worldbody><body><joint name="j"/><geom size=".02" pos=".1 0 0"/></body></worldbody>
      <actuator><position name="a" joint="j" kp="1" gear="2"/></actuator></mujoco>"""
    scene = write(tmp_path, bare, "model: scene.xml\nrate_hz: 100\njoints: [j]\nactuators: [a]\n")
    assert drive.command_range(scene).tolist() == [[-1, 1]]
    plan = policy("free_sweep").plan(scene, np.random.default_rng(0), 1.0)
    assert plan.qpos[0] == pytest.approx(plan.commands[0, 0] / 2), "the servo holds the actuator's length, gear x angle"
