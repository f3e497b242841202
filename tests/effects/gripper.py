"""A small gripper whose contacts are explicit pairs, so that every effect of the folder can act in it."""

from __future__ import annotations

import numpy as np

from candata.scenes import load_scene
from candata.simulate import rollout
from candata.testing.effects import sagging_supply

XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0025" integrator="implicitfast" cone="elliptic" impratio="5"/>
  <default><geom solref="0.01 1"/><position kp="2" kv="0.04" forcerange="-0.8 0.8"/></default>
  <worldbody>
    <geom name="table" type="plane" size="1 1 0.1"/>
    <body name="rail" pos="0 0 0.12">
      <joint name="lift" type="slide" axis="0 0 1" armature="0.1"/>
      <geom type="box" size="0.06 0.01 0.01" contype="0" conaffinity="0" mass="0.3"/>
      <body name="left" pos="-0.05 0 0">
        <joint name="left" axis="0 -1 0" range="-0.5 1" armature="5e-4" damping="0.005"/>
        <geom name="left" type="capsule" size="0.008" fromto="0 0 -0.02 0 0 -0.1" mass="0.03"/>
      </body>
      <body name="right" pos="0.05 0 0">
        <joint name="right" axis="0 1 0" range="-0.5 1" armature="5e-4" damping="0.005"/>
        <geom name="right" type="capsule" size="0.008" fromto="0 0 -0.02 0 0 -0.1" mass="0.03"/>
      </body>
    </body>
    <body name="box" pos="0 0.003 0.02">
      <freejoint/>
      <geom name="box" type="box" size="0.02 0.02 0.02" mass="0.1"/>
    </body>
  </worldbody>
  <contact>
    <pair geom1="left" geom2="box" condim="4" friction="0.8 0.8 0.002 0.0001 0.0001"/>
    <pair geom1="right" geom2="box" condim="4" friction="0.8 0.8 0.002 0.0001 0.0001"/>
    <pair geom1="box" geom2="table" condim="3" friction="0.4 0.4 0.005 0.0001 0.0001"/>
  </contact>
  <actuator>
    <position name="lift" joint="lift" kp="1500" kv="80" forcerange="-60 60"/>
    <position name="left" joint="left"/>
    <position name="right" joint="right"/>
  </actuator>
</mujoco>
"""
ROLES = """
model: scene.xml
rate_hz: 80
object: box
joints: [lift, left, right]
actuators: [lift, left, right]
fingertips: [left, right]
support: table
"""


def write_scene(folder, xml: str = XML, roles: str = ROLES):
    """The scene of an MJCF and its roles, written to a folder."""
    (folder / "scene.xml").write_text(xml)
    (folder / "scene.yaml").write_text(roles)
    return load_scene(folder / "scene.yaml")


def grip(seconds: float = 1.2) -> np.ndarray:
    """Commands `(1, T, 3)`: close around the box, lift it, let it go."""
    time_s = np.arange(round(seconds * 80)) / 80
    closed = np.interp(time_s, [0.1, 0.3, 0.9, 1.0], [0.0, 0.5, 0.5, 0.0])
    lifted = np.interp(time_s, [0.4, 0.7, 0.8, 0.9], [0.0, 0.03, 0.03, 0.02])
    return np.stack([lifted, closed, closed], axis=1)[None]


def play_grip(scene, worlds, **options):
    """What the gripper reads in each world, from rest."""
    n = len(worlds)
    qpos = np.repeat(np.asarray(scene.model.qpos0)[None], n, axis=0)
    qvel = np.zeros((n, scene.model.nv))
    commands = np.repeat(grip(), n, axis=0)
    return rollout(scene, commands, qpos, qvel, worlds, supply=sagging_supply(commands), **options)
