"""Joints that come early: a clock, a servo or commands that were logged late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.effects import setting
from candata.fetch.xl330_pendulum import TABLE
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.mismatch.check import mismatch
from candata.gap.replay.replayer import Replayer
from candata.scenes import load_scene
from candata.simulate import rollout

MOTIONS = ("grasp_lift_shake", "free_sweep", "roll")


@pytest.fixture(scope="module")
def shifts(hand, played):
    """The function that tells whether motions of 3.2 s in a world are said to be shifted, and surely so."""

    def make(effects=(), late: int = 0):
        recs = recordings(hand, played(hand, effects, count=3, duration_s=3.2, policies=MOTIONS))
        before = np.maximum(np.arange(recs.commands.shape[1]) - late, 0)
        recs = replace(recs, commands=recs.commands[:, before])
        return [f.definite for f in mismatch(Replayer(hand), recs) if f.kind == "shifted_commands"]

    return make


@pytest.mark.parametrize("ppm", [-5.7e3, -1.1e4])
def test_a_slow_clock_is_never_surely_a_shift(hand, shifts, ppm):
    assert True not in shifts((setting("clock_drift", np.array([ppm]), hand),))


@pytest.mark.parametrize(("name", "value"), [("servo_damping", 0.78), ("servo_gain", 1.4)])
def test_a_faster_servo_is_never_surely_a_shift(hand, shifts, name, value):
    assert True not in shifts((setting(name, np.array([value]), hand),))


@pytest.mark.parametrize("late", [1, 2])
def test_commands_that_are_logged_late_are_surely_shifted(shifts, late):
    assert shifts(late=late) == [True]


#: A pendulum on a servo that is weaker, less damped and more rubbed than its model.
PENDULUM = """<mujoco><option timestep="0.0025" integrator="implicitfast"/><worldbody><body>
<joint name="shaft" axis="0 1 0" armature="0.0015" frictionloss="{friction}"/>
<geom type="sphere" size="0.02" pos="0 0 -0.1" mass="0.49" contype="0" conaffinity="0"/></body></worldbody><actuator>
<position name="shaft" joint="shaft" kp="{kp}" kv="{kv}" forcerange="-{limit} {limit}"/></actuator></mujoco>"""
MODEL = {"kp": 3.0, "kv": 0.2, "limit": 5.0, "friction": 0.02}
MOTOR = {"kp": 1.8, "kv": 0.05, "limit": 0.6, "friction": 0.13}
ROWS = 600


def pendulum(folder, **servo):
    """The scene of a pendulum on a servo."""
    folder.mkdir()
    (folder / "scene.xml").write_text(PENDULUM.format(**servo))
    (folder / "scene.yaml").write_text("model: scene.xml\nrate_hz: 200\njoints: [shaft]\nactuators: [shaft]\n")
    return load_scene(folder / "scene.yaml")


def swings():
    """Goals `(3, ROWS)` [rad]: a sum of sines, one swing up, a sine that gets faster."""
    t = np.arange(ROWS) / 200
    fast, slow = np.sin(9 * t), np.sin(1.1 * t)
    return np.stack([1.4 * slow + 0.3 * fast, 1.5 * np.sin(0.5 * t) ** 2, 1.2 * np.sin(t**2)])


def test_commands_are_not_to_be_moved_where_gain_and_motor_are_others(tmp_path):
    model, real = pendulum(tmp_path / "model", **MODEL), pendulum(tmp_path / "real", **MOTOR)
    commands = swings()[..., None]
    played = rollout(real, commands, np.zeros((3, 1)), np.zeros((3, 1)), [()] * 3)
    joint = np.rint(played.readings["joint_position"] / 1.534e-3) * 1.534e-3  # an encoder's steps
    recs = Recordings(("a", "b", "c"), ("a", "b", "c"), commands, {"joint_position": joint}, np.full(3, ROWS), False)
    assert "shifted_commands" not in [f.kind for f in mismatch(Replayer(model), recs)]


@pytest.mark.parametrize("kp", [100, 800])
def test_nor_on_a_real_servo_at_other_gains(shared, tmp_path, kp):
    model = pendulum(tmp_path / "model", **MODEL)
    runs = TABLE.from_folder(shared / "realdata" / "xl330_pendulum").episodes
    recs = recordings(model, [e for e in runs if e.meta.labels["kp"] == kp and e["torque_on"].all()])
    assert "shifted_commands" not in [f.kind for f in mismatch(Replayer(model), recs)]
