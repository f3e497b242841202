"""Random small scenes: the same for a seed, sane, loadable, played by plain MuJoCo as the contract of a row says."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

import candata.gap.blind.rigs as rigs
from candata.gap.blind.rigs.design import all_traits, split_trait
from candata.gap.blind.rigs.motions import rest_command
from candata.gap.blind.rigs.planted_world import scene_of_rig
from candata.gap.blind.rigs.player import STATE, STILL, STILL_M_S, World, parts, play, settled
from candata.gap.blind.rigs.recording import nominal, sane_rig, trimmed
from candata.schema.scene import SceneFile

#: Small and quick: two episodes of 1.2 s.
SMALL = (2, 1.2)


@cache
def drawn(seed, trait="plain"):
    return sane_rig(seed, trait, *SMALL)


def test_a_seed_draws_the_same_scene_and_the_same_recordings():
    first, again, other = drawn(5), sane_rig(5, "plain", *SMALL), drawn(6)
    assert (first.rig.xml, first.rig.yaml) == (again.rig.xml, again.rig.yaml)
    assert all((a.joint == b.joint).all() for a, b in zip(first.logs, again.logs, strict=True))
    assert first.rig.xml != other.rig.xml


@pytest.mark.parametrize("trait", all_traits())
def test_every_trait_is_drawn_loads_and_bears_its_mark(trait):
    rig = drawn(7, trait).rig
    scene, model = scene_of_rig(rig), nominal(rig).model
    kind, cut = split_trait(trait)
    assert rig.cut == cut
    assert scene.file.joints == rig.file.joints
    hidden = model.njnt - len(rig.file.joints) - (rig.thing is not None)
    marks = {
        "plain": hidden == 0 and model.na == 0 and model.nhistory == 0,
        "cut": cut and hidden == 0,
        "mimic": hidden > 0 and model.neq > 0,
        "filtered": model.na == model.nu,
        "integrating": (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR).any(),
        "delayed": bool((model.actuator_delay > 0).all()),
        "spring": hidden > 0 and model.jnt_stiffness.any(),
        "free_base": hidden > 0 and "base" in rig.xml,
    }
    assert marks[kind]


@pytest.mark.parametrize("trait", ["plain", "filtered", "free_base"])
def test_episodes_begin_at_rest_and_those_that_are_cut_in_motion(trait):
    for seed in (1, 2):
        for name in (trait, "cut" if trait == "plain" else f"{trait} cut"):
            case = drawn(seed, name)
            cut = [trimmed(log, one.lead) for one, log in zip(case.outlines, case.logs, strict=True)]
            speeds = [np.abs(np.diff(log.joint[:2], axis=0)).max() * case.rig.file.rate_hz for log in cut]
            # 0.005 is what counts as at rest, 0.05 rad/s (5 mm/s of a slide) what counts as in motion.
            assert max(speeds) >= 0.005 if "cut" in name else max(speeds) < 0.05
            assert all(len(log.joint) == case.rig.rows for log in cut)


@pytest.mark.parametrize("trait", ["plain", "mimic", "filtered", "integrating", "spring", "free_base"])
def test_a_robot_that_begins_at_rest_stays_there_while_its_first_command_is_held(trait):
    case = drawn(1, trait)
    rig, world = case.rig, nominal(case.rig)
    held = np.repeat(rest_command(rig)[None], rig.file.rate_hz, axis=0)
    log = play(world, rig.file, settled(world, rig, case.outlines[0].placed), held)
    # A second at the speed that counts as still.
    assert np.ptp(log.joint, axis=0).max() < STILL
    if log.pose is not None:
        assert np.ptp(log.pose[:, :3], axis=0).max() < STILL_M_S


def test_scenes_differ_in_what_goes_on_and_stay_cheap():
    found = [drawn(seed).rig for seed in range(12)]
    assert len({rig.situation for rig in found}) >= 4
    assert len({rig.file.rate_hz for rig in found}) >= 3
    assert {"Euler", "implicitfast"} == {k for k in ("Euler", "implicitfast") for rig in found if k in rig.xml}
    assert {rig.file.noise is None for rig in found} == {True, False}
    for rig in found:
        steps = 1 / rig.file.rate_hz / nominal(rig).model.opt.timestep
        assert 1 <= round(steps) <= 20
        assert abs(steps - round(steps)) < 1e-6


BALL = """<mujoco><option timestep="0.002"/><worldbody>
<body name="finger" quat="1 1 0 0"><joint name="j" axis="1 0 0" damping="1"/>
<geom name="tip" type="box" size=".05 .02 .05" pos="0 -.02 0" mass=".1"/></body>
<body name="object" pos="0 0 {z}"><freejoint/><geom type="sphere" size=".02" mass=".1"/></body>
</worldbody><actuator><position name="m" joint="j" kp="500" kv="5"/></actuator></mujoco>"""
ROLES = SceneFile(model="scene.xml", rate_hz=100, object="object", joints=("j",), actuators=("m",), fingertips=("tip",))


def dropped(height_m, rows):
    """Return the log of a ball put on, or dropped onto, a pad that looks up, and the turn of the pad's body."""
    model = mujoco.MjModel.from_xml_string(BALL.format(z=0.02 + height_m))
    data, state = mujoco.MjData(model), np.zeros(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return play(World(model), ROLES, state, np.zeros((rows, 1))), model


def test_a_ball_at_rest_on_an_upturned_fingertip_presses_down_by_its_weight_in_the_fingertips_frame():
    log, model = dropped(0.0, 150)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body("finger").quat)
    world = turn.reshape(3, 3) @ log.force[-1, 0]
    np.testing.assert_allclose(world, [0, 0, -0.1 * 9.81], atol=2e-3)  # what is left of the settling
    assert abs(log.force[-1, 0, 2]) < abs(log.force[-1, 0, 1])  # the pad looks along its own y


def test_a_rows_force_is_the_mean_over_the_step_before_it():
    log, model = dropped(0.01, 60)
    # What the pad took up is what the ball's momentum lacks; a row's speed is the ball's at its time.
    took = np.cumsum(log.force[1:, 0] @ np.array([0, -1.0, 0])) / 100
    lacks = 0.1 * (log.speed[1:, parts(model, ROLES).object_dof + 2] + 9.81 * np.arange(1, 60) / 100)
    # The pad turns by less than 0.01 rad, of which the cosine is 5e-5 short of 1.
    np.testing.assert_allclose(took, lacks, atol=1e-4)


MEET = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
<body name="a" pos="-.03 0 0"><joint name="ja" type="slide" axis="1 0 0" damping="1"/>
<geom name="ta" type="sphere" size=".01" mass=".1"/></body>
<body name="b" pos=".03 0 0" quat="0 0 0 1"><joint name="jb" type="slide" axis="1 0 0" damping="1"/>
<geom name="tb" type="sphere" size=".01" mass=".1"/></body>
</worldbody><actuator><position name="ma" joint="ja" kp="100" kv="5"/><position name="mb" joint="jb" kp="100" kv="5"/>
</actuator></mujoco>"""


def test_fingertips_that_press_each_other_feel_opposite_forces():
    file = SceneFile(model="s.xml", rate_hz=100, joints=("ja", "jb"), actuators=("ma", "mb"), fingertips=("ta", "b"))
    model = mujoco.MjModel.from_xml_string(MEET)
    state = np.zeros(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, mujoco.MjData(model), state, STATE)
    log = play(World(model), file, state, np.full((150, 2), 0.03))
    pushed = 100 * (0.03 - log.joint[-1, 0])  # what the servo presses with, at rest
    # Each is pushed back along its own -x: the second body is turned about.
    np.testing.assert_allclose(log.force[-1], [[-pushed, 0, 0], [-pushed, 0, 0]], atol=1e-3)
    assert pushed > 0.5


def test_nothing_that_plays_a_scene_sees_candatas_own_stepping_or_effects():
    for name in ("player", "recording", "readings", "motions", "matter"):
        tree = ast.parse((Path(rigs.__file__).parent / f"{name}.py").read_text())
        seen = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        assert not [m for m in seen if m.startswith(("candata.simulate", "candata.effects", "candata.scenes"))]
