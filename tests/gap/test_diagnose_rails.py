"""End to end on a gripper whose jaws slide: a fault of one jaw is named there, in newtons, and one of both pads."""

from __future__ import annotations

import pytest

from candata.reports.numbers import unit_of
from candata.reports.terminal import summary
from candata.scenes import Scene
from candata.simulate.episodes import EpisodeJob, make_episodes
from tests.effects.gripper import write_scene

#: Two jaws with a motor each, under a lift and a wrist's hinge.
XML = """<mujoco><option timestep="0.0025" integrator="implicitfast"/>
  <default><geom friction="1 .005 .0001" condim="4"/></default>
  <worldbody><geom name="floor" type="plane" size="1 1 .1"/>
    <body name="rail" pos="0 0 .1"><joint name="lift" type="slide" axis="0 0 1" range="-.02 .15" armature=".2"/>
      <joint name="wrist" axis="0 0 1" range="-.6 .6" damping=".05" armature=".01"/>
      <geom type="box" size=".06 .02 .01" mass=".3" contype="0" conaffinity="0"/>
      <body name="left" pos="-.045 0 -.07"><joint name="left" type="slide" axis="1 0 0" range="0 .04" damping="3"/>
        <geom name="left" type="box" size=".006 .012 .02" mass=".05" contype="1" conaffinity="0"/></body>
      <body name="right" pos=".045 0 -.07"><joint name="right" type="slide" axis="-1 0 0" range="0 .04" damping="3"/>
        <geom name="right" type="box" size=".006 .012 .02" mass=".05" contype="1" conaffinity="0"/></body>
    </body>
    <body name="cube" pos="0 0 .02"><freejoint/><geom name="cube" type="box" size=".02 .02 .02" mass=".1"/></body>
  </worldbody>
  <actuator>
    <position name="lift" joint="lift" kp="2000" kv="90"/>
    <position name="wrist" joint="wrist" kp="8" kv=".4" forcerange="-3 3"/>
    <position name="left" joint="left" kp="500" kv="10" forcerange="-12 12" ctrlrange="0 .04"/>
    <position name="right" joint="right" kp="500" kv="10" forcerange="-12 12" ctrlrange="0 .04"/>
  </actuator></mujoco>"""
ROLES = """model: scene.xml
rate_hz: 80
object: cube
joints: [lift, wrist, left, right]
actuators: [lift, wrist, left, right]
fingertips: [left, right]
support: floor
noise: {object_pose: [0.0007, 0.006], joint_position: 0.0003, fingertip_force: 0.05}
"""
#: What would be named where jaws had no such effect, and what moves the same readings.
ONLY = ("joint_dry_friction", "joint_damping", "servo_gain", "servo_damping", "object_mass", "sliding_friction")


@pytest.fixture(scope="module")
def gripper(tmp_path_factory) -> Scene:
    return write_scene(tmp_path_factory.mktemp("rails"), XML, ROLES)


def recorded(scene, effects=()):
    names = [("grasp_lift_shake", "free_sweep")[i % 2] for i in range(8)]
    jobs = [EpisodeJob(id=f"{n}-{i}", index=i, policy=n, seed=3, effects=tuple(effects)) for i, n in enumerate(names)]
    return make_episodes(scene, jobs, duration_s=1.6, noise=scene.file.noise)


def test_a_dry_jaw_is_named(gripper, planted, judge):
    true = planted("joint_dry_friction", "left", frictionloss_Nm=1.2)
    report = judge(gripper, recorded(gripper, true), only=ONLY).report
    assert report.verdict == "explained"
    (named,) = report.effects
    assert (named.name, named.element) == ("joint_dry_friction", "left")
    estimate = named.parameters["frictionloss_Nm"]
    # Joints are read to 0.3 mm, and 500 N/m hold them: 0.15 N a reading, of hundreds that move.
    assert estimate.value == pytest.approx(1.2, abs=0.15)
    assert (estimate.unit, unit_of("joint_dry_friction", "frictionloss_Nm", estimate)) == ("N", "N")
    text = " ".join(summary(report).split())
    assert " N (90 %" in text
    assert "N m" not in text


def test_slippery_fingertips_are_named_and_the_floor_is_not(gripper, planted, judge):
    true = planted("sliding_friction", "fingertips", scale=0.3)
    report = judge(gripper, recorded(gripper, true), only=ONLY).report
    assert report.verdict == "explained"
    (named,) = report.effects
    assert (named.name, named.element) == ("sliding_friction", "fingertips")
    assert named.parameters["scale"].value == pytest.approx(0.3, rel=0.05)


def test_without_it_no_jaw_is(gripper, judge):
    report = judge(gripper, recorded(gripper), only=ONLY).report
    assert (report.verdict, report.effects) == ("no_gap", ())
