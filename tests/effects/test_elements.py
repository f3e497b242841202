"""A local cause is the same effect on one element, and acts nowhere else."""

from __future__ import annotations

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from candata.effects import active, effect, effect_names, flatten, setting
from candata.errors import UnknownNameError, UsageError
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate.world import build_worlds
from tests.effects.gripper import ROLES, XML, play_grip, write_scene

#: A joint of the hand, and the fingertip that it moves.
JOINT = "index2"
NAMES = effect_names()
TACTILE = ["tactile_gain", "tactile_bias", "tactile_dead_band", "tactile_lag"]
CONTACT = ["sliding_friction", "torsional_friction", "rolling_friction", "contact_compliance", "contact_damping"]
HAND = load_scene("xhand_tabletop")
LOCAL = [n for n in NAMES if effect(n).elements(HAND)]
ELSEWHERE = [n for n in NAMES if n not in LOCAL and effect(n).acts_on != "link"]
EDITS = [n for n in LOCAL if effect(n).acts_on == "joint" and effect(n).edit]
#: Fields of the model that a joint effect may change, one row a degree of freedom, a joint or an actuator.
BY_DOF = ("dof_damping", "dof_frictionloss", "dof_armature")
BY_JOINT = ("jnt_stiffness",)
BY_ACTUATOR = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")


@pytest.fixture(scope="module")
def scene():
    return HAND


def probe(name: str, scene, element: str | None, nth: int = -1) -> EffectSetting:
    x = flatten(EffectSetting(name=name), scene)
    x[:] = effect(name).parameters[0].probes(scene)[nth]
    return setting(name, x, scene, element)


@pytest.mark.parametrize("name", EDITS)
@pytest.mark.parametrize("element", [JOINT, None])
def test_a_joint_effect_edits_its_joint_only(scene, name, element):
    model = build_worlds(scene, [(probe(name, scene, element),)]).models[0]
    expected = {JOINT} if element else {scene.file.joints[i] for i in scene.driven_hinges}
    for field in BY_DOF + BY_JOINT + BY_ACTUATOR:
        now, before = getattr(model, field), getattr(scene.model, field)
        changed = np.flatnonzero((now != before).reshape(len(now), -1).any(1))
        if not len(changed):
            continue
        joints = model.actuator_trnid[changed, 0] if field in BY_ACTUATOR else changed
        joints = model.dof_jntid[changed] if field in BY_DOF else joints
        assert {model.joint(int(j)).name for j in joints} == expected, field


@pytest.mark.parametrize("name", EDITS)
def test_a_joint_effect_edits_the_joints_of_its_group_only(scene, name):
    model = build_worlds(scene, [(probe(name, scene, "index"),)]).models[0]
    rows = {
        f: len(
            np.flatnonzero((getattr(model, f) != getattr(scene.model, f)).reshape(len(getattr(model, f)), -1).any(1))
        )
        for f in BY_DOF + BY_JOINT + BY_ACTUATOR
    }
    assert set(rows.values()) == {0, len(scene.file.groups["index"])}


@pytest.mark.parametrize("name", ["actuation_delay", "servo_gain", "servo_damping"])
def test_what_has_the_same_unit_there_acts_on_a_wrist_on_rails(scene, name, rng):
    world = build_worlds(scene, [(probe(name, scene, "wrist"),)])
    if effect(name).edit:
        changed = (world.models[0].actuator_biasprm != scene.model.actuator_biasprm).any(1)
        found = {scene.model.actuator(int(a)).name for a in np.flatnonzero(changed)}
    else:
        steps = world.command[0].state.steps[0]
        found = {a for a, late in zip(scene.file.actuator_names, steps, strict=True) if late}
    assert found == set(scene.file.groups["wrist"])


@pytest.mark.parametrize("name", ["torque_limit", "joint_damping", "joint_offset", "backlash"])
def test_what_has_another_unit_there_does_not(scene, name):
    assert "wrist" not in effect(name).elements(scene)
    with pytest.raises(UnknownNameError, match="wrist"):
        build_worlds(scene, [(probe(name, scene, "wrist"),)])


def test_a_group_of_all_or_of_one_joint_is_no_element_of_its_own(scene):
    groups = {
        "fingers": scene.file.joints[3:],
        "one": (JOINT,),
        "none": (),
        "mixed": ("wrist_x", JOINT),
        "two": ("index1", JOINT),
    }
    other = replace(scene, file=scene.file.model_copy(update={"groups": groups}))
    assert effect("joint_damping").elements(other)[12:] == ("two",)
    # A wrist's slides in no group are elements of what a share or a time says.
    assert effect("servo_gain").elements(other)[12:] == ("wrist_y", "wrist_z", "mixed", "two")


def whole(model) -> bytes:
    """Everything that a model holds."""
    buffer = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def test_a_joint_effect_edits_something(scene):
    for name in EDITS:
        model = build_worlds(scene, [(probe(name, scene, JOINT),)]).models[0]
        assert whole(model) != whole(scene.model), name


def test_the_scene_s_own_model_stays_as_it_is(scene):
    before = scene.digest
    build_worlds(scene, [(probe(name, scene, None),) for name in NAMES if effect(name).possible(scene)])
    assert load_scene("xhand_tabletop").digest == before


@pytest.mark.parametrize("element", [JOINT, None])
def test_a_delay_moves_the_commands_of_its_joint_only(scene, element, rng):
    hook = build_worlds(scene, [(probe("actuation_delay", scene, element),)]).command[0]
    state = hook.state
    commands = rng.standard_normal((6, 1, scene.substeps, len(scene.actuator_ids)))
    late = []
    for u in commands:
        state, x = hook.apply(state, u)
        late.append(x)
    changed = (np.array(late) != commands).any((0, 1, 2))
    expected = {JOINT} if element else {scene.file.joints[i] for i in scene.driven_hinges}
    assert {a for a, c in zip(scene.file.actuator_names, changed, strict=True) if c} == expected


@pytest.mark.parametrize("element", [JOINT, None])
def test_backlash_moves_the_commands_of_its_joint_only(scene, element, rng):
    hook = build_worlds(scene, [(probe("backlash", scene, element),)]).command[0]
    commands = rng.standard_normal((1, scene.substeps, len(scene.actuator_ids)))
    changed = (hook.apply(hook.state, commands)[1] != commands).any((0, 1))
    expected = {JOINT} if element else {scene.file.joints[i] for i in scene.driven_hinges}
    assert {a for a, c in zip(scene.file.actuator_names, changed, strict=True) if c} == expected


@pytest.mark.parametrize("name", TACTILE)
def test_a_tactile_effect_moves_its_fingertip_only(scene, name):
    hook = build_worlds(scene, [(probe(name, scene, JOINT),)]).reading[0]
    state, _ = hook.apply(hook.state, {"fingertip_force": np.zeros((1, 5, 3))})
    force = np.full((1, 5, 3), 0.05)
    _, readings = hook.apply(state, {"fingertip_force": force})
    changed = (readings["fingertip_force"] != force).any((0, 2))
    assert [t for t, c in zip(scene.file.fingertips, changed, strict=True) if c] == [JOINT]


def test_an_offset_is_read_at_its_joint_only(scene):
    hook = build_worlds(scene, [(probe("joint_offset", scene, JOINT),)]).reading[0]
    _, readings = hook.apply(hook.state, {"joint_position": np.zeros((1, len(scene.file.joints)))})
    changed = np.flatnonzero(readings["joint_position"][0])
    assert [scene.file.joints[i] for i in changed] == [JOINT]


@pytest.mark.parametrize(
    ("name", "element", "numbers"),
    [("joint_offset", JOINT, 1), ("joint_offset", "index", 3), ("tactile_bias", JOINT, 3)],
)
def test_a_vector_on_one_element_holds_its_numbers_only(scene, name, element, numbers):
    x = np.zeros(len(active(name, scene)))
    x[active(name, scene, element)] = 0.05
    given = setting(name, x, scene, element)
    value = given.parameters[effect(name).parameters[0].name]
    assert np.size(value) == numbers == active(name, scene, element).sum()
    assert np.array_equal(flatten(given, scene), x)


def test_a_wrong_count_on_one_element_is_refused(scene):
    with pytest.raises(UsageError, match=r"expected: 1 number\(s\)"):
        flatten(EffectSetting(name="joint_offset", element=JOINT, parameters={"offset_rad": (0.1, 0.2)}), scene)


def test_an_actuator_of_a_tendon_drives_no_joint(tmp_path):
    # The tendon's id is 0, the id of the first joint, too.
    tendon = '<tendon><fixed name="both"><joint joint="right" coef="1"/></fixed></tendon>'
    xml = XML.replace("<actuator>", f"{tendon}<actuator>").replace(
        '<position name="lift" joint="lift" kp="1500" kv="80" forcerange="-60 60"/>',
        '<position name="lift" tendon="both"/>',
    )
    scene = write_scene(tmp_path, xml)
    assert scene.driven_joints == {1: 1, 2: 2}


@pytest.mark.parametrize("name", CONTACT)
@pytest.mark.parametrize("element", ["left", "table"])
def test_a_contact_effect_edits_the_pairs_of_its_element_only(gripper, name, element):
    if element not in effect(name).elements(gripper):
        pytest.skip("fingertips only")
    model = build_worlds(gripper, [(probe(name, gripper, element),)]).models[0]
    fields = ("pair_friction", "pair_solref")
    changed = np.logical_or.reduce([(getattr(model, f) != getattr(gripper.model, f)).any(1) for f in fields])
    geom = model.geom(element).id
    assert changed.tolist() == ((model.pair_geom1 == geom) | (model.pair_geom2 == geom)).tolist()


def contacts(scene, given):
    """`(tip, friction, solref, solimp, dim)` of every contact of fingertips that press into the object."""
    model = build_worlds(scene, [given]).models[0]
    data = mujoco.MjData(model)
    at = scene.object_qpos
    found = []
    for tip in scene.file.fingertips:
        mujoco.mj_resetDataKeyframe(model, data, model.key("grasp").id)
        mujoco.mj_kinematics(model, data)
        geom = model.geom(tip).id
        data.qpos[at : at + 3] = data.geom_xpos[geom] + (0.03, 0, 0)
        mujoco.mj_forward(model, data)
        own = set(scene.object_geoms.tolist())
        for c in data.contact:
            if geom in c.geom and own & set(c.geom.tolist()):
                found.append((tip, *c.friction, *c.solref, *c.solimp, c.dim))
    return found


@pytest.mark.parametrize("name", CONTACT)
def test_a_contact_effect_on_one_fingertip_changes_its_contacts_only(scene, name):
    before, after = contacts(scene, ()), contacts(scene, (probe(name, scene, JOINT, 0),))
    assert {c[0] for c in before} == set(scene.file.fingertips)
    assert {b[0] for b, a in zip(before, after, strict=True) if a != b} == {JOINT}


def test_one_fingertip_can_be_more_slippery_than_the_object(scene):
    half = EffectSetting(name="sliding_friction", element=JOINT, parameters={"scale": 0.5})
    for b, a in zip(contacts(scene, ()), contacts(scene, (half,)), strict=True):
        assert a[1] == pytest.approx(b[1] * (0.5 if a[0] == JOINT else 1.0), rel=1e-12)
        assert a[3:] == b[3:], "nothing else moves"


@pytest.mark.parametrize("name", CONTACT)
def test_all_fingertips_together_are_an_element_beside_each_and_the_support(scene, gripper, name):
    tips = name == "torsional_friction"  # acts on nothing else anyway
    assert effect(name).elements(gripper) == ("left", "right", *(() if tips else ("fingertips", "table")))
    assert "fingertips" in effect(name).elements(scene) or tips


def test_what_touches_nothing_but_fingertips_has_no_element_of_all(tmp_path):
    held = re.sub("<pair[^>]*table[^>]*>|<geom name=.table[^>]*>", "", XML)
    scene = write_scene(tmp_path, held, ROLES.replace("support: table\n", ""))
    assert effect("sliding_friction").elements(scene) == ("left", "right")


def test_a_support_may_have_that_name(tmp_path):
    scene = write_scene(tmp_path, XML.replace("table", "fingertips"), ROLES.replace("table", "fingertips"))
    assert effect("sliding_friction").elements(scene) == ("left", "right", "fingertips")
    model = build_worlds(scene, [(probe("sliding_friction", scene, "fingertips"),)]).models[0]
    changed = (model.pair_friction != scene.model.pair_friction).any(1)
    assert changed.tolist() == ((model.pair_geom1 == 0) | (model.pair_geom2 == 0)).tolist(), "the support's own"


def test_all_fingertips_are_scaled_and_the_support_is_not(scene, gripper):
    half = EffectSetting(name="sliding_friction", element="fingertips", parameters={"scale": 0.5})
    for b, a in zip(contacts(scene, ()), contacts(scene, (half,)), strict=True):
        assert a[1] == pytest.approx(0.5 * b[1], rel=1e-12)
        assert a[3:] == b[3:], "nothing else moves"
    model, table = build_worlds(scene, [(half,)]).models[0], scene.model.geom("table").id
    assert model.geom_friction[table].tolist() == scene.model.geom_friction[table].tolist()
    assert model.geom_priority[table] == scene.model.geom_priority[table]
    model = build_worlds(gripper, [(half,)]).models[0]
    scale = model.pair_friction[:, 0] / gripper.model.pair_friction[:, 0]
    assert scale.tolist() == [
        1.0 if model.geom("table").id in ends else 0.5 for ends in zip(model.pair_geom1, model.pair_geom2, strict=True)
    ]


@pytest.mark.parametrize("name", LOCAL)
def test_an_unknown_element_is_refused(scene, name):
    with pytest.raises(UnknownNameError, match="index_2"):
        build_worlds(scene, [(probe(name, scene, "index_2"),)])


@pytest.mark.parametrize("name", ELSEWHERE)
def test_an_effect_without_elements_refuses_one(gripper, name):
    with pytest.raises(UsageError, match=f"effect {name} has no elements"):
        build_worlds(gripper, [(probe(name, gripper, "left"),)])


@pytest.mark.parametrize("name", LOCAL)
def test_every_element_that_is_offered_can_be_given(gripper, name):
    elements = effect(name).elements(gripper)
    assert elements
    worlds = [(), *((probe(name, gripper, element, 0),) for element in elements)]
    readings = play_grip(gripper, worlds).readings
    for row in range(1, len(worlds)):
        assert any(not np.array_equal(v[row], v[0]) for v in readings.values()), worlds[row]


def test_an_effect_is_one_line():
    assert repr(effect("joint_damping")) == (
        "Effect('viscous damping is added to the joints', damping_Nms_rad [N m s/rad])"
    )
