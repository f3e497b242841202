"""What is exported is the user's model with the effects in it: every number, and no other text."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from candata.effects import effect, read_effects
from candata.errors import UnknownNameError, UsageError
from candata.repair import export_mjcf
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate.world import build_worlds
from tests.effects.gripper import play_grip
from tests.repair.rig import EDITS, MAIN, drawn, write_rig

#: Twelve digits are written; meshes are stored in single precision; MuJoCo saves whole models with six digits.
TWELVE, SINGLE, SIX = 1e-9, 1e-6, 2e-5
#: Effects that turn servos into DC motors, whose law has no room for an encoder that is off.
MOTORS = ("drive_voltage", "back_emf")


def numbers(model) -> dict[str, np.ndarray]:
    """Every array of numbers of a model, and its options."""
    found = {}
    for owner in (model, model.opt):
        for name in dir(owner):
            value = getattr(owner, name) if not name.startswith("_") else None
            if isinstance(value, np.ndarray | float | int) and not isinstance(value, bool):
                found[name] = np.asarray(value, float)
    return found


def touched(scene, effects) -> tuple[dict[str, np.ndarray], list[str]]:
    """The numbers of the model that the effects make, and which of its arrays they change."""
    own, target = numbers(scene.model), numbers(build_worlds(scene, [effects]).models[0])
    return target, [name for name in own if not np.array_equal(own[name], target[name])]


def agree(written, target: dict[str, np.ndarray], names, rtol: float) -> bool:
    """Whether arrays agree, relative to the largest number of each."""
    found = numbers(written)
    return all(
        np.abs(found[n] - target[n]).max(initial=0.0) <= rtol * np.abs(target[n]).max(initial=0.0) for n in names
    )


def export(scene, effects, out: Path):
    """The export and the scene it can be loaded as."""
    found = export_mjcf(scene, effects, out)
    return found, load_scene(out / found.scene)


@pytest.mark.parametrize("name", EDITS)
def test_the_model_of_a_patch_is_the_one_that_the_effect_makes(gripper, neck, tmp_path, name):
    scene = gripper if effect(name).possible(gripper) else neck
    effects = [drawn(name, scene)]
    found, written = export(scene, effects, tmp_path / "out")
    target, names = touched(scene, effects)
    assert (found.way, [h.name for h in found.held]) == ("patch", [name])
    assert names
    assert agree(written.model, target, target, TWELVE)


def test_a_model_of_classes_includes_and_meshes_takes_all_effects_at_once(rig, tmp_path):
    rest = ("anisotropic_friction", "object_size", *MOTORS)
    names = [name for name in EDITS if effect(name).possible(rig) and name not in rest]
    effects = [drawn(name, rig) for name in names]
    found, written = export(rig, effects, tmp_path / "out")
    target, names = touched(rig, effects)
    assert (found.way, len(found.held)) == ("patch", len(effects))
    assert agree(written.model, target, names, TWELVE)


def test_a_larger_object_grows_with_its_meshes_and_the_bodies_it_carries(rig, tmp_path):
    effects = [EffectSetting(name="object_size", parameters={"scale": 1.05})]
    found, written = export(rig, effects, tmp_path / "out")
    target, names = touched(rig, effects)
    assert found.way == "patch"
    assert {"mesh_vert", "geom_pos", "site_pos", "body_pos"} <= set(names)
    assert agree(written.model, target, set(names) - {"bvh_aabb"}, SINGLE)


def test_a_built_in_scene_is_saved_whole(hand, tmp_path):
    names = [name for name in EDITS if effect(name).possible(hand) and name != "joint_offset"]
    effects = [drawn(name, hand) for name in names]
    found, written = export(hand, effects, tmp_path / "out")
    target, names = touched(hand, effects)
    assert (found.way, len(found.held)) == ("whole", len(effects))
    assert agree(written.model, target, names, SIX)


@pytest.mark.parametrize(
    ("name", "element"),
    [
        ("servo_gain", "left"),
        ("joint_offset", "right"),
        ("sliding_friction", "left"),
        ("contact_damping", "table"),
        ("torque_limit", "right"),
        ("armature", "left"),
    ],
)
def test_a_local_effect_touches_what_it_names(rig, tmp_path, name, element):
    effects = [drawn(name, rig, element)]
    found, written = export(rig, effects, tmp_path / "out")
    target, names = touched(rig, effects)
    assert agree(written.model, target, names, TWELVE)
    assert all(element in change.element for change in found.changes)


def test_all_text_but_the_changed_tags_is_kept(rig, tmp_path):
    effects = [drawn(n, rig) for n in ("servo_gain", "support_height", "joint_dry_friction")]
    found, _ = export(rig, effects, tmp_path / "out")
    places = {(c.file, c.line) for c in found.changes}
    assert {file for file, _ in places} == {"model/rig.xml", "model/parts/world.xml"}
    for path in (p for p in Path(rig.name).parent.rglob("*") if p.is_file()):
        name = path.relative_to(Path(rig.name).parent).as_posix()
        old, new = path.read_bytes().splitlines(), (tmp_path / "out" / name).read_bytes().splitlines()
        assert len(old) == len(new)
        differing = {i for i, pair in enumerate(zip(old, new, strict=True), 1) if pair[0] != pair[1]}
        assert differing == {line for file, line in places if file == name}


def test_the_diff_patches_the_users_own_files(tmp_path):
    if shutil.which("patch") is None:
        pytest.skip("no patch program")
    # No line ends with the file.
    rig = write_rig(tmp_path / "rig", MAIN.rstrip())
    effects = [drawn(name, rig) for name in ("servo_damping", "object_mass", "gravity_tilt", "support_height")]
    found, _ = export(rig, effects, tmp_path / "out")
    mine = tmp_path / "mine"
    shutil.copytree(Path(rig.name).parent, mine)
    command = ["patch", "-p1", "-s", "-i", str(tmp_path / "out" / str(found.diff))]
    subprocess.run(command, cwd=mine, check=True)
    for name in ("model/rig.xml", "model/parts/world.xml"):
        assert (mine / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


def test_carriage_returns_stay(tmp_path):
    scene = write_rig(tmp_path / "dos")
    path = tmp_path / "dos/model/rig.xml"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    export(scene, [drawn("object_mass", scene)], tmp_path / "out")
    assert (tmp_path / "out/model/rig.xml").read_bytes().count(b"\r\n") == MAIN.count("\n")


def test_a_damping_ratio_becomes_the_damping_it_meant(tmp_path):
    scene = write_rig(
        tmp_path / "rig",
        MAIN.replace('kp="1500" kv="80"', 'kp="1500" kv="80"').replace(
            '<position class="servo" name="left" joint="left"></position>',
            '<position name="left" joint="left" kp="2" dampratio="0.7"/>',
        ),
    )
    effects = [drawn("servo_gain", scene)]
    found, written = export(scene, effects, tmp_path / "out")
    target, names = touched(scene, effects)
    assert found.way == "patch"
    assert agree(written.model, target, [*names, "actuator_biasprm"], TWELVE)


def test_a_time_constant_of_a_joint_becomes_stiffness_and_damping(tmp_path):
    scene = write_rig(tmp_path / "rig", MAIN.replace('name="left" axis', 'name="left" springdamper="0.2 1" axis'))
    effects = [drawn("joint_damping", scene)]
    found, written = export(scene, effects, tmp_path / "out")
    target, _ = touched(scene, effects)
    assert found.way == "patch"
    # The time constant is turned into numbers by MuJoCo with the inertia at rest pose.
    assert agree(written.model, target, ["dof_damping", "jnt_stiffness"], TWELVE)


def test_replicated_elements_are_saved_whole(tmp_path):
    twins = '<replicate count="2" offset="0.1 0 0"><geom type="sphere" size="0.01" pos="-0.4 0 0.3"/></replicate>'
    scene = write_rig(tmp_path / "rig", MAIN.replace("<worldbody>", f"<worldbody>{twins}"))
    effects = [drawn("sliding_friction", scene)]
    found, written = export(scene, effects, tmp_path / "out")
    target, names = touched(scene, effects)
    assert found.way == "whole"
    assert agree(written.model, target, names, SIX)


def test_a_urdf_is_saved_as_mjcf_with_its_servos(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/><link name="link"><inertial><origin xyz="0 0 .1"/><mass value="1"/>'
        '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="hinge" type="continuous"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/></joint>'
        "</robot>"
    )
    roles = "model: arm.urdf\nrate_hz: 100\njoints: [hinge]\nactuators: {hinge: {kp: 3, kv: 0.1}}\n"
    (tmp_path / "scene.yaml").write_text(roles)
    scene = load_scene(tmp_path / "scene.yaml")
    effects = [drawn("servo_gain", scene), drawn("joint_dry_friction", scene)]
    found, written = export(scene, effects, tmp_path / "out")
    target, names = touched(scene, effects)
    assert found.model == "arm.xml"
    assert agree(written.model, target, names, SIX)
    assert written.file.actuator_names == ("hinge",)


def test_the_meshes_of_a_urdf_go_along(tmp_path):
    package = tmp_path / "arm_description"
    for folder in ("urdf", "meshes/left", "meshes/right"):
        (package / folder).mkdir(parents=True)
    for side, corner in (("left", "0 0 .1"), ("right", "0 0 .2")):
        (package / f"meshes/{side}/link.obj").write_text(
            f"v 0 0 0\nv .1 0 0\nv 0 .1 0\nv {corner}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
        )
    shapes = "".join(
        f'<collision><geometry><mesh filename="package://arm_description/meshes/{side}/link.obj"/></geometry></collision>'
        for side in ("left", "right")
    )
    (package / "urdf/arm.urdf").write_text(
        f'<robot name="arm"><link name="base"/><link name="link">{shapes}<inertial><mass value="1"/>'
        '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="hinge" type="continuous"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/></joint>'
        "</robot>"
    )
    roles = "model: urdf/arm.urdf\nrate_hz: 100\njoints: [hinge]\nactuators: {hinge: {kp: 3, kv: 0.1}}\n"
    (package / "scene.yaml").write_text(roles)
    scene = load_scene(package / "scene.yaml")
    effects = [drawn("servo_gain", scene)]
    _, written = export(scene, effects, tmp_path / "out")
    shutil.rmtree(package)
    assert load_scene(tmp_path / "out" / "scene.yaml").digest == written.digest
    assert written.model.nmesh == 2
    target, names = touched(scene, effects)
    assert agree(written.model, target, names, SIX)


def test_what_the_model_cannot_hold_is_listed_and_still_runs_in_candata(gripper, tmp_path):
    outside = [drawn(n, gripper) for n in ("actuation_delay", "pose_latency", "tactile_gain", "clock_drift")]
    effects = [drawn("servo_gain", gripper), *outside]
    found, written = export(gripper, effects, tmp_path / "out")
    assert [entry.name for entry in found.left] == [s.name for s in outside]
    assert all(entry.whole and entry.apply for entry in found.left)
    rest = read_effects(tmp_path / "out" / "effects.yaml")
    assert rest.effects == tuple(outside)
    both = play_grip(gripper, [effects]).readings, play_grip(written, [rest.effects]).readings
    plain = play_grip(gripper, [[]]).readings
    for name in both[0]:
        # The same steps on numbers of twelve digits: contact multiplies the last of them a thousandfold.
        assert np.abs(both[0][name] - both[1][name]).max() < 1e-6 * max(1.0, np.abs(both[0][name]).max())
        assert np.abs(both[0][name] - plain[name]).max() > 1e-4


def test_half_of_an_encoder_offset_is_in_the_model(gripper, tmp_path):
    effects = [drawn("joint_offset", gripper)]
    found, _ = export(gripper, effects, tmp_path / "out")
    assert [h.name for h in found.held] == ["joint_offset"]
    assert [(entry.name, entry.whole) for entry in found.left] == [("joint_offset", False)]
    # Candata would turn the servos a second time.
    assert found.effects is None
    assert not (tmp_path / "out/effects.yaml").exists()


def test_an_effect_that_cannot_be_written_exactly_is_left_with_the_reason(tmp_path):
    scene = write_rig(tmp_path / "rig")
    table = tmp_path / "rig/model/parts/world.xml"
    table.write_text(table.read_text().replace("<geom", '<frame euler="0 0.4 0"><geom').replace("/>", "/></frame>"))
    scene = load_scene(tmp_path / "rig/scene.yaml")
    effects = [drawn("support_height", scene), drawn("servo_gain", scene)]
    found, written = export(scene, effects, tmp_path / "out")
    target, _ = touched(scene, effects[1:])
    assert (found.way, [h.name for h in found.held]) == ("patch", ["servo_gain"])
    assert agree(written.model, target, target, TWELVE)
    (entry,) = found.left
    assert (entry.name, entry.whole) == ("support_height", True)
    assert "geom_pos" in entry.why
    assert read_effects(tmp_path / "out/effects.yaml").effects == tuple(effects[:1])


def test_motors_take_the_servos_other_changes_and_play_alike_in_plain_mujoco(gripper, tmp_path):
    effects = [drawn(name, gripper) for name in ("servo_gain", *MOTORS, "servo_damping", "torque_limit")]
    found, written = export(gripper, effects, tmp_path / "out")
    assert (found.way, len(found.held)) == ("patch", len(effects))
    assert (tmp_path / "out/scene.xml").read_text().count("<dcmotor") == 2
    own, plain = play_grip(gripper, [effects, []]).readings, play_grip(written, [[]]).readings
    # The same steps on numbers of twelve digits: contact multiplies the last of them a thousandfold.
    joints = own["joint_position"]
    assert np.abs(plain["joint_position"][0] - joints[0]).max() < 1e-6
    assert np.abs(joints[1] - joints[0]).max() > 1e-3


def test_an_encoder_offset_stays_outside_a_motor_with_the_reason(gripper, tmp_path):
    effects = [drawn("drive_voltage", gripper), drawn("joint_offset", gripper)]
    found, _ = export(gripper, effects, tmp_path / "out")
    assert [h.name for h in found.held] == ["drive_voltage"]
    (entry,) = found.left
    assert "encoder that is off" in entry.why


def test_an_existing_folder_is_refused_and_left_alone(gripper, tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(UsageError, match="exists"):
        export_mjcf(gripper, [drawn("servo_gain", gripper)], tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_effects_that_cannot_act_are_refused_before_anything_is_written(gripper, tmp_path):
    arm = [EffectSetting(name="servo_gain", element="elbow", parameters={"kp_scale": 0.7})]
    with pytest.raises(UnknownNameError, match="elbow"):
        export_mjcf(gripper, arm, tmp_path / "out")
    with pytest.raises(UsageError, match="cannot act"):
        export_mjcf(load_scene("cube_toss"), [drawn("servo_gain", gripper)], tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_the_list_of_edits_is_the_folder():
    assert effect("clock_drift").pace is not None
    assert len(EDITS) > 20
