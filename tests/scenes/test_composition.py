"""An arm with a hand: the published arm stands where it should, files are joined, and what does not fit is refused."""

from __future__ import annotations

import json
import shutil
import sys
import types
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from candata.errors import CandataError, MissingExtraError, SceneError, UnknownNameError, UsageError
from candata.policies import policy
from candata.policies._carrier import carrier
from candata.repair.mjcf import export_mjcf
from candata.rotation import difference
from candata.scenes import load_scene, tabletop
from candata.scenes.composition import compose
from candata.scenes.contract import ARMS, HANDS
from candata.schema.effect import EffectSetting

ARM = """<mujoco model="post"><option timestep="0.005" integrator="implicitfast"/>
  <default><geom density="500"/></default>
  <worldbody><geom name="floor" type="plane" size="1 1 .1"/>
    <body name="cube" pos=".3 0 .02"><freejoint/><geom name="cube" type="box" size=".02 .02 .02"/></body>
    <body name="post" pos="0 0 .3"><joint name="lift" type="slide" axis="0 0 1" range="-.2 .2"/><geom size=".03"/>
      <body name="beam"><joint name="swing" axis="0 0 1" range="-90 90"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>
        <site name="end" pos=".25 0 0" euler="0 180 0"/></body></body>
  </worldbody>
  <actuator><position name="lift" joint="lift" kp="900" kv="40"/>
    <position name="swing" joint="swing" kp="9" kv="1"/></actuator>
  <keyframe><key name="home" qpos=".3 0 .02 1 0 0 0 .1 .2" ctrl=".1 .2"/></keyframe></mujoco>"""
HAND = """<mujoco model="claw"><compiler angle="radian"/><option timestep="0.001" integrator="RK4"/>
  <default><geom density="2000"/></default>
  <worldbody><geom name="floor" type="plane" size="1 1 .1"/>
    <body name="palm"><freejoint/><geom size=".02"/>
      <body name="left" pos="0 .02 .02"><joint name="left" axis="1 0 0" range="-1 1" limited="true"/>
        <geom name="left" size=".01" pos="0 0 .04"/></body>
      <body name="right" pos="0 -.02 .02"><joint name="right" axis="1 0 0" range="-1 1" limited="true"/>
        <geom name="right" size=".01" pos="0 0 .04"/></body></body>
  </worldbody>
  <actuator><position name="left" joint="left" kp="2"/>
    <position name="right" joint="right" kp="2"/></actuator></mujoco>"""
POSTURES = """<keyframe><key name="open" qpos="-.4 .4" ctrl="-.4 .4"/>
  <key name="grasp" qpos=".2 -.2" ctrl=".3 -.3"/></keyframe></mujoco>"""
ROLES = {
    "model": {"arm": "arm.xml", "hand": "hand.xml", "at": "end"},
    "rate_hz": 100,
    "object": "cube",
    "joints": ["lift", "swing", "hand_left", "hand_right"],
    "actuators": ["lift", "swing", "hand_left", "hand_right"],
    "fingertips": ["hand_left", "hand_right"],
    "support": "floor",
}


@pytest.fixture
def folder(tmp_path):
    """An arm with a floor and a cube, and a hand, each in a file of its own."""
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "hand.xml").write_text(HAND)
    return tmp_path


def written(folder: Path, **roles) -> Path:
    """The scene file of an arm with a hand."""
    (folder / "scene.yaml").write_text(yaml.safe_dump(ROLES | roles))
    return folder / "scene.yaml"


def test_the_flange_of_the_arm_at_zero_is_where_the_maker_says():
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    ARMS.load("xarm7").add(spec, spec.worldbody, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    # xArm user manual: the tool's centre at the zero position is (206, 0, 120.5) mm, turned by 180 degrees about x.
    assert np.allclose(data.site("flange").xpos, [0.206, 0, 0.1205], atol=1e-6)
    assert np.allclose(data.site("flange").xmat.reshape(3, 3), np.diag([1, -1, -1]), atol=1e-6)
    # Links of the maker's description: 11.3 kg without the hand.
    assert model.body_subtreemass[0] == pytest.approx(11.3, abs=0.1)


def test_the_arm_bears_its_own_weight_without_its_servos():
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    ARMS.load("xarm7").add(spec, spec.worldbody, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = 0.3
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc).max() < 1e-6


def test_the_arm_holds_the_palm_where_the_rails_have_it():
    places = []
    for name in ("xhand_tabletop", "xarm7_xhand"):
        model = load_scene(name).model
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("open").id)
        mujoco.mj_kinematics(model, data)
        places.append((data.body("palm").xpos, data.body("palm").xquat))
    (place, turn), (arm_place, arm_turn) = places
    assert np.allclose(arm_place, place, atol=1e-4)
    assert np.abs(difference(arm_turn, turn)).max() < 1e-4
    assert np.allclose(place, tabletop.PALM_PLACE_M)


def test_two_files_become_one_model(folder):
    scene = load_scene(written(folder))
    model = scene.model
    assert [model.joint(j).name for j in range(1, model.njnt)] == ["lift", "swing", "hand_left", "hand_right"]
    assert [model.actuator(a).name for a in range(model.nu)] == ["lift", "swing", "hand_left", "hand_right"]
    assert model.opt.timestep == 0.005, "the options of the arm's file hold"
    assert [model.geom(g).name for g in range(model.ngeom)].count("floor") == 1, "the hand's floor stays behind"
    assert model.nq == 7 + 4, "its free joint goes"
    # Each file keeps its own defaults and its own unit of angles.
    assert model.body("cube").mass[0] == pytest.approx(500 * 0.04**3)
    assert model.body("hand_left").mass[0] == pytest.approx(2000 * 4 / 3 * np.pi * 0.01**3)
    assert np.allclose(model.joint("swing").range, [-np.pi / 2, np.pi / 2])
    assert np.allclose(model.joint("hand_left").range, [-1, 1])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert np.allclose(data.body("hand_palm").xpos, [0.25, 0, 0.3])
    assert np.allclose(data.body("hand_palm").xmat.reshape(3, 3)[:, 2], [0, 0, -1]), "turned as the site is"


def test_keyframes_of_either_file_hold_for_both(folder):
    fixed = HAND.replace("<freejoint/>", "").replace("</mujoco>", POSTURES)
    (folder / "hand.xml").write_text(fixed)
    model = load_scene(written(folder)).model
    cube, arm = [0.3, 0, 0.02, 1, 0, 0, 0], [0.1, 0.2]
    expected = {"home": (-0.4, 0.4, -0.4, 0.4), "open": (-0.4, 0.4, -0.4, 0.4), "grasp": (0.2, -0.2, 0.3, -0.3)}
    assert {model.key(k).name for k in range(model.nkey)} == set(expected)
    for name, fingers in expected.items():
        key = model.key(name)
        assert np.allclose(key.qpos, [*cube, *arm, *fingers[:2]]), name
        assert np.allclose(key.ctrl, [*arm, *fingers[2:]]), name


def test_a_registered_arm_moves_a_users_hand(folder):
    path = written(
        folder,
        model={"arm": "xarm7", "hand": "hand.xml"},
        rate_hz=80,
        object=None,
        joints=["hand_left", "hand_right"],
        actuators=[*ARMS.load("xarm7").joints, "hand_left", "hand_right"],
        support="table",
    )
    scene = load_scene(path)
    hand = carrier(scene)
    assert hand.columns.tolist() == list(range(7))
    assert hand.reach[:3].all()
    raised = hand.commands(hand.start, np.array([[0, 0, 0.1, 0, 0, 0]]))[0]
    data = mujoco.MjData(scene.model)
    heights = []
    for commands in (hand.start, raised):
        data.qpos[:7] = commands[:7]
        mujoco.mj_kinematics(scene.model, data)
        heights.append(data.body("hand_palm").xpos[2])
    assert heights[1] - heights[0] == pytest.approx(0.1, abs=2e-4)


def test_a_users_arm_carries_a_registered_hand(folder):
    model = compose("arm.xml", "xhand", at="end", path=folder / "scene.yaml").compile()
    assert model.nu == 2 + 12
    assert np.allclose(model.key("home").qpos[:9], [0.3, 0, 0.02, 1, 0, 0, 0, 0.1, 0.2])
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    beam = data.body("beam").xmat.reshape(3, 3)
    assert np.allclose(data.body("palm").xmat.reshape(3, 3), beam @ np.diag([-1, 1, -1])), "turned as the site is"
    assert np.allclose(data.body("palm").xpos, data.body("beam").xpos + beam @ [0.25, 0, 0])
    bodies = {model.body(int(model.geom_bodyid[g])).name for c in data.contact for g in c.geom}
    assert not any(name.startswith(("palm", "thumb", "mid", "ring")) for name in bodies), "its links stay apart"


def test_a_scene_of_an_arm_and_a_hand_is_exported_whole(folder, tmp_path):
    scene = load_scene(written(folder))
    export = export_mjcf(scene, [EffectSetting(name="object_mass", parameters={"mass_scale": 2.0})], tmp_path / "out")
    exported = load_scene(tmp_path / "out" / export.scene)
    assert isinstance(exported.file.model, str)
    assert exported.model.body("cube").mass == pytest.approx(2 * scene.model.body("cube").mass)
    # MuJoCo saves six digits.
    assert np.allclose(exported.model.body("hand_left").mass, scene.model.body("hand_left").mass, rtol=2e-5)


@pytest.mark.parametrize(
    ("model", "error", "text"),
    [
        ({"arm": "arm.xml", "hand": "hand.xml", "at": "elbow"}, SceneError, "arm arm.xml has no site elbow"),
        ({"arm": "arm.xml", "hand": "hand.xml"}, SceneError, "where arm arm.xml carries the hand is not said"),
        ({"arm": "arm.xml", "hand": "paw.xml", "at": "end"}, SceneError, "model paw.xml does not exist"),
        ({"arm": "xarm8", "hand": "hand.xml"}, UnknownNameError, "did you mean 'xarm7'?"),
        ({"arm": "arm.xml", "hand": "xhnad", "at": "end"}, UnknownNameError, "did you mean 'xhand'?"),
        ({"arm": "clash.xml", "hand": "xhand", "at": "end"}, SceneError, "repeated name 'palm' in body"),
        ({"arm": "bare.xml", "hand": "xhand", "at": "end"}, SceneError, "add <site> to the last link"),
        ({"arm": "arm.xml", "at": "end"}, UsageError, "hand"),
        (
            {"arm": "arm.xml", "hand": "no_such_package:hand.xml", "at": "end"},
            SceneError,
            "pip install no-such-package",
        ),
    ],
)
def test_what_cannot_be_put_together_is_one_clear_error(folder, model, error, text):
    (folder / "clash.xml").write_text(ARM.replace('name="beam"', 'name="palm"'))
    (folder / "bare.xml").write_text(ARM.replace("<site", "<!--").replace('180 0"/>', "-->"))
    with pytest.raises(error) as caught:
        load_scene(written(folder, model=model))
    assert text in str(caught.value)
    assert "scene.yaml" in str(caught.value)


def test_a_model_of_mujoco_menagerie_needs_its_package(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with pytest.raises(MissingExtraError, match=r'pip install "candata\[menagerie\]"'):
        load_scene(written(folder, model={"arm": "mujoco_menagerie:post", "hand": "hand.xml", "at": "end"}))


def test_a_model_of_mujoco_menagerie_is_one_of_its_files(folder, monkeypatch):
    """The package is played here: `get(ID)` gives a robot, which has files by name."""
    menagerie = types.ModuleType("mujoco_menagerie")
    menagerie.MenagerieError = type("MenagerieError", (Exception,), {})
    shutil.copy(folder / "hand.xml", folder / "left_claw.xml")

    def get(name):
        if name != "claw":
            raise menagerie.MenagerieError(f"Unknown robot {name!r}")
        return types.SimpleNamespace(default_model="hand", xml=lambda model: folder / f"{model}.xml")

    menagerie.get = get
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", menagerie)
    for name in ("claw", "claw/left_claw"):
        scene = load_scene(written(folder, model={"arm": "arm.xml", "hand": f"mujoco_menagerie:{name}", "at": "end"}))
        assert scene.model.nu == 4
    with pytest.raises(CandataError, match="gives no model paw: Unknown robot 'paw'"):
        load_scene(written(folder, model={"arm": "arm.xml", "hand": "mujoco_menagerie:paw", "at": "end"}))


def test_a_registered_arm_begins_where_its_hand_can_be_moved(tmp_path):
    joints = [*ARMS.load("xarm7").joints, *HANDS.load("xhand").joints]
    roles = {"rate_hz": 80.0, "joints": joints, "actuators": joints, "fingertips": list(HANDS.load("xhand").fingertips)}
    text = json.dumps({"model": {"arm": "xarm7", "hand": "xhand"}, **roles})
    (tmp_path / "scene.yaml").write_text(text)
    scene = load_scene(tmp_path / "scene.yaml")
    for seed in range(8):
        policy("free_sweep").plan(
            scene, np.random.default_rng(seed), 3.2
        )  # an arm that begins stretched reaches 3 of 8
