"""Causes planted in random small scenes: each changes what is recorded, and does what its name says."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from candata.effects import effect, flatten
from candata.gap.blind.draws import draw_setting
from candata.gap.blind.rigs.causes import CAUSES
from candata.gap.blind.rigs.matter import CLEAR, worth
from candata.gap.blind.rigs.planted_world import drawn_cause, planted, scene_of_rig
from candata.gap.blind.rigs.readings import Planted, ideal, noisy
from candata.gap.blind.rigs.recording import logs, nominal, sane_rig
from candata.schema.effect import EffectSetting

#: A gripper that lifts an object, its jaws beside a wrist: all causes can act in it.
SEED, SMALL = 1, (2, 1.2)
FIELDS = (
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_forcerange",
    "dof_damping",
    "dof_armature",
    "dof_frictionloss",
    "body_mass",
    "body_inertia",
    "body_ipos",
    "geom_size",
    "geom_friction",
    "geom_solref",
    "geom_pos",
)


@cache
def lifted():
    case = sane_rig(SEED, "plain", *SMALL)
    assert case.rig.situation == "lifted"
    return case, scene_of_rig(case.rig)


@cache
def with_cause(name):
    case, scene = lifted()
    given = draw_setting(scene, name, np.random.default_rng(0))
    world = planted(case.rig, given)
    return given, world, logs(world.world, case.rig, case.outlines)


def test_a_world_without_a_cause_is_replayed_as_it_was():
    case, _ = lifted()
    # An angle between equal orientations comes out as 1e-8 rad at most, the root of a rounding error.
    assert worth(case.rig, Planted(nominal(case.rig), ideal), case.outlines, case.logs) < 1e-4


@pytest.mark.parametrize("name", CAUSES)
def test_every_cause_changes_what_is_recorded(name):
    case, _ = lifted()
    _, world, played = with_cause(name)
    assert worth(case.rig, world, case.outlines, played) > 1


@pytest.mark.parametrize("name", [n for n, c in CAUSES.items() if c.edit and not c.read])
def test_an_edit_made_here_is_the_one_that_the_library_states(name):
    case, scene = lifted()
    given, world, _ = with_cause(name)
    theirs = scene_of_rig(case.rig).model
    effect(name).edit(theirs, scene, flatten(given, scene), None)
    np.testing.assert_allclose(world.world.model.opt.gravity, theirs.opt.gravity)
    for field in FIELDS:
        np.testing.assert_allclose(getattr(world.world.model, field), getattr(theirs, field), err_msg=field)


def test_commands_come_late_by_the_delay():
    case, _ = lifted()
    step = nominal(case.rig).model.opt.timestep
    u = np.random.default_rng(0).random((6, 5, len(case.rig.drives)))
    late = planted(case.rig, EffectSetting(name="actuation_delay", parameters={"delay_s": 2.25 * step})).world.command
    flat, out = u.reshape(30, -1), late(u).reshape(30, -1)
    moved = ~np.isclose(out, flat).all(0)
    assert moved.any()
    np.testing.assert_allclose(out[3:, moved], (0.75 * flat[1:-2] + 0.25 * flat[:-3])[:, moved])


def test_an_offset_encoder_and_the_servo_that_trusts_it_agree():
    case, _ = lifted()
    _, world, played = with_cause("joint_offset")
    for log, plain in zip(played, case.logs, strict=True):
        off = world.read(log).joint - log.joint
        assert np.abs(np.ptp(off, axis=0)).max() < 1e-12
        moved = np.abs(off[0]) > 0
        assert moved.any()
        # At rest the servo holds the reading where it held the joint: the true joint is off the other way.
        rest = world.read(log).joint[0, moved] - plain.joint[0, moved]
        assert (np.abs(rest) < 0.5 * np.abs(off[0, moved])).all()


def test_a_late_pose_is_the_pose_of_a_while_ago():
    case, _ = lifted()
    rows = 3
    given = EffectSetting(name="pose_latency", parameters={"latency_s": rows / case.rig.file.rate_hz})
    read = planted(case.rig, given).read(case.logs[0])
    np.testing.assert_allclose(read.pose[rows:], case.logs[0].pose[:-rows], atol=1e-9)


def test_a_slow_force_goes_its_share_of_the_way_each_row():
    case, _ = lifted()
    tau = 0.05
    read = planted(case.rig, EffectSetting(name="tactile_lag", parameters={"timeconst_s": tau})).read(case.logs[0])
    true, share = case.logs[0].force, 1 - np.exp(-1 / (tau * case.rig.file.rate_hz))
    np.testing.assert_allclose(np.diff(read.force, axis=0), share * (true[1:] - read.force[:-1]), atol=1e-12)


def test_a_moved_centre_of_mass_turns_the_held_object():
    # MuJoCo takes a body whose frame is its inertial one for simple and would ignore the edit.
    case, _ = lifted()
    *_, played = with_cause("object_com")
    cosine = abs(played[0].pose[-1, 3:] @ case.logs[0].pose[-1, 3:])
    assert 2 * np.arccos(min(cosine, 1.0)) > 0.003


def test_a_drawn_cause_is_clear_in_the_scene_that_comes_with_it():
    seed, given = drawn_cause("servo_gain", "plain", 3, *SMALL)
    case = sane_rig(seed, "plain", *SMALL)
    world = planted(case.rig, given)
    assert worth(case.rig, world, case.outlines, logs(world.world, case.rig, case.outlines)) >= CLEAR


def test_noise_is_as_large_as_the_scene_says():
    case, _ = lifted()
    rng, exact = np.random.default_rng(0), ideal(case.logs[0])
    read = [noisy(case.rig, exact, rng) for _ in range(20)]
    place = np.std([r.pose[:, :3] - exact.pose[:, :3] for r in read])
    force = np.std([r.force - exact.force for r in read])
    # 20 episodes of some hundred rows: a standard deviation is known to 2 %, forces in steps are a little coarser.
    assert place == pytest.approx(case.rig.noise.object_pose[0], rel=0.05)
    steps = case.rig.noise.force_step**2 / 12
    assert force == pytest.approx(np.sqrt(case.rig.noise.fingertip_force**2 + steps), rel=0.05)
    slides = [d.servo.joint for d in case.rig.drives if d.servo.slides]
    column = case.rig.file.joints.index(slides[0])
    assert np.std([r.joint[:, column] - exact.joint[:, column] for r in read]) == pytest.approx(
        case.rig.slide_noise_m, rel=0.1
    )
