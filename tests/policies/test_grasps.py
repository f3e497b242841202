"""Sampled grasps lift objects that no posture was made for; what no grasp reaches is said."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from candata.errors import SceneError
from candata.policies import policy, policy_names
from candata.policies._grasps import can_carry, grasps
from candata.policies._opposing import chords
from candata.scenes import load_scene
from candata.simulate import rollout
from candata.simulate.jobs import possible_policies

TRIES = 4
RADIUS_M = 0.028


def played(scene, name: str, duration_s: float, tries: int = TRIES):
    """Plans of some seeds, and the states and touches that they lead to, after settling."""
    plans = [policy(name).plan(scene, np.random.default_rng(seed), duration_s) for seed in range(tries)]
    settle = round(plans[0].settle_s * scene.file.rate_hz)
    commands = np.stack([np.concatenate([np.repeat(p.commands[:1], settle, axis=0), p.commands]) for p in plans])
    starts = np.stack([p.qpos for p in plans]), np.stack([p.qvel for p in plans])
    end = rollout(scene, commands, *starts, [()] * tries, keep_state=True, settle=settle)
    return plans, end.qpos[:, settle:], end.touch[:, settle:]


def object_places(scene, states) -> np.ndarray:
    """Place of the object `(n, T, 3)` [m], from its first."""
    places = states[:, :, scene.object_qpos : scene.object_qpos + 3]
    return places - places[:, :1]


@pytest.fixture(scope="module")
def scene_with(tmp_path_factory):
    """`(shape, kg) -> scene` of the hand on rails with an object of one primitive, standing as it is."""

    def make(mass_kg: float, **shape):
        folder = tmp_path_factory.mktemp("objects") / shape["type"]
        folder.mkdir()
        height_m = shape["size_m"][-1]
        rest = {"quaternion": [1.0, 0.0, 0.0, 0.0], "height_m": height_m, "probability": 1.0, "tilt_rad": 0.0}
        object_file = {"name": shape["type"], "about": "one primitive", "mass_kg": mass_kg, "visual": shape}
        text = yaml.safe_dump(object_file | {"inertia": "exact", "rests": [rest]})
        (folder / "object.yaml").write_text(text, encoding="utf-8")
        return load_scene(f"xhand_tabletop+{folder}")

    return make


@pytest.fixture(scope="module")
def ball(scene_with):
    return scene_with(0.08, type="sphere", size_m=[RADIUS_M])


def test_a_box_of_another_size_than_the_can_is_lifted(scene_with):
    scene = scene_with(0.3, type="box", size_m=[0.02, 0.035, 0.025])
    _, states, _ = played(scene, "pick_and_place", 5.0)
    assert (object_places(scene, states)[:, :, 2].max(1) > 0.05).sum() >= TRIES - 1


def test_a_ball_is_lifted_by_the_policy_that_shakes_it_too(ball):
    _, states, _ = played(ball, "grasp_lift_shake", 4.0)
    # The hand rises by 4 to 7 cm, and the fingers give a little.
    assert (object_places(ball, states)[:, :, 2].max(1) > 0.03).sum() >= TRIES - 1


def test_the_hand_starts_clear_of_object_and_table(ball):
    plans, states, touch = played(ball, "pick_and_place", 2.0)
    assert not touch[:, 0].any()
    assert len({tuple(np.round(plan.qpos[ball.object_qpos + 3 :], 6)) for plan in plans}) > 1, "headings differ"
    assert np.isfinite(states).all()


def test_what_is_too_wide_is_refused_with_both_widths(scene_with):
    plate = scene_with(0.5, type="box", size_m=[0.125, 0.125, 0.005])
    with pytest.raises(SceneError, match="no grasp reaches the object") as error:
        policy("pick_and_place").plan(plate, np.random.default_rng(0), 5.0)
    assert re.search(r"opposing points \d+ to \d+ mm apart; the fingertips open to \d+ mm", str(error.value))


def test_scenes_of_one_digest_share_their_grasps():
    assert grasps(load_scene("gripper_tabletop")) is grasps(load_scene("gripper_tabletop"))


def test_lines_through_a_ball_are_as_long_as_it_is_wide_and_miss_beyond_it(ball):
    points = np.array([[0.0, 0, 0], [0, 0, 0.02], [0, 0, 0.029]])
    lines = chords(ball, points, np.tile([1.0, 0.0, 0.0], (3, 1)))
    expected = 2 * np.sqrt(RADIUS_M**2 - 0.02**2)
    # Rays meet the sphere to rounding.
    np.testing.assert_allclose(lines.width_m[:2], [2 * RADIUS_M, expected], atol=1e-9)
    np.testing.assert_allclose(lines.alignment[:2], [1.0, expected / 2 / RADIUS_M], atol=1e-9)
    assert np.isnan(lines.width_m[2])


def test_policies_that_need_a_carried_hand_say_no_elsewhere_and_are_played_on_request_only():
    on_request = {name for name in policy_names() if policy(name).on_request}
    assert on_request == {"pick_and_place", "slide", "topple", "turn_in_hand"}
    toss = load_scene("cube_toss")
    assert not can_carry(toss)
    assert not any(policy(name).possible(toss) for name in on_request)
    listing_none = replace(load_scene("gripper_tabletop"), policies=())
    assert all(policy(name).possible(listing_none) for name in on_request)
    assert not on_request & set(possible_policies(listing_none))


@pytest.fixture(scope="module")
def hand():
    return load_scene("xhand_tabletop")


def test_pick_and_place_lifts_the_can_and_puts_it_where_it_belongs(hand):
    plans, states, _ = played(hand, "pick_and_place", 7.0)
    places = object_places(hand, states)
    reached = []
    for plan, place in zip(plans, places, strict=True):
        lifted = (place[:, 2] > plan.goal.lift_m).sum() / hand.file.rate_hz >= plan.goal.held_s
        to_place = plan.goal.place_m
        off_m = 0.0 if to_place is None else float(np.linalg.norm((place[-1] - to_place)[:2]))
        reached.append(lifted and off_m < plan.goal.place_tolerance_m)
        assert to_place is None or 0.1 <= np.linalg.norm(to_place) <= 0.25
    assert sum(reached) >= TRIES - 1


def test_topple_lays_the_can_on_its_side(hand):
    plans, states, _ = played(hand, "topple", 4.0)
    attitudes = states[:, -1, hand.object_qpos + 3 : hand.object_qpos + 7]
    upright = 1 - 2 * (attitudes[:, 1] ** 2 + attitudes[:, 2] ** 2)
    assert (np.abs(upright) < 0.5).sum() >= TRIES - 1
    assert all(plan.goal.topple for plan in plans)


def test_slide_pulls_the_can_along_until_it_stays_behind(hand):
    plans, states, _ = played(hand, "slide", 5.0)
    places = object_places(hand, states)
    pulled = slice(round(2.0 / 6 * 400), round(4.4 / 6 * 400))
    rails = states[:, pulled, hand.joint_qpos[:3]]
    hand_m = np.linalg.norm((rails[:, -1] - rails[:, 0])[:, :2], axis=1)
    object_m = np.linalg.norm((places[:, pulled][:, -1] - places[:, pulled][:, 0])[:, :2], axis=1)
    assert ((object_m > 0.02) & (hand_m - object_m > 0.01)).sum() >= TRIES - 1
    assert (places[:, :, 2].max(1) < 0.05).all(), "it stays on the table"
    assert all(plan.goal.slip for plan in plans)


def test_turn_in_hand_turns_the_can_by_45_degrees_while_it_is_touched(hand):
    plans, states, touch = played(hand, "turn_in_hand", 10.0)
    attitudes = states[:, :, hand.object_qpos + 3 : hand.object_qpos + 7]
    turn_rad = 2 * np.arccos(np.clip(np.abs((attitudes * attitudes[:, :1]).sum(-1)), 0, 1))
    goal_rad = plans[0].goal.turn_rad
    assert goal_rad == pytest.approx(np.pi / 4)
    assert ((np.where(touch, turn_rad, 0.0).max(1)) > goal_rad).sum() >= TRIES - 1
    tilt = 2 * (attitudes[:, :, 1] ** 2 + attitudes[:, :, 2] ** 2)
    assert (tilt[:, -1] < 0.5).all(), "it still stands"
