"""XHand1, right hand, as boxes and capsules: 12 hinge joints, 5 force-sensing fingertips.

Source: joint table of the MIT-licensed driver in wanweiwei07/wrs (`wrs/robot_con/xhand`) and the public
XHand1 wiki of PNDbotics: origins, axes, ranges, torque limits, link masses. Capsule radius 8 mm reproduces
the link shapes; no mesh of the maker is used.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from candata.rotation import of_fixed_axes
from candata.scenes.contract import Hand

#: Servo stiffness [N m/rad], damping [N m s/rad] and reflected rotor inertia [kg m^2] of every hinge.
#: Not published for this hand: stiff enough to follow a 1 Hz sweep, light links need the armature to
#: stay stable (MuJoCo manual, "armature").
KP, KV, ARMATURE = 3.0, 0.08, 5e-4
RADIUS_M = 0.008
PALM_MASS_KG, PALM_COM_M = 0.539, (0.010, -0.004, 0.058)


class Link(NamedTuple):
    """One joint and the link it moves: origin and far end [m], axis, range [rad], limit [N m], mass [kg].

    `rpy` [rad] turns about the fixed axes x, y, z, in this order, as a URDF means it.
    """

    joint: str
    parent: str
    origin: tuple[float, float, float]
    axis: tuple[float, float, float]
    range: tuple[float, float]
    limit: float
    mass: float
    end: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _finger(name: str, y: float, z: float) -> tuple[Link, Link]:
    """Return the two links of a straight finger that leaves the palm at (6.5 mm, y, z)."""
    proximal, distal = f"{name}1", f"{name}2"
    return (
        Link(proximal, "palm", (0.0065, y, z), (0, 1, 0), (0, 1.919), 1.1, 0.063, (0, 0, 0.0558)),
        Link(distal, proximal, (0, 0, 0.0558), (0, 1, 0), (0, 1.919), 0.4, 0.016, (0, 0, 0.0422)),
    )


LINKS: tuple[Link, ...] = (
    Link(
        "thumb_bend",
        "palm",
        (0.0095, 0.0228, 0.0305),
        (0, 0, -1),
        (0, 1.832),
        1.1,
        0.0115,
        (0.00832, 0.0286, -0.00178),
    ),
    Link(
        "thumb_rota1",
        "thumb_bend",
        (0.00832, 0.0286, -0.00178),
        (1, 0, 0),
        (-0.698, 1.57),
        1.1,
        0.132,
        (0, 0.0553, 0),
        (0, 0.2618, -0.0407),
    ),
    Link("thumb_rota2", "thumb_rota1", (0, 0.0553, 0), (1, 0, 0), (0, 1.57), 0.4, 0.035, (0, 0.0502, 0)),
    Link(
        "index_bend",
        "palm",
        (0.0065, 0.0265, 0.0899),
        (-1, 0, 0),
        (-0.174, 0.174),
        0.4,
        0.069,
        (0, 0, 0.0178),
    ),
    Link("index1", "index_bend", (0, 0, 0.0178), (0, 1, 0), (0, 1.919), 1.1, 0.063, (0, 0, 0.0558)),
    Link("index2", "index1", (0, 0, 0.0558), (0, 1, 0), (0, 1.919), 0.4, 0.016, (0, 0, 0.0422)),
    *_finger("mid", 0.004, 0.1082),
    *_finger("ring", -0.016, 0.1052),
    *_finger("pinky", -0.036, 0.1022),
)
TIPS = ("thumb_rota2", "index2", "mid2", "ring2", "pinky2")


def add(spec: mujoco.MjSpec, parent: mujoco.MjsBody, quat: tuple[float, float, float, float]) -> None:
    """Add the hand to `parent` of `spec` (whose angles are in radians), palm turned by `quat` w x y z.

    Fingertip frames are sites `<joint>_frame` at the tips whose +z a pressing contact reads.
    """
    palm = parent.add_body(
        name="palm",
        quat=quat,
        mass=PALM_MASS_KG,
        ipos=PALM_COM_M,
        inertia=(6.5e-4, 6e-4, 3e-4),
        explicitinertial=True,
    )
    palm.add_geom(
        name="palm",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=(0.012, 0.042, 0.048),
        pos=(-0.006, -0.004, 0.052),
        rgba=(0.25, 0.27, 0.3, 1),
        mass=0,
    )
    bodies = {"palm": palm}
    for link in LINKS:
        bodies[link.joint] = _add_link(spec, bodies[link.parent], link)


def _add_link(spec: mujoco.MjSpec, parent: mujoco.MjsBody, link: Link) -> mujoco.MjsBody:
    """Return the new body of `link` with its capsule, joint and position servo."""
    body = parent.add_body(name=link.joint, pos=link.origin, quat=of_fixed_axes(link.rpy))
    is_tip = link.joint in TIPS
    end = np.array(link.end)
    stop = end - RADIUS_M * end / np.linalg.norm(end) if is_tip else end
    body.add_geom(
        name=link.joint,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=(RADIUS_M, 0, 0),
        fromto=(0, 0, 0, *stop),
        mass=link.mass,
        rgba=(0.95, 0.55, 0.2, 1) if is_tip else (0.55, 0.58, 0.62, 1),
    )
    body.add_joint(
        name=link.joint,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=link.axis,
        range=link.range,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        armature=ARMATURE,
        damping=0.005,
    )
    if is_tip:
        # What is pressed pushes the fingertip back: towards -x of the palm for fingers, -z for the thumb's link.
        quat = (0, 1, 0, 0) if link.joint == "thumb_rota2" else (np.sqrt(0.5), 0, -np.sqrt(0.5), 0)
        body.add_site(name=f"{link.joint}_frame", pos=stop, quat=quat, size=(0.004, 0, 0))
    servo = spec.add_actuator(name=link.joint, target=link.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=KP, kv=KV)
    servo.forcelimited, servo.forcerange = True, (-link.limit, link.limit)
    servo.ctrllimited, servo.ctrlrange = True, link.range
    return body


HAND = Hand(
    name="xhand",
    add=add,
    joints=tuple(link.joint for link in LINKS),
    fingertips=TIPS,
    fingertip_frames=tuple(f"{tip}_frame" for tip in TIPS),
)
