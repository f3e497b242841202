"""The stop-gap keeps the contract of effects, but no search and no draw ever meets it."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import effect, effect_names, flatten, setting
from candata.effects._residual_terms import AXES, JOINT_TERMS, OBJECT_TERMS, sizes
from candata.errors import UnknownNameError, UsageError
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from tests.effects.gripper import play_grip

NAME = "learned_residual"


def numbers(scene) -> int:
    """Coefficients of all elements."""
    return sum(sizes(scene))


def one(scene, index: int, value: float, element: str | None = None) -> EffectSetting:
    """The setting whose `index`-th coefficient is `value`."""
    x = flatten(EffectSetting(name=NAME), scene)
    x[index] = value
    return setting(NAME, x, scene, element)


def test_it_is_found_by_name_but_never_searched_nor_drawn():
    assert effect(NAME).fitted
    assert NAME not in effect_names()


def test_the_identity_changes_nothing_bit_for_bit(gripper):
    plain = EffectSetting(name=NAME)
    whole = setting(NAME, flatten(plain, gripper), gripper)
    for channel, value in play_grip(gripper, [(), (plain,), (whole,)]).readings.items():
        for row in (1, 2):
            assert np.array_equal(value[0], value[row]), channel


def test_every_term_moves_a_channel_and_neighbours_do_not_see_it(gripper):
    # Small enough that a push along the velocity does not run away.
    worlds = [(), *((one(gripper, i, 0.01),) for i in range(numbers(gripper)))]
    read = play_grip(gripper, worlds).readings
    still = [i for i in range(numbers(gripper)) if all(np.array_equal(v[i + 1], v[0]) for v in read.values())]
    place = [sizes(gripper)[0] + OBJECT_TERMS.index(("position",)) * AXES + a for a in (3, 4, 5)]
    assert still == place, "a torque that depends on position has no position to depend on"
    alone = play_grip(gripper, [worlds[5]]).readings
    for channel, value in alone.items():
        assert np.array_equal(value[0], read[channel][5]), channel


def test_a_constant_force_accelerates_a_free_object_as_newton_says():
    scene = load_scene("cube_toss")
    x = one(scene, 0, 0.5)
    qpos, qvel = at_rest(scene, 2)
    qpos[:, scene.object_qpos + 2] += 2.0
    pose = rollout(scene, np.zeros((2, 20, 0)), qpos, qvel, [(), (x,)]).readings["object_pose"]
    time_s = 19 / scene.file.rate_hz
    mass = float(scene.model.body_mass[scene.object_id])
    moved = pose[1, -1, 0] - pose[0, -1, 0]
    # Semi-implicit Euler runs ahead of the parabola by half a physics step.
    assert moved == pytest.approx(0.5 * 0.5 / mass * time_s**2, rel=scene.model.opt.timestep / time_s + 1e-6)


def test_an_element_holds_its_own_numbers_only(gripper):
    given = one(gripper, len(JOINT_TERMS), 0.3, "left")
    assert len(given.parameters["coefficients"]) == len(JOINT_TERMS)
    assert flatten(given, gripper)[len(JOINT_TERMS)] == 0.3
    read = play_grip(gripper, [(given,), (one(gripper, len(JOINT_TERMS), 0.3),)]).readings
    for channel, value in read.items():
        assert np.array_equal(value[0], value[1]), channel


def test_two_elements_act_together(gripper):
    left, right = (one(gripper, k * len(JOINT_TERMS), 0.3, e) for k, e in ((1, "left"), (2, "right")))
    x = flatten(left, gripper) + flatten(right, gripper)
    x[numbers(gripper) :] = 1.0
    read = play_grip(gripper, [(left, right), (setting(NAME, x, gripper),)]).readings
    for channel, value in read.items():
        # The two ways add the same numbers in another order.
        np.testing.assert_allclose(value[0], value[1], atol=1e-9, err_msg=channel)


def test_it_survives_being_written(gripper):
    given = one(gripper, numbers(gripper) - 1, -0.2, "object")
    again = EffectSetting.model_validate_json(given.model_dump_json())
    assert np.array_equal(flatten(again, gripper), flatten(given, gripper))


def test_an_element_that_is_not_there_is_refused(gripper):
    with pytest.raises(UnknownNameError, match="unknown element 'thumb'"):
        play_grip(gripper, [(EffectSetting(name=NAME, element="thumb"),)])


@pytest.mark.parametrize("value", [1e5, float("nan")])
def test_a_number_out_of_bounds_is_refused(gripper, value):
    given = EffectSetting(name=NAME, element="left", parameters={"coefficients": (value,) * len(JOINT_TERMS)})
    with pytest.raises(UsageError, match="coefficients is not possible"):
        flatten(given, gripper)


def test_a_vector_of_another_scene_is_refused(gripper):
    given = EffectSetting(name=NAME, element="left", parameters={"coefficients": (0.1, 0.2)})
    with pytest.raises(UsageError, match=rf"{len(JOINT_TERMS)} number\(s\)"):
        flatten(given, gripper)
