"""Plans with another grip, aim and timing: what each changes, and what it leaves as it is."""

from __future__ import annotations

import numpy as np
import pytest

from candata.scenes import load_scene
from candata.simulate.episodes import EpisodeJob, planned
from candata.simulate.perturbation import SHIFT_FROM, SHIFT_TO, Draw, drawn, perturbed

#: Columns of `action` of the wrist's two rails; the fingers have the others.
RAILS = 2


@pytest.fixture(scope="module")
def scene():
    return load_scene("gripper_tabletop")


@pytest.fixture(scope="module")
def plan(scene):
    return planned(scene, EpisodeJob("e", 0, "grasp_lift_shake", 1), 3.2)


def fingers(scene, commands):
    rails = [i for i, name in enumerate(scene.file.actuator_names) if scene.sliding[scene.file.joints.index(name)]]
    assert len(rails) == RAILS
    return np.delete(commands, rails, axis=1), commands[:, rails]


def test_an_attempt_without_changes_is_the_plan(scene, plan):
    same = perturbed(scene, plan, Draw("success", 0))
    np.testing.assert_array_equal(same.commands, plan.commands)
    np.testing.assert_array_equal(same.qpos, plan.qpos)


def test_the_first_draw_for_a_success_changes_nothing():
    first = drawn("success", 0, 3.2, np.random.default_rng(1))
    assert first == Draw("success", 0)


def test_a_weaker_grip_closes_less_and_the_wrist_goes_its_way(scene, plan):
    (before, rails_before), (after, rails_after) = (
        fingers(scene, commands) for commands in (plan.commands, perturbed(scene, plan, Draw("slip", 1, 0.5)).commands)
    )
    np.testing.assert_allclose(after - after[0], 0.5 * (before - before[0]), atol=1e-12)
    np.testing.assert_array_equal(rails_after, rails_before)


@pytest.mark.parametrize("lead_s", [0.5, -0.5])
def test_early_fingers_lead_in_the_second_half_and_late_ones_lag_in_the_first(scene, plan, lead_s):
    (before, rails_before), (after, rails_after) = (
        fingers(scene, commands)
        for commands in (plan.commands, perturbed(scene, plan, Draw("drop", 1, lead_s=lead_s)).commands)
    )
    count, lead_rows = len(before), round(lead_s * scene.file.rate_hz)
    first, second = np.arange(int(SHIFT_FROM * count)), np.arange(int(SHIFT_TO * count) + 1, count)
    kept, moved = (first, second) if lead_s > 0 else (second, first)
    np.testing.assert_array_equal(after[kept], before[kept])
    np.testing.assert_array_equal(after[moved], before[np.clip(moved + lead_rows, 0, count - 1)])
    np.testing.assert_array_equal(rails_after, rails_before)


def test_another_aim_moves_the_object_alone(scene, plan):
    moved = perturbed(scene, plan, Draw("miss", 1, aim_x_m=0.02, aim_y_m=-0.01)).qpos - plan.qpos
    at = scene.object_qpos
    np.testing.assert_allclose(moved[at : at + 2], [0.02, -0.01], atol=1e-15)
    assert np.count_nonzero(moved) == 2


def test_what_an_episode_keeps_of_a_draw_gives_it_back():
    attempt = drawn("fail", 7, 3.2, np.random.default_rng(3))
    assert attempt != Draw("fail", 7)
    assert Draw.kept(attempt.labels()) == attempt
    assert Draw.kept({"supply_V": 5.0}) is None
