"""Hands that candata has no file for, and robots that are driven in other ways than hinge by hinge."""

from __future__ import annotations

from pathlib import Path

import mujoco

from candata.scenes import Scene, load_scene
from candata.scenes.assemble import assemble
from candata.scenes.library import xhand_tabletop

FOUR_FINGERS = Path(__file__).resolve().parents[2] / "examples/four_finger_hand/scene.yaml"

#: A parallel gripper on a rail: two sliding jaws pulled by one tendon, whose servo takes 0 to 255.
JAWS = """<mujoco><option timestep="0.0025" integrator="implicitfast"/>
  <default><geom friction="1 .005 .0001" condim="4"/></default>
  <worldbody><geom name="floor" type="plane" size="1 1 .1"/>
    <body name="rail" pos="0 0 .1"><joint name="lift" type="slide" axis="0 0 -1" armature=".2"/>
      <geom type="box" size=".06 .02 .01" mass=".3" contype="0" conaffinity="0"/>
      <body name="left" pos="-.04 0 -.07"><joint name="left" type="slide" axis="1 0 0" range="0 .04" damping="5"/>
        <geom name="left" type="box" size=".006 .012 .02" mass=".05" contype="1" conaffinity="0"/></body>
      <body name="right" pos=".04 0 -.07"><joint name="right" type="slide" axis="-1 0 0" range="0 .04" damping="5"/>
        <geom name="right" type="box" size=".006 .012 .02" mass=".05" contype="1" conaffinity="0"/></body>
    </body>
    <body name="cube" pos="0 0 .05"><freejoint/><geom name="cube" type="box" size=".02 .02 .02" mass=".1"/></body>
  </worldbody>
  <tendon><fixed name="jaws"><joint joint="left" coef=".5"/><joint joint="right" coef=".5"/></fixed></tendon>
  <equality><joint joint1="left" joint2="right"/></equality>
  <actuator>
    <general name="jaws" tendon="jaws" biastype="affine" gainprm=".1" biasprm="0 -637.5 -5" ctrlrange="0 255"/>
    <position name="lift" joint="lift" kp="2000" kv="90" ctrlrange="-.2 .1"/>
  </actuator></mujoco>"""
JAWS_ROLES = """model: scene.xml
rate_hz: 100
object: cube
joints: [lift, left, right]
actuators: [jaws, lift]
fingertips: [left, right]
support: floor
"""


def write(folder: Path, xml: str, roles: str) -> Scene:
    """The scene of an MJCF and its roles, written to a folder."""
    (folder / "scene.xml").write_text(xml)
    (folder / "scene.yaml").write_text(roles)
    return load_scene(folder / "scene.yaml")


def without_keyframes() -> Scene:
    """The built-in hand, as if nobody had given postures."""
    spec: mujoco.MjSpec = xhand_tabletop.build()
    for key in list(spec.keys):
        spec.delete(key)
    return assemble("no keyframes", xhand_tabletop.SCENE.file, spec, xhand_tabletop.SCENE.policies)
