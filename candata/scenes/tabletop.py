"""A table with a can on it, beside which a hand works: what the built-in scenes of one hand share."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from candata.scenes.objects.can import HALF_HEIGHT_M as CAN_HALF_HEIGHT_M
from candata.scenes.objects.can import MASS_KG as CAN_MASS_KG
from candata.scenes.objects.can import RADIUS_M as CAN_RADIUS_M
from candata.schema.scene import Noise

RATE_HZ = 80.0
#: Five physics steps a control step: 2.5 ms.
SUBSTEPS = 5
#: Collision bit of what stands on the table (MuJoCo manual, "contype"); the hand never reaches the table itself.
STANDS = 2
#: Sliding, torsional [m] and rolling [m] friction of tin on wood; low enough that a push slides the can, not tips it.
TABLE_FRICTION = (0.3, 0.005, 0.0001)
#: Pose of the can that stands on the table [m, w x y z].
CAN_START = (0.138, 0.058, CAN_HALF_HEIGHT_M, 1.0, 0.0, 0.0, 0.0)
#: Pose of an XHand's palm beside the can [m, w x y z]: fingers along world +x, palm y up, palm normal along world +y.
PALM_PLACE_M, PALM_QUAT = (0.0, 0.0, 0.085), (0.5, 0.5, 0.5, 0.5)
#: Postures of an XHand there [rad] that hold the can by all five fingertips (found by simulated grasps of 400 random
#: postures, of which 73 % lifted it; this one lies in the middle of the good ones).
THUMB_OPEN, THUMB_GRASP = (1.35, 0.0, 0.1), (1.35, 0.85, 0.8)
FINGER_OPEN, FINGER_GRASP = (0.05, 0.3), (0.5, 1.0)
XHAND_POSTURES = {
    "open": (*THUMB_OPEN, 0.0, *FINGER_OPEN * 4),
    "grasp": (*THUMB_GRASP, 0.0, *FINGER_GRASP * 4),
}
#: How the names of the joints of an XHand's fingers begin.
XHAND_FINGERS = ("thumb", "index", "mid", "ring", "pinky")
#: Sensor noise of the built-in scenes of an XHand.
NOISE = Noise(object_pose=(0.001, np.deg2rad(0.5).item()), joint_position=0.002, fingertip_force=0.02, force_step=0.05)


def table(half_width_m: float = 0.4) -> mujoco.MjSpec:
    """Return a spec with light, camera and a table whose top is z = 0 (a plane: its contacts have a closed form).

    Its width is only seen: the plane goes on.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = 1 / RATE_HZ / SUBSTEPS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.default.geom.friction = (0.8, 0.005, 0.0001)
    spec.default.geom.condim = 4
    spec.default.geom.solref = (0.01, 1.0)
    spec.worldbody.add_light(pos=(0.2, -0.6, 1.2), dir=(-0.1, 0.4, -1), castshadow=True)
    spec.worldbody.add_camera(
        name="report", pos=(0.42, 0.46, 0.30), fovy=38, xyaxes=(-0.82, 0.57, 0, -0.26, -0.37, 0.89)
    )
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(half_width_m, half_width_m, 0.05),
        contype=STANDS,
        conaffinity=STANDS,
        friction=TABLE_FRICTION,
        rgba=(0.82, 0.78, 0.72, 1),
    )
    return spec


def add_can(spec: mujoco.MjSpec) -> None:
    """Add the free can, standing on the table.

    The hand meets a cylinder; the table meets a box whose corners lie on the rim. A cylinder on a plane has three
    contact points whose places jump with the least tilt, so that it creeps when its mass is off centre.
    """
    can = spec.worldbody.add_body(name="object", pos=CAN_START[:3])
    can.add_freejoint(name="object")
    can.add_geom(
        name="object",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        mass=CAN_MASS_KG,
        size=(CAN_RADIUS_M, CAN_HALF_HEIGHT_M, 0),
        rgba=(0.2, 0.55, 0.75, 1),
    )
    can.add_geom(
        name="object_foot",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(*[CAN_RADIUS_M * np.sqrt(0.5)] * 2, CAN_HALF_HEIGHT_M),
        mass=0,
        contype=STANDS,
        conaffinity=STANDS,
        friction=TABLE_FRICTION,
        rgba=(0, 0, 0, 0),
    )
    can.add_geom(
        name="object_mark",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.004, 0.002, 0.05),
        mass=0,
        pos=(0, CAN_RADIUS_M, 0),
        contype=0,
        conaffinity=0,
        rgba=(0.95, 0.95, 0.95, 1),
    )


def exclude_pairs(spec: mujoco.MjSpec, bodies: Sequence[str]) -> None:
    """Let bodies never touch one another: the links of a hand that stay apart, but for neighbours that overlap."""
    for i, first_body in enumerate(bodies):
        for second_body in bodies[i + 1 :]:
            spec.add_exclude(bodyname1=first_body, bodyname2=second_body)


def add_postures(spec: mujoco.MjSpec, carrier: Sequence[float]) -> None:
    """Add the keyframes `open` and `grasp` of an XHand, what carries it at `carrier (n,)` [rad, m], and the can."""
    for name, hinges in XHAND_POSTURES.items():
        spec.add_key(name=name, qpos=(*carrier, *hinges, *CAN_START), ctrl=(*carrier, *hinges))


def finger_groups(joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the joints of an XHand by finger."""
    return {finger: tuple(j for j in joints if j.startswith(finger)) for finger in XHAND_FINGERS}
