"""The stepping loop against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from candata.policies import policy
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from candata.simulate.loop import ROWS

#: Gravity of MuJoCo's default option [m/s^2].
G = 9.81


def play(scene, rows: int, effects=(), **options):
    """One simulation from the model's own start, without commands."""
    return rollout(scene, np.zeros((1, rows, 0)), *at_rest(scene, 1), [effects], **options)


def planned(scene, name: str, effects, duration_s: float = 1.2):
    """Readings of one world for each entry of `effects`, all playing the same motion."""
    plan = policy(name).plan(scene, np.random.default_rng(3), duration_s)
    tile = [np.repeat(a[None], len(effects), axis=0) for a in (plan.commands, plan.qpos, plan.qvel)]
    return plan, rollout(scene, *tile, effects).readings


@pytest.fixture(scope="module")
def hand():
    return load_scene("xhand_tabletop")


def test_a_free_body_falls_as_semi_implicit_euler_says(user_scene):
    scene = user_scene(
        '<body name="ball" pos="0 0 9"><freejoint/><geom type="sphere" size="0.02"/></body>',
        "rate_hz: 100\nobject: ball\n",
    )
    z = play(scene, 80).readings["object_pose"][0, :, 2]
    step, k = scene.model.opt.timestep, np.arange(80) * scene.substeps
    # v after n steps is -g n h, so z falls by g h^2 n (n + 1) / 2: exact but for rounding.
    np.testing.assert_allclose(z, 9 - G * step**2 * k * (k + 1) / 2, atol=1e-12)
    # The continuous law differs by g t h / 2 at most.
    time_s = k * step
    assert np.abs(z - (9 - G * time_s**2 / 2)).max() <= G * time_s[-1] * step / 2 + 1e-12


def test_a_ball_on_an_upturned_fingertip_reads_minus_its_weight_along_z(ball_over_plate):
    force = play(ball_over_plate(), 120).readings["fingertip_force"][0, -1, 0]
    # The soft contact has come to rest after a second; 0.1 % of the weight is left of the bounce.
    np.testing.assert_allclose(force, [0, 0, -0.05 * G], atol=5e-4)


def test_the_force_is_in_the_fingertip_s_frame(ball_over_plate):
    # x of the frame shows up: the weight is along -x there.
    force = play(ball_over_plate(euler="0 -90 0"), 120).readings["fingertip_force"][0, -1, 0]
    np.testing.assert_allclose(force, [-0.05 * G, 0, 0], atol=5e-4)


def test_the_force_is_the_mean_over_the_interval_before_the_row(ball_over_plate):
    coarse = ball_over_plate(100.0, gap_m=0.01)
    fine = ball_over_plate(500.0, gap_m=0.01)
    assert (coarse.substeps, fine.substeps) == (5, 1)
    mean = play(coarse, 31).readings["fingertip_force"][0, :, 0]
    each = play(fine, 151, instant_force=True).readings["fingertip_force"][0, :, 0]
    assert np.abs(mean).max() > 1.0, "the ball lands"
    assert (mean[0] == 0).all()
    # Sums of five numbers in another order: rounding only.
    np.testing.assert_allclose(mean[1:], each[1:].reshape(30, 5, 3).mean(1), atol=1e-12)
    last = play(coarse, 31, instant_force=True).readings["fingertip_force"][0, :, 0]
    np.testing.assert_array_equal(last[1:], each[5::5])


@pytest.fixture
def box(user_scene):
    """A box on a plane, friction 0.2, elliptic cone."""
    return user_scene(
        '<geom name="floor" type="plane" size="5 5 0.1" friction="0.2 0.005 0.0001"/>'
        '<body name="box" pos="0 0 0.03"><freejoint/>'
        '<geom type="box" size="0.05 0.05 0.03" mass="0.3" friction="0.2 0.005 0.0001"/></body>',
        "rate_hz: 100\nobject: box\nsupport: floor\n",
        'timestep="0.002" cone="elliptic" impratio="100"',
    )


def tilt(factor: float, friction: float = 0.2) -> EffectSetting:
    """A tilt whose tangent is `factor` times the friction."""
    return EffectSetting(
        name="gravity_tilt", parameters={"tilt_x_rad": float(np.arctan(factor * friction)), "tilt_y_rad": 0.0}
    )


def test_a_box_sticks_below_the_friction_angle_and_slides_above(box):
    effects = [(tilt(0.95),), (tilt(1.05),)]
    y = rollout(box, np.zeros((2, 101, 0)), *at_rest(box, 2), effects).readings["object_pose"][:, :, 1]
    angle = np.arctan(1.05 * 0.2)
    slide = 0.5 * G * (np.sin(angle) - 0.2 * np.cos(angle)) * 1.0**2
    # Regularised friction creeps: impratio 100 keeps it well below a millimetre a second.
    assert abs(y[0, -1]) < 1e-3
    # The same creep, and the first steps in which the contact builds up: 10 % of 5 cm.
    assert abs(y[1, -1]) == pytest.approx(slide, rel=0.1)


def test_the_threshold_moves_with_sliding_friction(box):
    more = EffectSetting(name="sliding_friction", parameters={"scale": 1.25})
    less = EffectSetting(name="sliding_friction", parameters={"scale": 0.8})
    effects = [(tilt(1.15), more), (tilt(0.9), less)]
    y = rollout(box, np.zeros((2, 101, 0)), *at_rest(box, 2), effects).readings["object_pose"][:, :, 1]
    assert abs(y[0, -1]) < 1e-3
    assert abs(y[1, -1]) > 0.05


def test_gravity_tilt_about_x_pulls_along_y(user_scene):
    scene = user_scene(
        '<body name="ball" pos="0 0 9"><freejoint/><geom type="sphere" size="0.02"/></body>',
        "rate_hz: 100\nobject: ball\n",
    )
    pose = play(scene, 50, (tilt(0.5),)).readings["object_pose"][0]
    moved = pose[-1, :3] - pose[0, :3]
    # Gravity keeps its size; turned about +x by a the vector (0, 0, -g) becomes (0, g sin a, -g cos a).
    assert moved[1] / -moved[2] == pytest.approx(0.1, rel=1e-9)
    assert moved[0] == pytest.approx(0, abs=1e-12)


def test_a_delay_of_whole_steps_is_a_shift_of_the_commands(hand):
    late = EffectSetting(name="actuation_delay", parameters={"delay_s": 0.025})
    plan, played = planned(hand, "free_sweep", [(late,)])
    shifted = plan.commands.copy()
    hinges = hand.driven_hinges
    shifted[2:, hinges], shifted[:2, hinges] = plan.commands[:-2, hinges], plan.commands[0, hinges]
    expected = rollout(hand, shifted[None], plan.qpos[None], plan.qvel[None], [()]).readings
    for channel, value in expected.items():
        assert np.array_equal(value, played[channel]), channel


def test_tactile_gain_multiplies_and_bias_adds(hand):
    gain = EffectSetting(name="tactile_gain", parameters={"gain": 1.5})
    bias = EffectSetting(name="tactile_bias", parameters={"bias_N": tuple(np.arange(15) / 10)})
    _, played = planned(hand, "squeeze", [(), (gain,), (bias,)])
    plain, scaled, moved = played["fingertip_force"]
    assert np.abs(plain).max() > 0.3, "something is touched"
    assert np.array_equal(scaled, 1.5 * plain)
    assert np.array_equal(moved, plain + np.arange(15).reshape(5, 3) / 10)
    assert np.array_equal(played["object_pose"][0], played["object_pose"][1])


def test_pose_latency_of_whole_rows_is_a_shift(hand):
    late = EffectSetting(name="pose_latency", parameters={"latency_s": 3 / 80})
    _, played = planned(hand, "push", [(), (late,)])
    plain, shifted = played["object_pose"]
    assert np.abs(np.diff(plain, axis=0)).max() > 1e-4, "the object moves"
    # The quaternion is normalised once more on the way: rounding only.
    np.testing.assert_allclose(shifted[3:], plain[:-3], atol=1e-14)
    np.testing.assert_allclose(shifted[:3], np.repeat(plain[:1], 3, axis=0), atol=1e-14)
    assert np.array_equal(played["joint_position"][0], played["joint_position"][1])


def test_a_scaled_mass_weighs_more_on_the_fingertip(ball_over_plate):
    heavy = EffectSetting(name="object_mass", parameters={"mass_scale": 2.0})
    force = play(ball_over_plate(), 120, (heavy,)).readings["fingertip_force"][0, -1, 0]
    np.testing.assert_allclose(force, [0, 0, -0.1 * G], atol=1e-3)


def test_forces_are_the_same_read_row_by_row(hand):
    some = [
        [EffectSetting(name="tactile_lag", parameters={"timeconst_s": 0.05})],
        [],
        [EffectSetting(name="time_step", parameters={"time_step_s": 0.001})],
    ]
    plan = policy("squeeze").plan(hand, np.random.default_rng(3), 1.2)
    tile = [np.repeat(a[None], len(some), axis=0) for a in (plan.commands, plan.qpos, plan.qvel)]
    # A push of nothing is told each row's forces, so that none may be read together.
    told = []
    each = rollout(hand, *tile, some, push=lambda row, x: told.append(x.tip_force) or np.zeros_like(x.qvel))
    many = rollout(hand, *tile, some)
    assert len(plan.commands) > 2 * ROWS
    for name, values in each.readings.items():
        np.testing.assert_array_equal(many.readings[name], values)
    np.testing.assert_array_equal(many.tip_force, each.tip_force)
    np.testing.assert_array_equal(each.readings["fingertip_force"][1, :-1], np.stack(told, 1)[1])
    assert np.abs(each.readings["fingertip_force"]).max() > 1.0
