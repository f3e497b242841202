"""A local cause is the same effect on one element, and acts nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from candata.effects import effect, effect_names, flatten, setting
from candata.errors import UnknownNameError, UsageError
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate.world import build_worlds

JOINT = "index2"
EDITS = [n for n in effect_names() if effect(n).acts_on == "joint" and effect(n).edit]
ELSEWHERE = [n for n in effect_names() if effect(n).acts_on in ("object", "world")]
#: Fields of the model that a joint effect may change, one row a joint of freedom or an actuator.
BY_DOF = ("dof_damping", "dof_frictionloss", "dof_armature")
BY_ACTUATOR = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")


@pytest.fixture(scope="module")
def scene():
    return load_scene("xhand_tabletop")


def probe(name: str, scene, element: str | None) -> EffectSetting:
    x = flatten(EffectSetting(name=name), scene)
    x[:] = effect(name).parameters[0].probes(scene)[-1]
    return setting(name, x, scene, element)


@pytest.mark.parametrize("name", EDITS)
@pytest.mark.parametrize("element", [JOINT, None])
def test_a_joint_effect_edits_its_joint_only(scene, name, element):
    model = build_worlds(scene, [(probe(name, scene, element),)]).models[0]
    expected = {JOINT} if element else {scene.file.joints[i] for i in scene.driven_hinges}
    for field in BY_DOF + BY_ACTUATOR:
        now, before = getattr(model, field), getattr(scene.model, field)
        changed = np.flatnonzero((now != before).reshape(len(now), -1).any(1))
        if not len(changed):
            continue
        joints = model.dof_jntid[changed] if field in BY_DOF else model.actuator_trnid[changed, 0]
        assert {model.joint(int(j)).name for j in joints} == expected, field


def test_a_joint_effect_edits_something(scene):
    for name in EDITS:
        model = build_worlds(scene, [(probe(name, scene, JOINT),)]).models[0]
        assert any(not np.array_equal(getattr(model, f), getattr(scene.model, f)) for f in BY_DOF + BY_ACTUATOR), name


def test_the_scene_s_own_model_stays_as_it_is(scene):
    before = scene.digest
    build_worlds(scene, [(probe(name, scene, None),) for name in effect_names()])
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


@pytest.mark.parametrize("name", ["tactile_gain", "tactile_bias"])
def test_a_tactile_effect_moves_its_fingertip_only(scene, name):
    hook = build_worlds(scene, [(probe(name, scene, JOINT),)]).reading[0]
    force = np.ones((1, 5, 3))
    _, readings = hook.apply(hook.state, {"fingertip_force": force})
    changed = (readings["fingertip_force"] != force).any((0, 2))
    assert [t for t, c in zip(scene.file.fingertips, changed, strict=True) if c] == [JOINT]


@pytest.mark.parametrize("name", [*EDITS, "actuation_delay", "tactile_gain", "tactile_bias"])
def test_an_unknown_element_is_refused(scene, name):
    with pytest.raises(UnknownNameError, match="index_2"):
        build_worlds(scene, [(probe(name, scene, "index_2"),)])


@pytest.mark.parametrize("name", ELSEWHERE)
def test_an_effect_without_elements_refuses_one(scene, name):
    with pytest.raises(UsageError, match=f"effect {name} has no elements"):
        build_worlds(scene, [(probe(name, scene, JOINT),)])
