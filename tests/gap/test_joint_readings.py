"""Velocity and effort of joints: on the encoder's clock, in whatever unit, and what only they tell."""

from __future__ import annotations

import numpy as np
import pytest

from candata.gap.data.recordings import recordings
from candata.gap.data.velocity import aligned_velocity, joint_velocity
from candata.gap.measure.reference import changed_since
from candata.gap.replay.effort import effort_law
from candata.gap.replay.effort_unit import with_effort_unit
from candata.gap.replay.replayer import Replayer, replay_all
from candata.gap.replay.residuals import layout, residual
from candata.gap.replay.starts import starts
from candata.scenes import Scene, load_scene
from candata.schema.effect import EffectSetting
from candata.schema.episode import Episode, EpisodeMeta
from candata.simulate import at_rest, rollout

RATE_HZ, ROWS, COUNT = 100.0, 400, 8
#: Rows by which the servo reports its velocity late, and its unit of effort [counts for 1 N m].
LATE_ROWS, COUNTS_PER_NM = 3, -870.0
#: Quasi-static: the mass pulls the joint off its target as much as a softer servo would let it go.
XML = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body name="arm" pos="0 0 1"><joint name="hinge" axis="0 1 0" damping="0.001" armature="0.001"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.005" mass="0.01" contype="0" conaffinity="0"/>
    <geom type="sphere" pos="0 0 -0.1" size="0.02" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><position name="hinge" joint="hinge" kp="3" kv="0.01" forcerange="-1.5 1.5"/></actuator></mujoco>
"""
ROLES = "model: pendulum.xml\nrate_hz: 100\njoints: [hinge]\nactuators: [hinge]\nnoise: {joint_position: 0.02}\n"
HEAVIER = (EffectSetting(name="link_mass", parameters={"mass_scale": 1.5}),)
SOFTER = (EffectSetting(name="servo_gain", parameters={"kp_scale": 1 / 1.5}),)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory) -> Scene:
    folder = tmp_path_factory.mktemp("slow")
    (folder / "pendulum.xml").write_text(XML)
    (folder / "scene.yaml").write_text(ROLES)
    return load_scene(folder / "scene.yaml")


def swings(
    scene: Scene, effects=(), seed=0, unit=1.0, channels=("joint_effort",), noise=0.02, emf=0.0
) -> list[Episode]:
    """Slow swings; `unit` is that of the effort, unknown where it is not one, `emf` the speed's part in it [N m s]."""
    rng = np.random.default_rng(seed)
    t = np.arange(ROWS)[None, :, None] / RATE_HZ
    commands = np.minimum(t / 0.5, 1) * np.sin(2 * np.pi * np.linspace(0.05, 0.1, COUNT)[:, None, None] * t)
    played = rollout(scene, commands, *at_rest(scene, COUNT), [effects] * COUNT, read_effort=True).readings
    position = played["joint_position"]
    felt = played["joint_effort"] + emf * joint_velocity(position, RATE_HZ)
    speed = np.roll(joint_velocity(position, RATE_HZ), LATE_ROWS, axis=1)
    arrays = {
        "joint_position": position + noise * rng.standard_normal(position.shape),
        "joint_velocity": speed + 0.01 * rng.standard_normal(position.shape),
        "joint_effort": unit * (felt + 0.01 * rng.standard_normal(position.shape)) + (unit != 1) * 12,
    }
    return [
        Episode(
            EpisodeMeta(
                id=f"swing-{i}",
                source="real",
                rate_hz=RATE_HZ,
                joint_names=("hinge",),
                actuator_names=("hinge",),
                unscaled=("joint_effort",) * (unit != 1 and "joint_effort" in channels),
            ),
            {"time_ns": np.arange(ROWS) * round(1e9 / RATE_HZ), "action": commands[i]}
            | {name: arrays[name][i] for name in ("joint_position", *channels)},
        )
        for i in range(COUNT)
    ]


def test_a_payload_raises_the_effort(pendulum, judge):
    """A softer servo would let the joint go as far: its position alone does not tell them apart."""
    only = ("link_mass", "servo_gain")
    blind = judge(pendulum, swings(pendulum, HEAVIER, channels=()), only=only).report
    assert (blind.verdict, set(blind.ambiguous_class)) == ("ambiguous", set(only))
    report = judge(pendulum, swings(pendulum, HEAVIER), only=only).report
    assert [e.name for e in report.effects] == ["link_mass"]
    assert report.effects[0].parameters["mass_scale"].value == pytest.approx(1.5, rel=0.03)
    assert "joint_effort" in report.data.channels


def test_a_soft_servo_does_not_raise_the_effort(pendulum, judge):
    report = judge(pendulum, swings(pendulum, SOFTER), only=("link_mass", "servo_gain")).report
    assert [e.name for e in report.effects] == ["servo_gain"]
    assert report.effects[0].parameters["kp_scale"].value == pytest.approx(1 / 1.5, rel=0.03)


def test_a_reference_tells_the_unit_of_an_effort(pendulum, judge, as_dataset):
    """A current in counts, of the other sign, with an offset."""
    before = as_dataset(swings(pendulum, unit=COUNTS_PER_NM, seed=1))
    changed = swings(pendulum, HEAVIER, unit=COUNTS_PER_NM)
    report = judge(pendulum, changed, against=before, only=("link_mass", "servo_gain")).report
    assert [e.name for e in report.effects] == ["link_mass"]
    assert "joint_effort has no unit: its size is told by the reference" in report.data.notes


def test_what_a_duty_leaves_open_in_the_reference_is_no_news(pendulum):
    """A duty that holds back-EMF, on two days of a machine whose servo is softer than the scene says."""
    two_days = [swings(pendulum, SOFTER, unit=COUNTS_PER_NM, seed=s, noise=0.002, emf=0.5) for s in (1, 2)]
    replayer = Replayer(pendulum)
    new, old = with_effort_unit(replayer, *(recordings(pendulum, day) for day in two_days))
    compared = changed_since(replayer, new, old, "before")
    begin = starts(pendulum, compared)
    readings = replay_all(replayer, compared, begin, [()])[0]
    plan = layout(pendulum, compared, begin, readings)
    alone, rest = (residual(recs, plan, readings)[..., 1] for recs in (new, compared))
    assert np.nanstd(rest) < 0.9 * np.nanstd(alone)


def test_without_a_reference_the_size_of_such_an_effort_tells_nothing(pendulum, judge):
    report = judge(pendulum, swings(pendulum, HEAVIER, unit=COUNTS_PER_NM), only=("link_mass", "servo_gain")).report
    assert "joint_effort has no unit: its shape over time is compared, its size is not" in report.data.notes
    assert "joint_effort_N_m" not in report.measures


def test_a_unit_that_is_far_off_is_not_believed(pendulum):
    """Counts that are said to be N m: no cause may be named by their size."""
    episodes = swings(pendulum, unit=COUNTS_PER_NM)
    claimed = [Episode(e.meta.model_copy(update={"unscaled": ()}), dict(e.arrays)) for e in episodes]
    found, _ = with_effort_unit(Replayer(pendulum), recordings(pendulum, claimed))
    assert found.unscaled_effort
    assert any("its unit is not believed: its shape over time is compared" in note for note in found.notes)


def test_efforts_in_different_units_are_not_compared(pendulum):
    counts, torques = (recordings(pendulum, swings(pendulum, unit=unit)) for unit in (COUNTS_PER_NM, 1.0))
    for recs, reference in ((counts, torques), (torques, counts)):
        found, _ = with_effort_unit(Replayer(pendulum), recs, reference)
        assert list(found.readings) == ["joint_position"]
        assert any("in different units" in note for note in found.notes)


def test_an_effort_that_follows_nothing_is_not_compared(pendulum, judge):
    episodes = swings(pendulum, SOFTER, unit=COUNTS_PER_NM)
    rng = np.random.default_rng(2)
    noise = [
        Episode(e.meta, dict(e.arrays) | {"joint_effort": rng.standard_normal(e["joint_effort"].shape)})
        for e in episodes
    ]
    report = judge(pendulum, noise, only=("servo_gain",)).report
    assert "joint_effort" not in report.data.channels
    assert any("does not follow the simulator's torques" in note for note in report.data.notes)


def test_late_velocities_are_no_gap(pendulum, judge):
    """Neither the servo's lateness nor its filter is news: a null with velocity and effort is none."""
    channels = ("joint_velocity", "joint_effort")
    report = judge(pendulum, swings(pendulum, channels=channels, noise=0.001), only=("servo_gain", "link_mass")).report
    assert report.verdict == "no_gap"
    assert {"joint_velocity", "joint_effort"} <= set(report.data.channels)
    assert "joint_velocity is up to 30 ms later than joint_position: compared in time" in report.data.notes


def test_velocities_are_put_on_the_encoders_clock(rng):
    position = np.sin(np.linspace(0, 12, ROWS))[None, :, None] * np.array([1.0, 0.5, 0.2])
    rate = joint_velocity(position, RATE_HZ)
    late = np.concatenate([np.full((1, LATE_ROWS, 3), np.nan), 0.95 * rate[:, :-LATE_ROWS]], axis=1)
    late[..., 1] *= 57.3  # degrees
    late[..., 2] = rng.standard_normal((1, ROWS))
    aligned, notes = aligned_velocity(late, position, RATE_HZ, ("a", "b", "c"))
    np.testing.assert_allclose(aligned[0, :-LATE_ROWS, 0], rate[0, :-LATE_ROWS, 0], atol=1e-9)
    assert np.isnan(aligned[..., 1:]).all()
    assert notes == (
        "joint_velocity is up to 30 ms later than joint_position: compared in time",
        "joint_velocity of b, c is not the rate of joint_position: it is not compared",
    )


def test_a_velocity_that_some_episodes_lack_is_not_compared(pendulum):
    """The episodes stay: it is the channel that goes."""
    whole = swings(pendulum, channels=("joint_velocity",))
    part = [Episode(whole[0].meta, {n: v for n, v in whole[0].arrays.items() if n != "joint_velocity"}), *whole[1:]]
    recs = recordings(pendulum, part)
    assert (len(recs), list(recs.readings)) == (COUNT, ["joint_position"])
    assert f"joint_velocity is not compared: 1 of {COUNT} episodes lack it" in recs.notes


def test_an_effort_is_a_line_through_torque_and_speed(rng):
    torque, speed = rng.standard_normal((2, 4, 50))
    effort = -3 * torque + 0.5 * speed + 2
    effort[0, :5] = np.nan
    weights, share = effort_law(effort, torque, speed)
    np.testing.assert_allclose(weights, [-3, 0.5, 2])
    assert share == pytest.approx(1)
    assert effort_law(np.full((1, 9), 4.0), torque[:1, :9], speed[:1, :9])[1] == 0
    assert effort_law(np.full((1, 2), np.nan), torque[:1, :2], speed[:1, :2])[1] == 0
