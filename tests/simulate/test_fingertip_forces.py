"""A fingertip feels whatever touches it: object, table, another finger; with an object in the scene or without."""

from __future__ import annotations

import numpy as np
import pytest

from candata.scenes import load_scene
from candata.simulate import at_rest, rollout
from candata.simulate.episodes import EpisodeJob, make_episodes

#: MuJoCo's default gravity [m/s^2].
G = 9.81
HEAD = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
<geom name="table" type="plane" size="1 1 .1"/>"""
#: Two jaws that slide towards one another in the air, and a third finger that stands on the table.
JAWS = """
<body pos="-.02 0 .3"><joint name="left" type="slide" axis="1 0 0" damping="5"/>
  <geom name="left_tip" type="sphere" size=".015" mass=".1"/></body>
<body pos=".02 0 .3"><joint name="right" type="slide" axis="-1 0 0" damping="5"/>
  <geom name="right_tip" type="sphere" size=".015" mass=".1"/></body>
<body pos=".3 0 .0149"><joint name="down" type="slide" axis="0 0 1" damping="5"/>
  <geom name="foot" type="sphere" size=".015" mass=".2"/></body>"""
MOTORS = """</worldbody><actuator><motor name="left" joint="left"/><motor name="right" joint="right"/>
<motor name="down" joint="down"/></actuator></mujoco>"""
BLOCK = '<body name="block" pos="0 .3 .03"><freejoint/><geom type="box" size=".03 .03 .03" mass=".1"/></body>'
ROLES = """model: scene.xml
rate_hz: 100
joints: [left, right, down]
actuators: [left, right, down]
fingertips: [left_tip, right_tip, foot]
"""


@pytest.fixture
def scene(tmp_path):
    """The function that assembles a scene file from a model and roles."""

    def assembled(xml: str, roles: str):
        (tmp_path / "scene.xml").write_text(xml)
        (tmp_path / "scene.yaml").write_text(roles)
        return load_scene(tmp_path / "scene.yaml")

    return assembled


def pressed(scene, newton: float, rows: int = 60) -> np.ndarray:
    """Forces `(F, 3)` of the last row while both jaws are pushed with so much."""
    commands = np.zeros((1, rows, 3))
    commands[:, :, :2] = newton
    return rollout(scene, commands, *at_rest(scene, 1), [()]).readings["fingertip_force"][0, -1]


@pytest.mark.parametrize("block", ["", BLOCK])
def test_fingers_that_press_on_one_another_and_on_the_table_feel_it(scene, block):
    roles = ROLES + ("object: block\nsupport: table\n" if block else "")
    force = pressed(scene(HEAD + JAWS + block + MOTORS, roles), 3.0)
    # Tips are pushed apart, each by what the other's motor gives; the foot carries its own weight.
    assert force[0] == pytest.approx([-3.0, 0, 0], abs=0.05)
    assert force[1] == pytest.approx([3.0, 0, 0], abs=0.05)
    assert force[2] == pytest.approx([0, 0, 0.2 * G], abs=0.05)


def test_a_ball_on_an_upturned_fingertip_reads_its_weight_downwards(scene):
    xml = (
        HEAD + '<body pos="0 0 .2"><joint name="j" type="slide" axis="1 0 0" damping="50"/>'
        '<geom name="tip" type="box" size=".05 .05 .01" mass="1"/></body>'
        '<body name="ball" pos="0 0 .23"><freejoint/><geom type="sphere" size=".02" mass=".5"/></body>'
        "</worldbody></mujoco>"
    )
    world = scene(xml, "model: scene.xml\nrate_hz: 100\nobject: ball\njoints: [j]\nfingertips: [tip]\n")
    read = rollout(world, np.zeros((1, 60, 0)), *at_rest(world, 1), [()]).readings["fingertip_force"]
    assert read[0, -1, 0] == pytest.approx([0, 0, -0.5 * G], abs=0.05)


def test_what_parts_of_one_fingertip_exert_on_one_another_is_no_force_from_outside(scene):
    """A pad that rests on its own finger presses on it: the fingertip as a whole carries the block alone."""
    xml = (
        HEAD + '<body name="tip" pos="0 0 .2"><joint name="j" type="slide" axis="1 0 0" damping="50"/>'
        '<geom type="box" size=".05 .05 .01" mass="1"/>'
        '<body pos="0 0 .05"><joint type="slide" axis="1 0 0" stiffness="1000" damping="10"/>'
        '<geom size=".001" mass=".01" contype="0" conaffinity="0"/>'
        '<body pos="0 0 -.031"><joint type="slide" axis="0 0 1"/>'
        '<geom type="box" size=".04 .04 .009" mass=".3"/></body></body></body>'
        '<body name="block" pos="0 0 .253"><freejoint/><geom type="box" size=".02 .02 .025" mass=".5"/></body>'
        "</worldbody></mujoco>"
    )
    world = scene(xml, "model: scene.xml\nrate_hz: 100\nobject: block\njoints: [j]\nfingertips: [tip]\n")
    played = rollout(world, np.zeros((1, 100, 0)), *at_rest(world, 1), [()])
    assert len(world.internal_sensors) == 1
    assert played.readings["fingertip_force"][0, -1, 0] == pytest.approx([0, 0, -0.5 * G], abs=0.1)


def test_episodes_of_a_scene_without_an_object_hold_forces_and_flags(scene):
    servos = "".join(f'<position name="{n}" joint="{n}" kp="200" kv="5"/>' for n in ("left", "right", "down"))
    world = scene(f"{HEAD}{JAWS}</worldbody><actuator>{servos}</actuator></mujoco>", ROLES)
    (episode,) = make_episodes(world, [EpisodeJob("e", 0, "free_sweep", 1)], duration_s=0.5)
    assert episode["fingertip_force"].shape[1:] == (3, 3)
    assert episode["fingertip_contact"].any()
    assert np.array_equal(episode["contact"], episode["fingertip_contact"].any(1))
