"""A camera's neck: a link turns about the vertical, another nods on it; their drives feel both."""

from __future__ import annotations

import numpy as np

from candata.scenes import load_scene
from candata.simulate import at_rest, rollout
from candata.testing.effects import sagging_supply

XML = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <joint damping="0.05" armature="0.01"/>
    <geom contype="0" conaffinity="0"/>
    <position kp="25" kv="2" forcerange="-3 3"/>
  </default>
  <worldbody>
    <body name="neck" pos="0 0 0.5">
      <joint name="pan" axis="0 0 1"/>
      <geom type="capsule" fromto="-0.2 0 0 0.2 0 0" size="0.02" mass="0.6"/>
      <body name="head" pos="0.1 0.05 0">
        <joint name="nod" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.015" mass="0.2"/>
        <geom type="sphere" pos="0.4 0 0" size="0.03" mass="0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="pan" joint="pan"/><position name="nod" joint="nod"/></actuator>
</mujoco>
"""
ROLES = """
model: scene.xml
rate_hz: 100
joints: [pan, nod]
actuators: [pan, nod]
noise: {joint_position: 0.001}
"""


def write_neck(folder, xml: str = XML, roles: str = ROLES):
    """The scene, written to a folder."""
    (folder / "scene.xml").write_text(xml)
    (folder / "scene.yaml").write_text(roles)
    return load_scene(folder / "scene.yaml")


def play_neck(scene, worlds, seconds: float = 1.0):
    """What the neck reads in each world while both joints swing, from rest."""
    time_s = np.arange(round(seconds * 100))[:, None] / 100
    commands = np.clip(time_s / 0.2, 0, 1) * np.array([0.6, 0.8]) * np.sin(2 * np.pi * time_s * np.array([1.0, 1.7]))
    n = len(worlds)
    commands = np.repeat(commands[None], n, axis=0)
    return rollout(scene, commands, *at_rest(scene, n), worlds, supply=sagging_supply(commands)).readings
