"""Effects that belong to a scene: what is added acts on top of them, and one list of effects says the same."""

from __future__ import annotations

import numpy as np
import pytest

from candata.errors import UnknownNameError, UsageError
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout, true_state, with_effects
from candata.simulate.world import all_effects

ROWS = 40
#: An effect that is given and one that is added: scales, sums, a value in the place of another, a delay, and sensors.
PAIRS = [
    ({"servo_gain": {"kp_scale": 1.5}}, {"servo_gain": {"kp_scale": 1.5}}),
    ({"joint_damping": {"damping_Nms_rad": 0.2}}, {"joint_damping": {"damping_Nms_rad": 0.1}}),
    ({"torque_limit": {"limit_Nm": 1.0}}, {"torque_limit": {"limit_Nm": 0.7}}),
    ({"actuation_delay": {"delay_s": 0.02}}, {"actuation_delay": {"delay_s": 0.03}}),
    ({"time_step": {"time_step_s": 0.00125}}, {"time_step": {"time_step_s": 0.0025}}),
    ({"clock_drift": {"ppm": 20000.0}}, {"clock_drift": {"ppm": -10000.0}}),
    ({"servo_gain": {"kp_scale": 2.0}}, {"actuation_delay": {"delay_s": 0.03}}),
    ({"pose_bias": {"bias_m": (0.01, 0.0, 0.0)}}, {"pose_latency": {"latency_s": 0.03}}),
]


#: Those of them that put a value in the place of the model's own.
REPLACING = ("torque_limit", "time_step")


@pytest.fixture(scope="module")
def gripper() -> Scene:
    return load_scene("gripper_tabletop")


def effects_of(values: dict) -> tuple[EffectSetting, ...]:
    return tuple(EffectSetting(name=name, parameters=x) for name, x in values.items())


def readings(scene: Scene, effects=()) -> dict[str, np.ndarray]:
    """What the sensors read while the commands swing."""
    low, high = scene.model.actuator_ctrlrange[scene.actuator_ids].T
    swing = 0.5 + 0.4 * np.sin(np.arange(ROWS) / 6)[:, None]
    return rollout(scene, (low + swing * (high - low))[None], *at_rest(scene, 1), [effects]).readings


def differ(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> bool:
    return any(not np.allclose(values, other[channel]) for channel, values in one.items())


@pytest.mark.parametrize(("given", "added"), PAIRS, ids=["-".join((*a, *b)) for a, b in PAIRS])
def test_what_is_added_to_given_effects_is_one_list_on_the_plain_scene(gripper, given, added):
    nominal = with_effects(gripper, effects_of(given))
    together = readings(nominal, effects_of(added))
    listed = readings(gripper, all_effects(nominal, effects_of(added)))
    for channel, values in together.items():
        np.testing.assert_allclose(listed[channel], values, rtol=0, atol=1e-9, err_msg=channel)
    assert differ(together, readings(nominal))
    is_replaced = [*given] == [*added] and set(added) <= set(REPLACING)
    assert differ(together, readings(gripper, effects_of(added))) != is_replaced


def test_a_scene_with_given_effects_reads_what_the_plain_one_reads_with_them(gripper):
    given = effects_of({"actuation_delay": {"delay_s": 0.03}, "servo_gain": {"kp_scale": 1.5}})
    for channel, values in readings(gripper, given).items():
        np.testing.assert_array_equal(readings(with_effects(gripper, given))[channel], values)


def test_effects_are_given_one_after_another(gripper):
    one, other = effects_of({"servo_gain": {"kp_scale": 1.5}}), effects_of({"torque_limit": {"limit_Nm": 1.0}})
    assert with_effects(with_effects(gripper, one), other).given_effects == (*one, *other)
    assert with_effects(gripper, ()) is gripper


def test_a_scene_with_given_effects_has_a_digest_of_its_own(gripper):
    """What is kept of simulations bears it."""
    given = [effects_of({"actuation_delay": {"delay_s": s}}) for s in (0.02, 0.03)]
    assert len({gripper.digest, *(with_effects(gripper, some).digest for some in given)}) == 3


def test_what_is_true_is_read_through_given_sensors(gripper):
    biased = with_effects(gripper, effects_of({"pose_bias": {"bias_m": (0.01, 0.0, 0.0)}}))
    pose = np.array([[0.2, 0.1, 0.3, 1.0, 0, 0, 0]])
    np.testing.assert_allclose(true_state(biased, {"object_pose": pose}, ())["object_pose"][0, :3], [0.19, 0.1, 0.3])


@pytest.mark.parametrize(
    ("scene", "effect", "error", "text"),
    [
        ("gripper_tabletop", EffectSetting(name="servo_gian"), UnknownNameError, "servo_gain"),
        ("gripper_tabletop", EffectSetting(name="servo_gain", parameters={"kp": 2.0}), UnknownNameError, "kp_scale"),
        ("gripper_tabletop", EffectSetting(name="servo_gain", parameters={"kp_scale": -1.0}), UsageError, "possible"),
        ("cube_toss", EffectSetting(name="servo_gain", parameters={"kp_scale": 2.0}), UsageError, "cannot act"),
    ],
)
def test_what_cannot_be_given_is_refused(scene, effect, error, text):
    with pytest.raises(error, match=text):
        with_effects(load_scene(scene), [effect])
