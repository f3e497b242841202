"""Motors that pull through a tendon, or move slides: effects of the drive act on what the motor pulls."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import _select as select
from candata.effects import effect, flatten, setting
from candata.gap.fit.candidates import candidate, local_candidates
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from candata.simulate.world import build_worlds
from tests.effects.gripper import write_scene
from tests.policies.unknown_hands import JAWS, JAWS_ROLES

#: Two fingers closed by one motor whose command runs from 0 to 255, as those of common grippers: 100 N m hold 1 rad of
#: tendon, half of which each finger is; an equality keeps them alike. A third finger has a motor of its own.
XML = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast" gravity="0 0 0"/>
  <default><joint range="0 0.8" limited="true" damping=".1" armature=".005"/></default><worldbody>
    <body name="left" pos="-.2 0 0"><joint name="left" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .08" size=".006" mass=".03"/></body>
    <body name="right" pos=".2 0 0"><joint name="right" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .08" size=".006" mass=".03"/></body>
    <body name="third" pos="0 .3 0"><joint name="third" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .08" size=".006" mass=".03"/></body></worldbody>
  <tendon><fixed name="both"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed></tendon>
  <equality><joint joint1="left" joint2="right" solref=".005 1"/></equality>
  <actuator>
    <general name="grip" tendon="both" biastype="affine" gainprm=".4" biasprm="0 -100 -10" ctrlrange="0 255"
      forcerange="-50 50"/>
    <position name="third" joint="third" kp="50" kv="2" forcerange="-10 10"/>
  </actuator></mujoco>"""
ROLES = "model: scene.xml\nrate_hz: 100\njoints: [left, right, third]\nactuators: [grip, third]\n"
#: A command of the tendon's motor per rad of both fingers.
PER_RAD = 100 / 0.4


@pytest.fixture
def pair(tmp_path):
    return write_scene(tmp_path, XML, ROLES)


def planted(name: str, scene, value: float, element: str | None = None) -> EffectSetting:
    x = flatten(EffectSetting(name=name), scene)
    x[:] = value
    return setting(name, x, scene, element)


def rests(scene, commands, *effects: EffectSetting) -> np.ndarray:
    """Where joints are read `(T, J)` under commands `(T, A)`."""
    played = rollout(scene, np.asarray(commands, float)[None], *at_rest(scene, 1), [effects])
    return played.readings["joint_position"][0]


def test_a_motor_pulls_every_joint_of_its_tendon(pair):
    assert pair.driven_joints == {1: 2}
    assert pair.levers == {0: {0: 0.5, 1: 0.5}, 1: {2: 1.0}}
    assert pair.driven_hinges.tolist() == [0, 1, 2]
    assert pair.stiffness([0, 1]).tolist() == [100, 50]


def test_what_is_the_motors_is_named_once_and_what_is_the_joints_each(pair):
    for name in ("servo_gain", "servo_damping", "torque_limit", "backlash", "actuation_delay"):
        assert effect(name).elements(pair) == ("left", "third"), name
    for name in ("joint_damping", "joint_dry_friction", "armature", "joint_offset"):
        assert effect(name).elements(pair) == ("left", "right", "third"), name


def test_what_pulls_over_sites_drives_no_joint_that_is_known(tmp_path):
    sites = XML.replace(
        '<tendon><fixed name="both"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed></tendon>',
        '<tendon><spatial name="both"><site site="a"/><site site="b"/></spatial></tendon>',
    )
    sites = sites.replace('<joint name="left" axis="0 1 0"/>', '<joint name="left" axis="0 1 0"/><site name="a"/>')
    sites = sites.replace('<joint name="right" axis="0 1 0"/>', '<joint name="right" axis="0 1 0"/><site name="b"/>')
    scene = write_scene(tmp_path, sites, ROLES)
    assert scene.driven_hinges.tolist() == [2]


@pytest.mark.parametrize(("element", "scaled"), [(None, [0.5, 0.5]), ("left", [0.5, 1.0]), ("third", [1.0, 0.5])])
def test_a_gain_scales_the_motor_whatever_its_commands_unit(pair, element, scaled):
    world = build_worlds(pair, [(planted("servo_gain", pair, 0.5, element),)]).models[0]
    for now, before in (
        (world.actuator_gainprm[:, 0], pair.model.actuator_gainprm[:, 0]),
        (world.actuator_biasprm[:, 1], pair.model.actuator_biasprm[:, 1]),
    ):
        assert np.allclose(now / before, scaled)


def test_encoders_that_are_off_move_what_the_tendon_holds(pair):
    commands = np.full((200, 2), [0.3 * PER_RAD, 0.3])
    off = EffectSetting(name="joint_offset", parameters={"offset_rad": (0.05, 0.05, -0.04)})
    read, true = rests(pair, commands, off)[-1], rests(pair, commands)[-1]
    assert true == pytest.approx([0.3, 0.3, 0.3], abs=2e-3)
    # The servos bring what is read to the command; the joints stand beside it.
    assert read == pytest.approx([0.3, 0.3, 0.3], abs=2e-3)
    alone = planted("joint_offset", pair, 0.06, "right")
    # Half of the tendon reads too much, so both fingers, which are held alike, stand half as far back.
    assert rests(pair, commands, alone)[-1] == pytest.approx([0.27, 0.33, 0.3], abs=2e-3)


def test_play_is_an_angle_of_the_joints_whatever_the_commands_unit(pair):
    target = np.concatenate([np.full(150, 0.3), np.full(150, 0.34), np.full(150, 0.4)])
    commands = np.stack([target * PER_RAD, target], axis=1)
    at = rests(pair, commands, planted("backlash", pair, 0.1))[[149, 299, 449]]
    # Half a gap of play: 0.04 rad are lost in it, 0.1 rad move the joints by half of that.
    assert np.allclose(at, np.array([0.3, 0.3, 0.35])[:, None], atol=3e-3)


def test_scales_are_those_of_the_joints_that_are_pulled(pair):
    # A finger on the tendon is damped by .1 + 10 / 4, the third by .1 + 2.
    assert select.drive_damping(pair) == pytest.approx((2.6 + 2.1) / 2)
    assert select.drive_torque(pair) == 30


def test_slides_stand_for_hinges_where_there_are_none(tmp_path):
    scene = write_scene(tmp_path, JAWS, JAWS_ROLES)
    for name in ("servo_gain", "servo_damping", "actuation_delay"):
        assert effect(name).possible(scene)
        assert effect(name).elements(scene) == ("lift", "left"), name
    world = build_worlds(scene, [(planted("servo_gain", scene, 0.5),)]).models[0]
    assert np.allclose(world.actuator_biasprm[:, 1] / scene.model.actuator_biasprm[:, 1], 0.5)


def test_a_lone_hinge_beside_groups_of_slides_is_no_place(tmp_path):
    turned = JAWS.replace('<joint name="lift" type="slide"', '<joint name="lift" type="hinge"')
    assert turned != JAWS
    scene = write_scene(tmp_path, turned, JAWS_ROLES + "groups: {jaws: [left, right]}\n")
    assert effect("joint_damping").elements(scene) == ("jaws",)
    # The jaws have one motor, which is named by its first joint: their group would be the same twice.
    assert effect("torque_limit").elements(scene) == ("left",)
    assert [v.label for v in local_candidates(candidate("torque_limit", scene), scene)] == ["torque_limit left"]
    assert effect("servo_gain").elements(scene) == ("lift", "left")
    world = build_worlds(scene, [(planted("servo_gain", scene, 0.5, "lift"),)]).models[0]
    assert np.allclose(world.actuator_biasprm[:, 1] / scene.model.actuator_biasprm[:, 1], [1, 0.5])
