"""The gripper of `two_finger` over a box on a table: joints and fingertips bear the device's names."""

from __future__ import annotations

import mujoco

from candata.scenes.contract import BuiltinScene
from candata.schema.scene import Noise, SceneFile

XML = """
<mujoco>
  <option timestep="0.0025" integrator="implicitfast" cone="elliptic"/>
  <default>
    <position kp="2" kv="0.04" forcerange="-0.8 0.8"/>
    <joint range="-0.5 1" armature="5e-4" damping="0.005"/>
  </default>
  <worldbody>
    <geom name="table" type="plane" size="1 1 0.1"/>
    <body name="left" pos="-0.05 0 0.12">
      <joint name="left" axis="0 -1 0"/>
      <geom name="left" type="capsule" size="0.008" fromto="0 0 -0.02 0 0 -0.1" mass="0.03"/>
    </body>
    <body name="right" pos="0.05 0 0.12">
      <joint name="right" axis="0 1 0"/>
      <geom name="right" type="capsule" size="0.008" fromto="0 0 -0.02 0 0 -0.1" mass="0.03"/>
    </body>
    <body name="box" pos="0 0 0.02">
      <freejoint/>
      <geom name="box" type="box" size="0.02 0.02 0.02" mass="0.1"/>
    </body>
  </worldbody>
  <actuator><position name="left" joint="left"/><position name="right" joint="right"/></actuator>
</mujoco>
"""

SCENE = BuiltinScene(
    file=SceneFile(
        model="builtin",
        rate_hz=80,
        object="box",
        joints=("left", "right"),
        actuators=("left", "right"),
        fingertips=("left", "right"),
        support="table",
        noise=Noise(object_pose=(0.0005, 0.005), joint_position=0.001, fingertip_force=0.02, force_step=0.01),
    ),
    build=lambda: mujoco.MjSpec.from_string(XML),
    policies=("wave",),
    about="two fingers over a box on a table",
)
