"""A scene that is not sound says what is wrong with it, word for word."""

from __future__ import annotations

import pytest

from candata.errors import SceneError, UnknownNameError, UsageError
from candata.scenes import load_scene

BOX = '<body name="box" pos="0 0 1"><freejoint/><geom name="shell" type="box" size=".03 .03 .03"/></body>'
ARM = (
    '<body name="arm"><joint name="bend"/><geom name="tip" size=".01"/><site name="frame"/></body>',
    '<actuator><position name="servo" joint="bend"/></actuator>',
)
ROLES = "model: scene.xml\nrate_hz: 100\n"


@pytest.fixture
def written(tmp_path):
    """Write a model and its roles; return the path of the roles."""

    def write(roles: str, body: str = BOX, option: str = 'timestep="0.002"', tail: str = ""):
        text = f"<mujoco><option {option}/><worldbody>{body}</worldbody>{tail}</mujoco>"
        (tmp_path / "scene.xml").write_text(text)
        (tmp_path / "scene.yaml").write_text(roles)
        return tmp_path / "scene.yaml"

    return write


def refusal(path, kind) -> str:
    with pytest.raises(kind) as caught:
        load_scene(path)
    return str(caught.value)


def test_an_unknown_builtin_scene_lists_the_known():
    text = refusal("cube_tos", UnknownNameError)
    assert text.startswith(
        "unknown scene 'cube_tos'\n  expected: one of cube_toss, gripper_tabletop, xarm7_xhand, xhand_tabletop\n"
    )
    assert text.endswith("  do: did you mean 'cube_toss'?")


@pytest.mark.parametrize(
    ("role", "line", "known", "near"),
    [
        ("object", "object: boxx", "box", "box"),
        ("joint", "joints: [bnd]", "bend", "bend"),
        ("actuator", "actuators: [serv]", "servo", "servo"),
        ("fingertip", "fingertips: [tipp]", None, "tip"),
        ("fingertip frame", "fingertips: [tip]\nfingertip_frames: [fram]", "frame", "frame"),
        ("support", "support: shel", "shell, tip", "shell"),
        ("member of group fingers", "joints: [bend]\ngroups: {fingers: [bent]}", "bend", "bend"),
    ],
)
def test_a_role_that_names_what_the_model_lacks(written, role, line, known, near):
    path = written(f"{ROLES}{line}\n", BOX + ARM[0], tail=ARM[1])
    text = refusal(path, UnknownNameError)
    wrong = line.replace("[", " ").replace("]", " ").replace("}", " ").split()[-1]
    assert text.startswith(f"unknown {role} of scene {path}: '{wrong}'\n")
    assert f"  where: {path}\n  do: did you mean {near!r}?" in text
    if known:
        assert f"  expected: one of {known}\n  found: {wrong!r}\n" in text


def test_a_group_named_like_a_joint(written):
    path = written(f"{ROLES}joints: [bend]\ngroups: {{bend: [bend]}}\n", BOX + ARM[0], tail=ARM[1])
    text = refusal(path, SceneError)
    assert text.startswith(f"scene {path}: group bend bears the name of a joint or fingertip\n")
    assert "  expected: a name of its own" in text


def test_a_model_that_does_not_compile(written):
    path = written(ROLES, '<body name="empty"><freejoint/></body>')
    text = refusal(path, SceneError)
    assert text.startswith(f"scene {path} does not compile: ")
    assert "mass and inertia of moving bodies" in text
    assert text.endswith("  do: run the model in MuJoCo alone first")


def test_a_model_that_is_no_mjcf(written):
    path = written(ROLES, "<cube/>")
    text = refusal(path, SceneError)
    assert text.startswith("model scene.xml cannot be read: XML Error: Schema violation")
    assert text.endswith(f"  where: {path.with_suffix('.xml')}\n  do: run the model in MuJoCo alone first")


def test_a_model_that_is_missing(written):
    path = written("model: other.xml\nrate_hz: 100\n")
    assert refusal(path, SceneError) == (
        f"model other.xml does not exist\n  expected: {path.parent / 'other.xml'}\n  where: {path}"
    )


def test_an_object_that_is_not_free(written):
    path = written(f"{ROLES}object: arm\n", BOX + ARM[0])
    text = refusal(path, SceneError)
    assert text.startswith(f"object arm of scene {path} is not free\n  expected: a body with one free joint\n")
    assert f"  found: a hinge joint bend\n  where: {path}\n" in text
    assert text.endswith("  do: name a free body: box; or add <freejoint/> to arm in place of its joints")


def test_a_physics_step_that_does_not_divide_the_control_step(written):
    path = written(f"{ROLES}object: box\n", option='timestep="0.003"')
    assert refusal(path, SceneError) == (
        f"scene {path}: the physics step does not divide the control step\n"
        "  expected: timestep = 1 / (100 x n) s\n"
        "  found: 0.003 s (3.33 a step)\n"
        '  do: set <option timestep="0.00333333333"/>'
    )


def test_a_physics_step_longer_than_the_control_step(written):
    path = written(f"{ROLES}object: box\n", option='timestep="0.02"')
    assert 'set <option timestep="0.01"/>' in refusal(path, SceneError)


def test_frames_that_do_not_match_the_fingertips(written):
    path = written(f"{ROLES}fingertips: [tip, shell]\nfingertip_frames: [frame]\n", BOX + ARM[0])
    assert refusal(path, SceneError) == (
        f"scene {path} needs one frame a fingertip\n  expected: 2 fingertip_frames\n  found: 1"
    )


def test_a_scene_file_that_is_missing(tmp_path):
    path = tmp_path / "none.yaml"
    assert refusal(path, UsageError) == f"scene file {path} does not exist\n  where: {path}"


@pytest.mark.parametrize(
    ("roles", "text"),
    [
        ("model: scene.xml\n", "scene.yaml is not valid: required key `rate_hz` is missing"),
        (f"{ROLES}objct: box\n", "scene.yaml is not valid: unknown key `objct`, did you mean `object`"),
        (
            "model: scene.xml\nrate_hz: -1\n",
            "scene.yaml is not valid: rate_hz: Input should be greater than 0",
        ),
        ("model: [", "scene.yaml is no YAML"),
    ],
)
def test_a_scene_file_that_is_not_valid(written, roles, text):
    assert refusal(written(roles), UsageError).startswith(text)


def test_a_urdf_gets_the_servos_that_its_scene_declares(tmp_path):
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/>'
        '<link name="upper"><inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>'
        '<joint name="bend" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="5" velocity="3"/></joint></robot>'
    )
    path = tmp_path / "scene.yaml"
    path.write_text("model: arm.urdf\nrate_hz: 100\njoints: [bend]\nactuators: {bend: {kp: 3, kv: 0.06, limit: 1.1}}\n")
    model = load_scene(path).model
    assert model.nu == 1
    assert model.actuator_gainprm[0, 0] == 3
    assert model.actuator_biasprm[0, 1:3].tolist() == [-3, -0.06]
    assert model.actuator_forcerange[0].tolist() == [-1.1, 1.1]
