"""Jaws on rails: joint and drive effects act on slides that move some fingertips and not others, in m and N."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import _select as select
from candata.effects import effect, flatten, parameters_on, rail_units, setting
from candata.errors import UnknownNameError, UsageError
from candata.gap.fit.candidates import candidate, is_on_slides, local_candidates, probes
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from candata.simulate.world import build_worlds
from tests.effects.gripper import write_scene
from tests.policies.unknown_hands import JAWS, JAWS_ROLES

JOINT = ("joint_damping", "joint_dry_friction", "armature", "joint_offset")
MOTOR = ("torque_limit", "backlash")
FIELD = {"joint_damping": "dof_damping", "joint_dry_friction": "dof_frictionloss", "armature": "dof_armature"}


@pytest.fixture
def jaws(tmp_path):
    """Two jaws that one motor closes, on a rail: all that is driven slides."""
    return write_scene(tmp_path, JAWS, JAWS_ROLES)


@pytest.fixture
def turned(tmp_path):
    """The jaws on a hinge, each with a motor of its own."""
    own = JAWS.replace('<joint name="lift" type="slide"', '<joint name="lift" type="hinge"')
    tendon = own.index("<tendon>"), own.index("</equality>") + len("</equality>")
    own = own[: tendon[0]] + own[tendon[1] :]
    motor = '<position name="{0}" joint="{0}" kp="300" kv="5" forcerange="-9 9"/>'
    general = own[own.index("<general") : own.index("<position")]
    own = own.replace(general, motor.format("left") + motor.format("right"))
    return write_scene(tmp_path, own, JAWS_ROLES.replace("[jaws, lift]", "[left, right, lift]"))


def test_jaws_are_slides_that_move_some_fingertips(jaws, turned):
    for scene in (jaws, turned):
        assert [scene.file.joints[i] for i in select.jaws(scene)] == ["left", "right"]
    # A wrist on rails moves all fingertips.
    assert len(select.jaws(load_scene("xhand_tabletop"))) == 0
    assert "wrist" not in effect("joint_damping").elements(load_scene("xhand_tabletop"))


def test_where_all_that_is_driven_slides_the_jaws_stand_for_hinges(jaws):
    for name in JOINT:
        assert effect(name).possible(jaws)
        assert effect(name).elements(jaws) == ("left", "right"), name
    for name in MOTOR:
        assert effect(name).elements(jaws) == ("left",), name
    dofs = jaws.joint_dof[[1, 2]]
    for name, field in FIELD.items():
        x = np.array(parameters_on(name, jaws)[0].probes(jaws)[-1:])
        model = build_worlds(jaws, [(setting(name, x, jaws),)]).models[0]
        assert np.flatnonzero(getattr(model, field) != getattr(jaws.model, field)).tolist() == dofs.tolist(), name


def test_beside_hinges_each_jaw_is_a_place_of_its_own(turned):
    for name in (*JOINT, *MOTOR):
        assert effect(name).elements(turned) == ("left", "right"), name
        # The whole is the hinge; on jaws it does nothing, so that no screen by it speaks of them.
        assert all(is_on_slides(v, turned) for v in local_candidates(candidate(name, turned), turned)), name
    assert local_candidates(candidate("joint_damping", turned, "left"), turned) == []
    for name, field in FIELD.items():
        for element, own in ((None, [0]), ("left", [1]), ("right", [2])):
            x = np.array(parameters_on(name, turned, element)[0].probes(turned)[-1:])
            model = build_worlds(turned, [(setting(name, x, turned, element),)]).models[0]
            changed = np.flatnonzero(getattr(model, field) != getattr(turned.model, field))
            assert changed.tolist() == turned.joint_dof[own].tolist(), (name, element)


def test_shares_and_times_are_those_of_hinges_and_jaws_together(turned):
    for name in ("servo_gain", "servo_damping", "actuation_delay"):
        assert effect(name).elements(turned) == ("lift", "left", "right"), name
        assert not any(is_on_slides(v, turned) for v in local_candidates(candidate(name, turned), turned)), name
    model = build_worlds(turned, [(setting("servo_gain", np.array([0.5]), turned),)]).models[0]
    assert np.allclose(model.actuator_biasprm[:, 1] / turned.model.actuator_biasprm[:, 1], 0.5)


@pytest.mark.usefixtures("turned")
def test_jaws_in_a_group_are_named_by_it(tmp_path):
    xml, roles = ((tmp_path / name).read_text() for name in ("scene.xml", "scene.yaml"))
    grouped = write_scene(tmp_path, xml, roles + "groups: {both: [left, right]}\n")
    assert effect("joint_damping").elements(grouped) == ("both",)
    mixed = write_scene(tmp_path, xml, roles + "groups: {odd: [lift, left]}\n")
    # What is N m here and N there has no number for both; a share has.
    assert effect("joint_damping").elements(mixed) == ("left", "right")
    assert effect("servo_gain").elements(mixed) == ("lift", "left", "right", "odd")


def test_numbers_on_rails_are_in_metres_and_newtons(jaws, turned):
    units = {
        "joint_damping": "N s/m",
        "joint_dry_friction": "N",
        "armature": "kg",
        "joint_offset": "m",
        "torque_limit": "N",
        "backlash": "m",
    }
    for name, unit in units.items():
        (parameter,) = effect(name).parameters
        assert rail_units(name, jaws) == rail_units(name, turned, "left") == {parameter.name: unit}
        assert rail_units(name, turned) == {}
    assert rail_units("servo_gain", turned, "left") == {}
    with pytest.raises(UnknownNameError):
        parameters_on("joint_damping", turned, "no_such")


def test_ranges_are_those_of_the_jaws(turned):
    # A motor of 9 N: geared servos lose 2 to 20 % of it to dry friction.
    (there,) = parameters_on("joint_dry_friction", turned, "left")
    assert there.bounds(turned) == pytest.approx((0, 0.6 * 9))
    assert np.ravel(there.draws(turned)) == pytest.approx([0.04 * 9, 0.15 * 9])
    assert there.neutral is None
    assert there.identity(turned) == 0
    # 40 mm of travel are what 1.5 rad are to a hinge.
    (offset,) = parameters_on("joint_offset", turned, "left")
    assert offset.probes(turned) == pytest.approx([0.03 * 0.04 / 1.5])
    (limit,) = parameters_on("torque_limit", turned, "right")
    assert limit.neutral is not None
    assert limit.neutral(turned) >= 9
    c = candidate("joint_dry_friction", turned, "left")
    assert c.high[0] == pytest.approx(5.4)
    assert max(p[0] for p in probes(c, turned)) == pytest.approx(0.18 * 9)
    with pytest.raises(UsageError, match=r"in \[0, 5.4\] N$|in \[0, 5.4\] N\n"):
        flatten(EffectSetting(name="joint_dry_friction", element="left", parameters={"frictionloss_Nm": 6.0}), turned)


def test_an_encoder_of_a_jaw_is_off_and_no_other(turned):
    off = EffectSetting(name="joint_offset", element="left", parameters={"offset_rad": 0.002})
    x = flatten(off, turned)
    assert x.tolist() == [0, 0.002, 0]
    assert setting("joint_offset", x, turned, "left") == off
    # As a whole it is the hinge's: one number, which says nothing of the jaws.
    whole = EffectSetting(name="joint_offset", parameters={"offset_rad": 0.05})
    assert flatten(whole, turned).tolist() == [0.05, 0, 0]
    assert setting("joint_offset", flatten(whole, turned), turned) == whole
    commands = np.tile([0.01, 0.01, 0.0], (1, 200, 1))
    read = rollout(turned, commands, *at_rest(turned, 1), [(off,)], keep_state=True)
    at = turned.joint_qpos[1:]
    # The servo brings what is read to the command; the jaw stands beside it.
    assert read.readings["joint_position"][0, -1, 1:] == pytest.approx([0.01, 0.01], abs=2e-4)
    assert read.qpos[0, -1, at] == pytest.approx([0.008, 0.01], abs=2e-4)


def test_a_thrown_hinge_that_nothing_drives_is_on_no_rails(tmp_path):
    thrown = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
      <body name="elbow" pos="0 0 1"><freejoint/><geom type="box" size=".03 .02 .02" mass=".1"/>
        <body pos=".05 0 0"><joint name="hinge" axis="0 1 0"/><geom type="box" size=".03 .02 .02" mass=".1"/></body>
      </body></worldbody></mujoco>"""
    scene = write_scene(
        tmp_path, thrown, "model: scene.xml\nrate_hz: 100\nobject: elbow\njoints: [hinge]\nsupport: floor\n"
    )
    assert effect("joint_damping").elements(scene) == ("hinge",)
    assert rail_units("joint_damping", scene, "hinge") == rail_units("joint_damping", scene) == {}
    assert local_candidates(candidate("joint_damping", scene), scene) == []
