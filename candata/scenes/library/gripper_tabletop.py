"""Three-finger gripper on two rails over a carton on a table: a light scene, a quarter of the XHand's time to simulate.

All numbers are our own. The fingertips (balls), the carton and the table collide; a fingertip never meets the table.
The fingertips are soft, as rubber is: the impedance of their contacts grows over 5 mm (MuJoCo manual, "solimp"), so
that a wrong width shows.
"""

from __future__ import annotations

import mujoco

from candata.scenes.contract import BuiltinScene
from candata.schema.scene import Noise, SceneFile

RATE_HZ = 50.0
RAILS = ("rail", "lift")
#: Place of each finger's root in the palm [m], and its turn about +z [rad]: two against one.
FINGERS = {"left": (-0.055, 0.028, 3.14159265), "right": (-0.055, -0.028, 3.14159265), "thumb": (0.055, 0.0, 0.0)}
HINGES = tuple(f"{finger}_{joint}" for finger in FINGERS for joint in ("base", "end"))
TIPS = tuple(f"{finger}_tip" for finger in FINGERS)


def _finger(name: str, x: float, y: float, turn: float) -> str:
    """Return the two links of a finger, hanging; both joints close towards the middle where they grow."""
    return f"""
<body name="{name}_base" pos="{x} {y} -0.02" euler="0 0 {turn}">
  <joint name="{name}_base" class="base"/>
  <geom class="link" fromto="0 0 0 0 0 -0.055" mass="0.07"/>
  <body name="{name}_tip" pos="0 0 -0.055">
    <joint name="{name}_end" class="end"/>
    <geom class="link" fromto="0 0 0 0 0 -0.04" mass="0.04"/>
    <geom name="{name}_tip" class="tip" pos="0 0 -0.045"/>
    <site name="{name}_tip" pos="0 0 -0.045" euler="0 1.57079633 0"/>
  </body>
</body>"""


def _servo(name: str, kind: str) -> str:
    """Return the position servo of a joint."""
    return f'<position name="{name}" joint="{name}" class="{kind}"/>'


def build() -> mujoco.MjSpec:
    """Return the scene: four physics steps of 5 ms a control step, implicit servos, elliptic cones."""
    fingers = "".join(_finger(name, *place) for name, place in FINGERS.items())
    servos = "".join(_servo(n, n) for n in RAILS) + "".join(_servo(n, n.rpartition("_")[2]) for n in HINGES)
    return mujoco.MjSpec.from_string(f"""
<mujoco model="gripper_tabletop">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.005" integrator="implicitfast" cone="elliptic" impratio="5"/>
  <default>
    <geom friction="0.8 0.005 0.0001" solref="0.02 1"/>
    <joint damping="0.02" armature="8e-4" axis="0 1 0"/>
    <position kp="5" kv="0.13" forcerange="-1.2 1.2"/>
    <default class="base"><joint range="-0.6 1.2"/><position ctrlrange="-0.6 1.2"/></default>
    <default class="end"><joint range="-0.9 1.2"/><position ctrlrange="-0.9 1.2"/></default>
    <default class="slide"><joint type="slide" damping="4" armature="0.3"/>
      <position kp="2400" kv="120" forcerange="-90 90"/>
      <default class="rail"><joint axis="1 0 0" range="-0.15 0.15"/><position ctrlrange="-0.15 0.15"/></default>
      <default class="lift"><joint axis="0 0 1" range="-0.06 0.25"/><position ctrlrange="-0.06 0.25"/></default>
    </default>
    <default class="link">
      <geom type="capsule" size="0.009" contype="0" conaffinity="0" rgba="0.3 0.3 0.35 1"/>
    </default>
    <default class="tip">
      <geom type="sphere" size="0.012" mass="0.012" condim="4" solimp="0.5 0.95 0.005" contype="1" conaffinity="0"
            rgba="0.9 0.5 0.2 1"/>
    </default>
  </default>
  <worldbody>
    <light pos="0.2 -0.6 1.2" dir="-0.1 0.4 -1"/>
    <camera name="report" pos="0.3 0.36 0.2" fovy="42" xyaxes="-0.77 0.64 0 -0.18 -0.22 0.96"/>
    <geom name="table" type="plane" size="0.4 0.4 0.05" friction="0.4 0.005 0.0001" rgba="0.82 0.78 0.72 1"/>
    <body name="palm" pos="0 0 0.155">
      <joint name="rail" class="rail"/>
      <joint name="lift" class="lift"/>
      <geom class="link" type="box" size="0.05 0.045 0.012" mass="0.45"/>
      {fingers}
    </body>
    <body name="carton" pos="0 0 0.04">
      <freejoint name="carton"/>
      <geom name="carton" type="box" size="0.026 0.046 0.04" mass="0.18" friction="0.4 0.005 0.0001"
            rgba="0.2 0.55 0.75 1"/>
    </body>
  </worldbody>
  <actuator>{servos}</actuator>
</mujoco>""")


SCENE = BuiltinScene(
    file=SceneFile(
        model="builtin",
        rate_hz=RATE_HZ,
        object="carton",
        joints=(*RAILS, *HINGES),
        actuators=(*RAILS, *HINGES),
        fingertips=TIPS,
        fingertip_frames=TIPS,
        support="table",
        groups={"wrist": RAILS, **{f: tuple(j for j in HINGES if j.startswith(f)) for f in FINGERS}},
        noise=Noise(object_pose=(0.0005, 0.005), joint_position=0.001, fingertip_force=0.02, force_step=0.01),
    ),
    build=build,
    policies=("grasp_lift_shake", "push", "squeeze", "roll", "free_sweep"),
    about="three fingers of two joints on two rails, a carton on a table; light: the scene of `candata gap bench`",
)
