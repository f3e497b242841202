"""Every role against every kind of part: one clear error with what is possible, when the scene is read."""

from __future__ import annotations

import pytest

from candata.errors import CandataError, SceneError
from candata.scenes import load_scene
from candata.scenes.roles import roles

BOX = '<body name="box" pos="0 0 .1"><freejoint name="box_root"/><geom name="shell" size=".03"/></body>'
WELDED = '<body name="stand"><geom name="stand_top" type="box" size=".1 .1 .01"/><body name="shelf"/></body>'
BALL = '<body name="bob" pos="1 0 1"><joint name="bob_ball" type="ball"/><geom name="bob" size=".02"/></body>'
ARM = (
    '<body name="arm" pos="0 0 1"><joint name="bend" axis="0 1 0"/><geom name="skin" size=".02" contype="0" '
    'conaffinity="0"/><geom name="upper" size=".02"/><site name="frame"/>'
    '<body name="frame_only" pos=".1 0 0"/>'
    '<body name="hand" pos=".1 0 0"><joint name="slide" type="slide"/><geom name="tip" size=".02"/></body></body>'
)
LID = '<body name="lid"><joint name="lid"/><geom size=".1"/></body>'
CHEST = f'<body name="chest" pos="2 0 1"><freejoint/><geom size=".1"/>{LID}</body>'
DRIVES = (
    '<tendon><fixed name="string"><joint joint="bend" coef="1"/><joint joint="slide" coef="1"/></fixed></tendon>'
    '<actuator><position name="servo" joint="bend" kp="3"/><motor name="pull" tendon="string"/></actuator>'
)
WORLD = '<geom name="floor" type="plane" size="1 1 .1"/><geom name="paint" size=".1" contype="0" conaffinity="0"/>'
WORLD += BOX + WELDED + BALL + ARM + CHEST
SCENE = "model: scene.xml\nrate_hz: 100\n"


@pytest.fixture
def written(tmp_path):
    """Write the model and some roles; return the path of the roles."""

    def write(text: str, world: str = WORLD, drives: str = DRIVES):
        (tmp_path / "scene.xml").write_text(f"<mujoco><worldbody>{world}</worldbody>{drives}</mujoco>")
        (tmp_path / "scene.yaml").write_text(SCENE + text)
        return tmp_path / "scene.yaml"

    return write


def refusal(path) -> list[str]:
    """The lines of the error, the path of the scene shortened."""
    with pytest.raises(CandataError) as caught:
        load_scene(path)
    return str(caught.value).replace(str(path), "S").splitlines()


JOINTS = "  expected: hinge and slide joints: bend, slide, lid"


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (
            "joints: [bob_ball, bend]",
            [
                "joint bob_ball of scene S is a ball joint, which has no single position",
                JOINTS,
                "  found: a ball joint of body bob: four numbers, a quaternion",
                "  where: S",
                "  do: leave bob_ball out of `joints`; where its angles are recorded, model it as three hinges",
            ],
        ),
        (
            "joints: [bend, box_root]",
            [
                "joint box_root of scene S is a free joint, which has no single position",
                JOINTS,
                "  found: a free joint of body box: seven numbers",
                "  where: S",
                "  do: leave box_root out of `joints`; if the pose of box is recorded, name it: `object: box`",
            ],
        ),
        (
            "joints: [box_root]\nobject: box",
            [
                "joint box_root of scene S is a free joint, which has no single position",
                JOINTS,
                "  found: a free joint of body box: seven numbers",
                "  where: S",
                "  do: leave box_root out of `joints`",
            ],
        ),
        (
            "actuators: [servo]",
            [
                "scene S has actuators but neither joints nor an object",
                "  expected: `joints`, `object`, or both: a recording needs joint positions or the pose of an object",
                "  found: the model has hinge and slide joints bend, slide, lid; free bodies box, chest",
                "  where: S",
                "  do: list those whose positions are recorded: `joints: [bend, slide, lid]`, or name what is tracked: "
                "`object: box`",
            ],
        ),
        (
            "joints: [bend, slide, bend]",
            [
                "joint bend of scene S is named twice",
                "  expected: each one once: its place says which column it is",
                "  found: at places 1, 3",
                "  where: S",
                "  do: remove all but one of them",
            ],
        ),
        (
            "object: bob",
            [
                "object bob of scene S is not free",
                "  expected: a body with one free joint",
                "  found: a ball joint bob_ball",
                "  where: S",
                "  do: name a free body: box, chest; or add <freejoint/> to bob in place of its joints",
            ],
        ),
        (
            "object: box\nfingertips: [shell]",
            [
                "fingertip shell of scene S is a part of the object box",
                "  expected: a body or a geom of the hand that collides",
                "  found: geom shell of body box",
                "  where: S",
                "  do: name a body of the hand, or a geom of one",
            ],
        ),
        (
            "joints: [bend]\nfingertips: [frame_only]",
            [
                "fingertip frame_only of scene S has no geom that collides: its force would always be zero",
                "  expected: a body or a geom of the hand that collides",
                "  found: body frame_only",
                "  where: S",
                "  do: name what touches, such as arm",
            ],
        ),
    ],
)
def test_the_whole_error(written, text, lines):
    assert refusal(written(text)) == lines


@pytest.mark.parametrize(
    ("text", "first", "rest"),
    [
        ("object: stand", "object stand of scene S is not free", "found: no joint: stand is fixed to world"),
        ("object: shelf", "object shelf of scene S is not free", "move shelf to the top level of <worldbody>, and add"),
        ("object: lid", "object lid of scene S is not free", "name the free body that carries it: `object: chest`"),
        ("object: arm", "object arm of scene S is not free", "found: a hinge joint bend"),
        ("object: world", "object world of scene S is not free", "do: name a free body: box, chest"),
        ("object: shell", "object shell of scene S is a geom of body box", "a body with one free joint: box, chest"),
        ("object: box_root", "object box_root of scene S is a free joint of body box", "one free joint: box, chest"),
        ("object: servo", "object servo of scene S is an actuator on bend", "one free joint: box, chest"),
        (
            "joints: [arm]",
            "joint arm of scene S is a body, with geoms skin, upper",
            "hinge and slide joints bend, slide",
        ),
        ("joints: [servo]", "joint servo of scene S is an actuator on bend", "hinge and slide joints bend, slide"),
        ("joints: [string]", "joint string of scene S is a tendon", "hinge and slide joints bend, slide"),
        ("joints: [tip]", "joint tip of scene S is a geom of body hand", "hinge and slide joints bend, slide"),
        (
            "joints: [bend]\nactuators: [bend]",
            "actuator bend of scene S is a hinge joint",
            "one of the actuators servo",
        ),
        ("joints: [bend]\nactuators: [string]", "actuator string of scene S is a tendon", "actuators servo, pull"),
        ("joints: [bend]\nactuators: [servo, servo]", "actuator servo of scene S is named twice", "at places 1, 2"),
        (
            "joints: [bend]\nactuators: {bob_ball: {kp: 1}}",
            "actuator bob_ball of scene S would be a servo of a ball",
            "lid",
        ),
        (
            "joints: [bend]\nactuators: {bend: {kp: 1}}",
            "actuator bend of scene S would be a second one",
            "[servo, pull]",
        ),
        (
            "joints: [bend]\nactuators: {servo: {kp: 1}}",
            "actuator servo of scene S is an actuator on bend",
            "to joints",
        ),
        ("joints: [bend]\nfingertips: [tip, upper, tip]", "fingertip tip of scene S is named twice", "at places 1, 3"),
        (
            "joints: [bend]\nfingertips: [floor]",
            "fingertip floor of scene S is a part of the world",
            "geom floor of body",
        ),
        (
            "joints: [bend]\nfingertips: [world]",
            "fingertip world of scene S is a part of the world",
            "found: body world",
        ),
        (
            "joints: [bend]\nfingertips: [skin]",
            "fingertip skin of scene S has no geom that collides",
            "geom skin of body",
        ),
        ("joints: [bend]\nfingertips: [frame]", "fingertip frame of scene S is a site of body arm", "a body or a geom"),
        (
            "joints: [bend]\nfingertips: [bend]",
            "fingertip bend of scene S is a hinge joint of body arm",
            "a body or a geom",
        ),
        ("object: chest\nfingertips: [lid]", "fingertip lid of scene S is a part of the object chest", "body lid"),
        (
            "joints: [bend]\nfingertips: [tip]\nfingertip_frames: [hand]",
            "fingertip frame hand of scene S is a body",
            "frame",
        ),
        (
            "object: box\nsupport: stand",
            "support stand of scene S is a body, with geoms stand_top",
            "a geom: stand_top",
        ),
        ("object: box\nsupport: shell", "support shell of scene S is a part of the object box", "name the geom of the"),
        (
            "object: box\nsupport: paint",
            "support paint of scene S does not collide: nothing can rest on it",
            "leave `sup",
        ),
        ("joints: [bend]\ngroups: {finger: []}", "scene S: group finger is empty", "list its joints, or remove it"),
        (
            "joints: [bend]\ngroups: {fingertips: [bend]}",
            "scene S: group fingertips bears the name of",
            "a name of its own",
        ),
        ("joints: [bend]\ngroups: {f: [bend, bend]}", "joint bend of group f of scene S is named twice", "places 1, 2"),
        (
            "joints: [bend]\nnoise: {joint_position: [1, 2]}",
            "scene S: noise.joint_position is not one number",
            "2 numbers",
        ),
    ],
)
def test_the_first_line_and_what_is_possible(written, text, first, rest):
    lines = refusal(written(text))
    assert lines[0].startswith(first)
    assert rest in "\n".join(lines[1:])


def test_an_object_that_touches_nothing(written):
    ghost = BOX.replace("/></body>", ' contype="0" conaffinity="0"/></body>')
    lines = refusal(written("object: box", ghost, ""))
    assert lines[0] == "object box of scene S has no geom that collides, so nothing can touch it"


def test_a_scene_without_any_role(written):
    assert refusal(written(""))[0] == "scene S has neither joints nor an object"
    lines = refusal(written("", '<geom size="1"/>', ""))
    assert lines[-1] == "  do: name a joint of the model, or give a body a <freejoint/>"


def test_a_fingertip_that_touches_in_explicit_pairs_alone(written):
    pair = '<contact><pair geom1="skin" geom2="shell"/></contact>'
    assert load_scene(written("joints: [bend]\nfingertips: [skin]", drives=DRIVES + pair)).file.fingertips == ("skin",)


def test_an_actuator_may_pull_what_is_not_recorded(written):
    scene = load_scene(written("joints: [slide]\nactuators: [servo, pull]"))
    assert roles(scene).notes == ("actuator servo, a position servo, pulls joint bend, which is not recorded",)


def test_what_is_not_listed_or_floats_is_noted(written):
    assert roles(load_scene(written("joints: [bend]\nactuators: [servo]"))).notes == (
        "actuators that `actuators` does not list get the command 0: pull",
    )
    floating = "body chest, which carries joints, floats free and is not the object: its place is not recorded"
    assert floating in roles(load_scene(written("joints: [lid]"))).notes
    held = '<equality><weld body1="chest" body2="stand"/></equality>'
    assert floating not in roles(load_scene(written("joints: [lid]", drives=DRIVES + held))).notes
    assert floating not in roles(load_scene(written("joints: [lid]\nobject: chest"))).notes


def test_a_robot_whose_own_base_is_tracked_may_have_fingertips(written):
    scene = load_scene(written("joints: [lid]\nobject: chest\nfingertips: [lid]"))
    assert scene.file.object == "chest"


@pytest.mark.parametrize("step", ["0", "-0.001", "nan", "inf"])
def test_a_physics_step_that_is_no_time(tmp_path, step):
    (tmp_path / "scene.xml").write_text(f'<mujoco><option timestep="{step}"/><worldbody>{ARM}</worldbody></mujoco>')
    (tmp_path / "scene.yaml").write_text(SCENE + "joints: [bend]\n")
    lines = refusal(tmp_path / "scene.yaml")
    assert lines[0] == "scene S: the physics step is no time"
    assert lines[-1] == '  do: set <option timestep="0.002"/>'


def test_an_actuator_that_takes_several_numbers(written):
    turn = '<actuator><orientation name="turn" joint="bob_ball" kp="3"/></actuator>'
    with pytest.raises(SceneError, match=r"actuator turn takes several numbers at once\n.*\n  found: 3 numbers"):
        load_scene(written("joints: [bend]", drives=turn))
