"""A drafted scene file: it loads as written, and its roles are those that a reader of the model would choose."""

from __future__ import annotations

import mujoco
import pytest

from candata.errors import SceneError, UsageError
from candata.scenes import load_scene
from candata.scenes.contract import SCENES
from candata.scenes.draft import write_draft
from candata.schema.scene import SceneFile
from candata.schema.yaml_text import parse_yaml
from tests.policies.unknown_hands import FOUR_FINGERS, JAWS
from tests.scenes import hand_models as models

FF = {f: tuple(f"{f}j{i}" for i in range(4)) for f in models.FINGERS}
SHORT = {f: own[:2] for f, own in FF.items()}
TIPS = tuple(f"{f}_tip" for f in models.FINGERS)


def drafted(folder, text: str, name: str = "hand.xml") -> SceneFile:
    """The roles that are written for a model, as they are read again."""
    (folder / name).write_text(text)
    scene, _ = write_draft(folder / name, folder / "scene.yaml")
    again = load_scene(folder / "scene.yaml")
    assert (again.digest, again.file.model) == (scene.digest, name)
    return again.file


@pytest.mark.parametrize("name", SCENES.names())
def test_the_roles_of_a_built_in_scene_are_found_in_its_model(tmp_path, name):
    builtin = SCENES.load(name)
    spec: mujoco.MjSpec = builtin.build()
    spec.compile()
    found, own = drafted(tmp_path, spec.to_xml()), builtin.file
    assert (found.joints, found.actuator_names, found.object) == (own.joints, own.actuator_names, own.object)
    assert set(found.fingertips) == set(own.fingertips)
    fingers = {frozenset(members) for group, members in own.groups.items() if group != "wrist"}
    assert fingers <= {frozenset(members) for members in found.groups.values()}


def test_the_roles_of_the_example_s_hand_are_found(tmp_path):
    found = drafted(tmp_path, FOUR_FINGERS.with_name("scene.xml").read_text())
    own = SceneFile.parse(parse_yaml(FOUR_FINGERS.read_text()), FOUR_FINGERS)
    for role in ("joints", "actuators", "fingertips", "object", "support", "rate_hz"):
        assert getattr(found, role) == getattr(own, role), role
    assert found.groups == {name: members for name, members in own.groups.items() if name != "wrist"}


def test_tips_that_are_bodies_without_a_joint(tmp_path):
    found = drafted(tmp_path, models.TIP_BODIES)
    assert (found.joints, found.groups) == (tuple(models.joints()), FF)
    assert found.actuators == tuple(f"{name}_drive" for name in models.joints())
    assert (found.fingertips, found.object, found.support) == (TIPS, None, None)


def test_tips_that_are_geoms_and_an_object_beside_a_target_that_only_shows(tmp_path):
    found = drafted(tmp_path, models.TIP_GEOMS)
    assert (found.fingertips, found.object, found.support) == (TIPS, "cube", "floor")


def test_tendons_a_wrist_and_tips_that_sites_mark(tmp_path):
    found = drafted(tmp_path, models.TENDONS)
    assert found.fingertips == tuple(f"rh:{f}_2" for f in models.FINGERS)
    assert found.groups["wrist"] == ("rh:WRJ1", "rh:WRJ0")
    assert found.groups["FF"] == ("rh:FFJ0", "rh:FFJ1", "rh:FFJ2")
    assert list(found.groups) == ["wrist", "FF", "MF", "RF", "TH"]
    text = (tmp_path / "scene.yaml").read_text()
    assert "# fingertip_frames: [rh:fftip, rh:mftip, rh:rftip, rh:thtip]\n" in text


def test_tendons_over_sites_move_a_hand_too(tmp_path):
    text = models.TIP_BODIES.replace("</body></worldbody>", '<site name="motor" pos=".1 0 0"/></body></worldbody>')
    text = text.replace('<joint name="ffj3"', '<site name="pulley" pos="0 .01 .01"/><joint name="ffj3"')
    before, after = text.split("<actuator>")[0], "</mujoco>"
    spatial = '<tendon><spatial name="cord"><site site="motor"/><site site="pulley"/></spatial></tendon>'
    drive = '<actuator><motor name="winch" tendon="cord" gear="10"/></actuator>'
    found = drafted(tmp_path, before + spatial + drive + after)
    assert (found.joints, found.actuators, found.groups) == (tuple(models.joints()), ("winch",), FF)


def test_a_hand_on_an_arm_and_two_free_bodies(tmp_path):
    found = drafted(tmp_path, models.ON_ARM)
    assert (found.object, found.support, found.fingertips) == ("can", "top", TIPS)
    assert found.groups == {"arm": tuple(f"arm{i}" for i in range(4)), **SHORT}
    assert "the likeliest of can, mug" in (tmp_path / "scene.yaml").read_text()


def test_a_hand_that_floats_is_tracked_itself_where_nothing_else_is_free(tmp_path):
    found = drafted(tmp_path, models.FLOATING)
    assert (found.object, found.fingertips, found.groups) == ("palm", TIPS, SHORT)
    assert "It is the floating base of the robot" in (tmp_path / "scene.yaml").read_text()
    with_cube = models.FLOATING.replace("</worldbody>", f"{models.CUBE}</worldbody>")
    assert drafted(tmp_path / "..", with_cube).object == "cube"


def test_a_hand_that_is_held_by_a_weld_does_not_float(tmp_path):
    held = '<equality><weld body1="mocap" body2="palm"/></equality></mujoco>'
    text = models.FLOATING.replace("<worldbody>", '<worldbody><body name="mocap" mocap="true" pos="0 0 .3"/>')
    found = drafted(tmp_path, text.replace("</mujoco>", held))
    assert (found.object, found.fingertips) == (None, TIPS)


def test_a_tip_whose_name_another_body_bears_is_named_by_its_body(tmp_path):
    text = models.TIP_GEOMS.replace("</worldbody>", '<body name="ff_tip" pos="1 0 0"/></worldbody>')
    assert drafted(tmp_path, text).fingertips == ("ff_3", "mf_tip", "rf_tip", "th_tip")


def test_jaws_on_rails_that_one_tendon_pulls(tmp_path):
    found = drafted(tmp_path, JAWS)
    assert (found.joints, found.actuators) == (("lift", "left", "right"), ("jaws", "lift"))
    assert (set(found.fingertips), found.object, found.support) == ({"left", "right"}, "cube", "floor")


def test_a_urdf_gets_guessed_gains_for_what_no_joint_leads(tmp_path):
    found = drafted(tmp_path, models.URDF, "hand.urdf")
    assert isinstance(found.actuators, dict)
    assert list(found.actuators) == ["index_bend", "index_curl", "thumb_bend", "thumb_curl"]
    assert {servo.limit for servo in found.actuators.values()} == {0.8}
    assert all(servo.kp > 0 and servo.kv > 0 for servo in found.actuators.values())
    assert found.joints[2] == "index_follow"
    assert found.fingertips == ("index_tip", "thumb_outer")
    assert found.groups == {"index": ("index_bend", "index_curl"), "thumb": ("thumb_bend", "thumb_curl")}
    assert "# THE GAINS ARE GUESSED" in (tmp_path / "scene.yaml").read_text()


def test_guessed_gains_hold_a_hand_still(tmp_path):
    drafted(tmp_path, models.URDF, "hand.urdf")
    scene = load_scene(tmp_path / "scene.yaml")
    data = mujoco.MjData(scene.model)
    data.ctrl[:] = 0.5
    for _ in range(1000):
        mujoco.mj_step(scene.model, data)
    driven = [scene.driven_joints[a] for a in scene.actuator_ids]
    # Gravity bends a finger of 50 g links by less than a tenth of a radian.
    assert abs(data.qpos[scene.model.jnt_qposadr[driven]] - 0.5).max() < 0.1


@pytest.mark.parametrize(
    ("step", "rate"),
    [("0.002", 100), ("0.0025", 100), ("0.001", 100), ("0.005", 100), ("0.004", 125), ("0.02", 50), ("0.003", 111.111)],
)
def test_the_rate_fits_the_physics_step(tmp_path, step, rate):
    assert drafted(tmp_path, models.TIP_BODIES.replace('timestep="0.002"', f'timestep="{step}"')).rate_hz == rate


def test_names_that_yaml_would_read_otherwise_are_quoted(tmp_path):
    text = models.TIP_BODIES
    for before, after in (("ffj0", "1"), ("ffj1", "true"), ("ffj2", "a, b"), ("ffj3", "é: x # y"), ("mfj0", "on")):
        text = text.replace(f'"{before}"', f'"{after}"')
    assert drafted(tmp_path, text).joints[:5] == ("1", "true", "a, b", "é: x # y", "on")
    assert 'joints: ["1", "true", "a, b", "é: x # y", on,' in (tmp_path / "scene.yaml").read_text()


def test_parts_without_a_name_are_counted(tmp_path):
    text = models.TIP_BODIES.replace('joint name="ffj3"', "joint")
    drive = '<position name="{name}_drive" joint="{name}" kp="3" kv=".05" forcerange="-1 1"/>'
    text = text.replace(drive.format(name="ffj3"), "")
    text = text.replace(drive.format(name="mfj0"), '<position joint="mfj0" kp="3"/>')
    _, proposal = write_draft_of(tmp_path, text)
    assert proposal.notes == (
        "1 joint of the model without a name cannot be listed: name it there",
        "1 actuator of the model without a name cannot be listed: name it there",
    )
    assert "# 1 actuator of the model without a name" in (tmp_path / "scene.yaml").read_text()


def test_joints_that_nothing_drives_are_offered(tmp_path):
    door = '<body name="door" pos="1 0 0"><joint name="door" axis="0 0 1"/><geom type="box" size=".01 .2 .2"/></body>'
    found = drafted(tmp_path, models.TIP_BODIES.replace("</worldbody>", f"{door}</worldbody>"))
    assert "door" not in found.joints
    assert "# Nothing drives these; add those that are recorded: door\n" in (tmp_path / "scene.yaml").read_text()


def test_a_robot_without_fingertips_in_its_model(tmp_path):
    arm = '<body name="a"><joint name="bend"/><geom size=".1" contype="0" conaffinity="0"/></body>'
    text = f'<mujoco><worldbody>{arm}</worldbody><actuator><motor name="bend" joint="bend"/></actuator></mujoco>'
    _, proposal = write_draft_of(tmp_path, text)
    assert proposal.fingertips == ()
    assert "no fingertips were found" in proposal.open_questions


def test_a_tossed_object_with_a_joint_of_its_own(tmp_path):
    lid = '<body name="lid" pos=".2 0 0"><joint name="lid"/><geom type="box" size=".1 .1 .1"/></body>'
    thing = f'<body name="thing" pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/>{lid}</body>'
    found = drafted(tmp_path, f"<mujoco><worldbody>{models.FLOOR}{thing}</worldbody></mujoco>")
    assert (found.object, found.joints, found.actuators, found.support) == ("thing", ("lid",), (), "floor")


def write_draft_of(folder, text: str):
    (folder / "hand.xml").write_text(text)
    return write_draft(folder / "hand.xml", folder / "scene.yaml")


def refusal(folder, text: str, kind=SceneError) -> str:
    with pytest.raises(kind) as caught:
        write_draft_of(folder, text)
    assert not (folder / "scene.yaml").exists()
    return str(caught.value)


def test_a_model_of_which_nothing_is_recorded(tmp_path):
    text = refusal(tmp_path, "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    assert text.startswith("model hand.xml holds nothing that is recorded\n")
    text = refusal(tmp_path, "<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>")
    assert "  found: 1 joint of the model without a name" in text


def test_a_model_that_does_not_compile(tmp_path):
    assert "does not compile" in refusal(
        tmp_path, "<mujoco><worldbody><body><joint name='a'/></body></worldbody></mujoco>"
    )


def test_the_model_may_lie_elsewhere(tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "hand.xml").write_text(models.TIP_BODIES)
    scene, _ = write_draft(tmp_path / "models" / "hand.xml", tmp_path / "scenes" / "deep" / "mine.yaml")
    assert scene.file.model == "../../models/hand.xml"
    assert load_scene(tmp_path / "scenes" / "deep" / "mine.yaml").digest == scene.digest


def test_a_scene_file_ends_as_one(tmp_path):
    (tmp_path / "hand.xml").write_text(models.TIP_BODIES)
    with pytest.raises(UsageError, match=r"expected: a name that ends in \.yaml"):
        write_draft(tmp_path / "hand.xml", tmp_path / "scene.txt")
