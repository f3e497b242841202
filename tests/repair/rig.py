"""A model as people write it, of several files, and effects to write into it."""

from __future__ import annotations

import numpy as np

from candata.effects import effect, effect_names, setting
from candata.scenes import load_scene
from candata.simulate.seal import draw_parameter
from tests.effects.gripper import ROLES

#: The gripper as people write: an include, classes, a comment, single quotes, a tag over two lines, a servo of a class
#: and one in general terms, a geom in a frame, a support in an included file, a mesh.
MAIN = """<mujoco model='rig'>
  <!-- kept as it is: kp="9" -->
  <compiler angle="radian" meshdir="meshes"/>
  <option timestep="0.0025" integrator="implicitfast"
          cone='elliptic' impratio="5"/>
  <default>
    <default class="finger"><geom solref="0.01 1" friction="0.9 0.01 0.001"/><joint damping="0.005"/></default>
    <default class="servo"><position kp="2" kv="0.04" forcerange="-0.8 0.8"/></default>
  </default>
  <include file="parts/world.xml"/>
  <asset><mesh name="lump" file="lump.obj" scale="0.02 0.02 0.02"/></asset>
  <worldbody>
    <body name="rail" pos="0 0 0.12">
      <joint name="lift" type="slide" axis="0 0 1" armature="0.1"/>
      <geom type="box" size="0.06 0.01 0.01" contype="0" conaffinity="0" mass="0.3"/>
      <body name="left" pos="-0.05 0 0" childclass="finger">
        <joint name="left" axis="0 -1 0" range="-0.5 1" armature="5e-4"/>
        <frame pos="0 0 -0.01">
          <geom name='left' type="capsule" size="0.008" fromto="0 0 -0.01 0 0 -0.09" mass="0.03"/>
        </frame>
      </body>
      <body name="right" pos="0.05 0 0" childclass="finger">
        <joint name="right" axis="0 1 0" range="-0.5 1" armature="5e-4"/>
        <geom name="right" type="capsule" size="0.008" fromto="0 0 -0.02 0 0 -0.1" mass="0.03"/>
      </body>
    </body>
    <body name="box" pos="0 0.003 0.02">
      <freejoint/>
      <geom type="box" size="0.02 0.02 0.02" mass="0.1"/>
      <geom type="mesh" mesh="lump" pos="0 0 0.01" mass="0.01" contype="0" conaffinity="0"/>
      <body pos="0.01 0 0.02"><geom type="sphere" size="0.004" mass="0.002"/><site name="mark" pos="0 0 0.004"/></body>
    </body>
  </worldbody>
  <contact>
    <pair geom1="right" geom2="table" condim="3" friction="0.4 0.4 0.005 0.0001 0.0001"/>
  </contact>
  <actuator>
    <position name="lift" joint="lift" kp="1500" kv="80" forcerange="-60 60"/>
    <position class="servo" name="left" joint="left"></position>
    <general name="right" joint="right" gainprm="2" biastype="affine" biasprm="0 -2 -0.04"/>
  </actuator>
</mujoco>
"""
WORLD = """<mujoco>
  <worldbody>
    <geom name="table" type="box" size="1 1 0.1" pos="0 0 -0.1"/>
  </worldbody>
</mujoco>
"""
#: Of three lengths, so that its principal axes are its own.
LUMP = "v 0 0 0\nv 1 0 0\nv 0 1.4 0\nv 0 0 0.7\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def write_rig(folder, main: str = MAIN):
    """The scene of a model of several files, written to a folder; the scene.yaml lies apart from the model."""
    for name, text in (("model/rig.xml", main), ("model/parts/world.xml", WORLD), ("model/meshes/lump.obj", LUMP)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "scene.yaml").write_text("# mine\n" + ROLES.replace("scene.xml", "model/rig.xml").lstrip())
    return load_scene(folder / "scene.yaml")


def drawn(name: str, scene, element: str | None = None, seed: int = 1):
    """An effect with values drawn as a hidden one's are."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([draw_parameter(p, scene, rng) for p in effect(name).parameters])
    return setting(name, x, scene, element)


#: Effects that act in the model; a clock that drifts only scales the step with which it is read.
EDITS = [name for name in effect_names() if effect(name).edit is not None and name != "clock_drift"]
