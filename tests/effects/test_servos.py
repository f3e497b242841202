"""Servos that answer small errors otherwise than their gain says, and encoders that read whole steps."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import Servos, effect, effect_names
from candata.repair import export_mjcf
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from candata.simulate.world import build_worlds
from tests.effects.gripper import write_scene
from tests.effects.pan_tilt import play_neck, write_neck

#: One link in the horizontal plane: nothing but its servo moves it.
XML = """
<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
<body><joint name="a" axis="0 0 1" armature="1e-3"/><geom type="capsule" size="0.01" fromto="0 0 0 0.1 0 0"/></body>
</worldbody><actuator>{servo}</actuator></mujoco>
"""
SERVO = '<position name="a" joint="a" kp="2" kv="0.2" ctrlrange="-1 1"/>'
ROLES = "model: scene.xml\nrate_hz: 80\njoints: [a]\nactuators: [a]\n"
#: Weight of the neck's head [N m] at the angle zero.
MOMENT_NM = 9.81 * (0.2 * 0.2 + 0.4 * 0.4)


def scene_of(folder, servo: str = SERVO):
    return write_scene(folder, XML.format(servo=servo), ROLES)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return scene_of(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def neck(tmp_path_factory):
    return write_neck(tmp_path_factory.mktemp("neck"))


def setting(name: str, element: str | None = None, **parameters) -> EffectSetting:
    return EffectSetting(name=name, element=element, parameters=parameters)


def follow(scene, target: float, *some: EffectSetting, start: float = 0.0, rows: int = 240) -> np.ndarray:
    """Where the true joint is while it is told one angle."""
    commands, (qpos, qvel) = np.full((1, rows, 1), target), at_rest(scene, 1)
    return rollout(scene, commands, qpos + start, qvel, [some], keep_state=True).qpos[0, :, 0]


def test_an_error_within_the_band_moves_nothing(arm):
    band = setting("servo_dead_band", band_rad=0.05)
    assert np.array_equal(follow(arm, 0.049, band), np.zeros(240))
    assert follow(arm, 0.051, band)[-1] > 0


def test_beyond_the_band_the_servo_is_as_it_was(arm):
    """Till the error is small for the first time."""
    plain, banded = (follow(arm, 0.5, *some) for some in ((), (setting("servo_dead_band", band_rad=0.05),)))
    free = int(np.argmax(plain > 0.45))
    assert np.array_equal(plain[:free], banded[:free])
    assert abs(banded[-1] - 0.5) < 0.05
    assert abs(plain[-1] - 0.5) < 1e-6


def test_a_weight_sinks_to_the_edge_of_the_band(neck):
    """At no smaller error does the servo hold it."""
    commands, band = np.zeros((1, 400, 2)), 0.1
    assert 25 * band > MOMENT_NM
    q = rollout(neck, commands, *at_rest(neck, 1), [(setting("servo_dead_band", "nod", band_rad=band),)]).readings
    assert q["joint_position"][0, -100:, 1] == pytest.approx(band, abs=0.005)


def test_a_punch_takes_its_angle_off_a_sag(neck):
    """kp (e + p) = m g r cos e."""
    worlds = [(), (setting("servo_punch", punch_rad=0.02),)]
    q = rollout(neck, np.zeros((2, 400, 2)), *at_rest(neck, 2), worlds).readings["joint_position"][:, -1, 1]
    assert 25 * q == pytest.approx(MOMENT_NM * np.cos(q) - 25 * np.array([0, 0.02]), rel=1e-3)


@pytest.mark.parametrize("name", ["servo_dead_band", "servo_punch"])
def test_it_changes_the_commands_of_its_joint_only(neck, name):
    (hook,) = build_worlds(neck, [(setting(name, "nod", **{effect(name).parameters[0].name: 0.02}),)]).servo
    command = np.full((1, 2), 0.01)
    _, taken = hook.apply(hook.state, Servos(command, np.zeros((1, 2))))
    assert (taken.command != command).tolist() == [[False, True]]


def test_a_servo_sees_its_own_encoder(arm):
    """Where that is off, so is the band."""
    off = setting("joint_offset", offset_rad=0.2)
    band = setting("servo_dead_band", band_rad=0.05)
    assert np.array_equal(follow(arm, 0.2, off, band), np.zeros(240))
    assert follow(arm, 0.0, off, band)[-1] < -0.1


def test_a_limit_of_the_commands_is_none_of_the_servo(arm):
    """Told 1 rad at most, a joint at 1.03 rad is within the band, and rests."""
    assert follow(arm, 1.5, setting("servo_dead_band", band_rad=0.05), start=1.03)[-1] == 1.03
    assert follow(arm, 1.5)[-1] == pytest.approx(1.0, abs=1e-6)


def test_a_gear_and_a_gain_change_the_band_of_the_command_only(tmp_path):
    """The band is an angle of the joint: of commands of 3 u for an angle of 1, three times as wide."""
    scene = scene_of(
        tmp_path, '<general name="a" joint="a" gear="3" gainprm="2" biastype="affine" biasprm="0 -2 -.2"/>'
    )
    band = setting("servo_dead_band", band_rad=0.05)
    assert np.array_equal(follow(scene, 3 * 0.049, band), np.zeros(240))
    assert follow(scene, 3 * 0.051, band)[-1] > 0


def test_a_motor_without_a_law_has_no_band(tmp_path):
    scene = scene_of(tmp_path, '<motor name="a" joint="a"/>')
    assert not effect("servo_dead_band").possible(scene)
    assert not effect("servo_punch").possible(scene)


def test_worlds_of_several_time_steps_do_not_see_one_another(arm):
    band, fine = setting("servo_dead_band", band_rad=0.05), setting("time_step", time_step_s=0.00125)
    worlds = [(band,), (fine,), (band, fine), ()]
    commands, (qpos, qvel) = np.full((4, 80, 1), 0.5), at_rest(arm, 4)
    together = rollout(arm, commands, qpos, qvel, worlds).readings["joint_position"]
    for row, world in enumerate(worlds):
        alone = rollout(arm, commands[:1], qpos[:1], qvel[:1], [world]).readings["joint_position"]
        assert np.array_equal(alone[0], together[row]), world


def test_an_export_says_what_the_model_cannot_hold(arm, tmp_path):
    found = export_mjcf(arm, [setting("servo_dead_band", band_rad=0.05)], tmp_path / "out")
    (entry,) = found.left
    assert (entry.name, entry.whole) == ("servo_dead_band", True)
    assert "before each physics step" in entry.apply


def test_an_encoder_reads_the_nearest_step(neck):
    plain, read = play_neck(neck, [(), (setting("encoder_step", "nod", step_rad=0.01),)])["joint_position"]
    assert np.array_equal(plain[:, 0], read[:, 0])
    steps = read[:, 1] / 0.01
    # Whole numbers but for rounding.
    assert steps == pytest.approx(np.round(steps), abs=1e-9)
    assert np.abs(read[:, 1] - plain[:, 1]).max() <= 0.005 + 1e-12


def test_whole_steps_are_noise_of_a_sensor_and_no_cause_that_is_searched():
    assert "reading_noise" in effect("encoder_step").traits
    assert "encoder_step" not in effect_names()


def test_the_models_of_the_worlds_keep_their_limits(arm):
    assert build_worlds(arm, [(setting("servo_punch", punch_rad=0.01),)]).models[0].actuator_ctrllimited.all()
