"""A pendulum on a servo, and a neck of two links: heavier links, softer servos, and what motion cannot tell apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from candata.scenes import Scene, load_scene
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.scene import Noise
from candata.simulate import at_rest, rollout
from candata.simulate.episodes import add_noise
from tests.effects.pan_tilt import write_neck

RATE_HZ = 100.0
XML = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="arm" pos="0 0 1"><joint name="hinge" axis="0 1 0" damping="0.05" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.15" contype="0" conaffinity="0"/>
    <geom type="sphere" pos="0 0 -0.3" size="0.03" mass="0.4" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><position name="hinge" joint="hinge" kp="12" kv="1" forcerange="-8 8"/></actuator></mujoco>
"""
ROLES = """model: pendulum.xml
rate_hz: 100
joints: [hinge]
actuators: [hinge]
noise: {joint_position: 0.001}
"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory) -> Scene:
    """An arm with a mass at its end; gravity bends it by up to 0.1 rad."""
    folder = tmp_path_factory.mktemp("pendulum")
    (folder / "pendulum.xml").write_text(XML)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")


def swings(rng: np.random.Generator, frequencies_hz, amplitudes_rad, rows: int, rise_s: float) -> np.ndarray:
    """One episode's commands `(rows, 1)`: a sine that rises from rest."""
    t = np.arange(rows)[:, None] / RATE_HZ
    share = np.clip(t / rise_s, 0, 1)
    rise = share**2 * (3 - 2 * share)
    phase = rng.uniform(0, 2 * np.pi)
    return rise * rng.uniform(*amplitudes_rad) * np.sin(2 * np.pi * rng.uniform(*frequencies_hz) * t + phase)


def recorded(scene: Scene, commands: np.ndarray, effects, rng: np.random.Generator) -> list[Episode]:
    """Recordings of commands `(E, T, A)` in a world with effects."""
    count, rows = commands.shape[:2]
    played = rollout(scene, commands, *at_rest(scene, count), [effects] * count)
    readings = add_noise(played.readings, scene.file.noise, rng)
    return [
        Episode(
            EpisodeMeta(
                id=f"swing-{i:03d}",
                source="real",
                rate_hz=RATE_HZ,
                joint_names=scene.file.joints,
                actuator_names=scene.file.actuator_names,
            ),
            {
                "time_ns": np.arange(rows) * round(1e9 / RATE_HZ),
                "joint_position": readings["joint_position"][i],
                "action": commands[i],
            },
        )
        for i in range(count)
    ]


@pytest.fixture(scope="module")
def slow_and_fast(pendulum):
    """The function that records slow swings, in which gravity shows, and fast ones, in which inertia does."""

    def make(effects) -> list[Episode]:
        rng = np.random.default_rng(1)
        kinds = (((0.25, 0.4), (1.0, 1.6)), ((1.2, 2.0), (0.5, 0.9)))
        commands = np.stack([swings(rng, *kinds[i % 2], rows=160, rise_s=0.3) for i in range(8)])
        return recorded(pendulum, commands, effects, rng)

    return make


@pytest.mark.parametrize(
    ("name", "parameters"), [("link_mass", {"mass_scale": 1.4}), ("servo_gain", {"kp_scale": 0.7})]
)
def test_a_heavier_link_and_a_softer_servo_are_told_apart(pendulum, slow_and_fast, planted, judge, name, parameters):
    """At rest both give way more; in fast motion they do not."""
    report = judge(pendulum, slow_and_fast(planted(name, **parameters))).report
    (effect,) = report.effects
    assert (report.verdict, effect.name) == ("explained", name)
    ((parameter, value),) = parameters.items()
    # Eight episodes of 1 mrad noise tell either to well below a per cent.
    assert effect.parameters[parameter].value == pytest.approx(value, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters"),
    [("servo_dead_band", {"band_rad": 0.03}), ("joint_spring", {"stiffness_Nm_rad": 1.5, "torque_Nm": -0.6})],
)
def test_other_faults_of_a_joint_are_not_taken_for_links(pendulum, slow_and_fast, planted, judge, name, parameters):
    report = judge(pendulum, slow_and_fast(planted(name, **parameters))).report
    assert (report.verdict, [e.name for e in report.effects]) == ("explained", [name])
    for parameter, value in parameters.items():
        # A band of 30 mrad shows where the joint turns back, in few rows.
        assert report.effects[0].parameters[parameter].value == pytest.approx(value, rel=0.1)


@pytest.mark.slow
def test_slow_motion_cannot_tell_mass_from_length(pendulum, planted, judge):
    """At rest a servo feels mass times distance alone, which is no spring either."""
    rng = np.random.default_rng(2)
    # So coarse that inertia does not show in it.
    blurred = replace(pendulum, file=pendulum.file.model_copy(update={"noise": Noise(joint_position=0.003)}))
    commands = np.stack([swings(rng, (0.03, 0.05), (1.2, 1.6), rows=400, rise_s=3.0) for _ in range(8)])
    report = judge(blurred, recorded(blurred, commands, planted("link_mass", mass_scale=1.4), rng)).report
    assert (report.verdict, report.effects) == ("ambiguous", ())
    assert set(report.ambiguous_class) == {"link_mass", "link_com"}
    assert report.next_motion is not None
    assert report.unknown is None


@pytest.mark.slow
def test_a_heavy_link_of_several_is_named(tmp_path, planted, judge):
    neck, rng = write_neck(tmp_path), np.random.default_rng(3)
    kinds = (((0.3, 0.5), (0.7, 1.1)), ((1.0, 1.6), (0.3, 0.5)))
    commands = [np.hstack([swings(rng, *kinds[i % 2], rows=160, rise_s=0.3) for _ in range(2)]) for i in range(8)]
    report = judge(neck, recorded(neck, np.stack(commands), planted("link_mass", "head", mass_scale=1.3), rng)).report
    (effect,) = report.effects
    assert (report.verdict, effect.name, effect.element) == ("explained", "link_mass", "head")
    assert effect.parameters["mass_scale"].value == pytest.approx(1.3, rel=0.02)
