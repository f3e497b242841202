"""UFACTORY xArm7 as capsules: seven hinges, a flange.

Source: UFACTORY's ROS description (BSD-3-Clause), `xarm_description` of xArm-Developer/xarm_ros2: origins, axes, ranges
and torque limits of `urdf/xarm7/xarm7.urdf.xacro`; masses, mass centres and inertias of
`config/link_inertial/xarm7_type7_HT_BR2.yaml`, its default. Capsules are our own and follow the links roughly; no mesh
of the maker is used. Its joint damping and friction are round numbers for a simulator and are left out.

The arm's links weigh nothing on the servos, as the real controller compensates for them; what it carries does weigh.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np

from candata.rotation import of_fixed_axes
from candata.scenes.contract import Arm
from candata.scenes.tabletop import STANDS

FLANGE = "flange"
#: Ranges of the joints that turn freely, in both directions [rad].
FULL_TURN = (-2 * np.pi, 2 * np.pi)
BASE_MASS_KG, BASE_COM_M = 0.88556, (-0.021131, -0.0016302, 0.056488)
BASE_INERTIA_KGM2 = (0.0030595, 0.0037783, 0.0020125, 0.00012259, -0.00062705, 0.00027023)
#: Colours of links and flange [r g b a].
WHITE, SILVER = (0.9, 0.9, 0.88, 1), (0.7, 0.7, 0.72, 1)


class Motor(NamedTuple):
    """A size of joint: stiffness [N m/rad], damping [N m s/rad], reflected rotor inertia [kg m^2], limit [N m].

    Only the limits are published. Gains are chosen: about critical for what each joint carries with a hand of 1.3 kg,
    and a lag of 30 to 50 ms, like that of the wrist's rails in `xhand_tabletop`.
    """

    kp: float
    kv: float
    armature: float
    limit: float


LARGE, MIDDLE, SMALL = Motor(4000, 180, 0.5, 50), Motor(2500, 90, 0.25, 30), Motor(1200, 36, 0.1, 20)


class Link(NamedTuple):
    """A joint about its own z and the link that it turns, in the link's frame.

    Attributes
    ----------
    origin, rpy : tuple of float
        Frame in that of the link before [m; rad about fixed x, y, z].
    range : tuple of float
        Of the joint [rad].
    motor : Motor
        What drives it.
    mass, com, inertia : float and tuples of float
        Mass [kg], its centre [m], and xx, yy, zz, xy, xz, yz about it [kg m^2].
    radius, corners : float and tuple
        Capsules of this radius [m] run from each corner to the next [m].
    """

    origin: tuple[float, float, float]
    rpy: tuple[float, float, float]
    range: tuple[float, float]
    motor: Motor
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    radius: float
    corners: tuple[tuple[float, float, float], ...]


LINKS: tuple[Link, ...] = (
    Link(
        origin=(0, 0, 0.267),
        rpy=(0, 0, 0),
        range=FULL_TURN,
        motor=LARGE,
        mass=2.382,
        com=(-0.0002, 0.02905, -0.01233),
        inertia=(0.0056905, 0.0049566, 0.003316654, -1.579e-05, 5.125e-06, -0.000873378),
        radius=0.055,
        corners=((0, 0, -0.08), (0, 0, 0)),
    ),
    Link(
        origin=(0, 0, 0),
        rpy=(-np.pi / 2, 0, 0),
        range=(-2.059, 2.0944),
        motor=LARGE,
        mass=1.869,
        com=(0.00022, -0.12856, 0.01735),
        inertia=(0.0095989, 0.00382472, 0.007565669, 1.541e-06, 5.56e-06, -0.00317156),
        radius=0.055,
        corners=((0, 0, 0), (0, -0.22, 0)),
    ),
    Link(
        origin=(0, -0.293, 0),
        rpy=(np.pi / 2, 0, 0),
        range=FULL_TURN,
        motor=MIDDLE,
        mass=1.6383,
        com=(0.0466, -0.02463, -0.00768),
        inertia=(0.00310955, 0.00264483, 0.0026624, 0.00030837, -0.00058453, 0.000338893),
        radius=0.05,
        corners=((0, 0, -0.02), (0.0525, 0, 0)),
    ),
    Link(
        origin=(0.0525, 0, 0),
        rpy=(np.pi / 2, 0, 0),
        range=(-0.19198, 3.927),
        motor=MIDDLE,
        mass=1.7269,
        com=(0.07047, -0.11575, 0.012),
        inertia=(0.005889, 0.00359703, 0.00543244, 0.00137112, 0.00088143, -0.001762155),
        radius=0.045,
        corners=((0, 0, 0), (0.0775, -0.08, 0), (0.0775, -0.22, 0)),
    ),
    Link(
        origin=(0.0775, -0.3425, 0),
        rpy=(np.pi / 2, 0, 0),
        range=FULL_TURN,
        motor=MIDDLE,
        mass=1.3203,
        com=(-0.00032, 0.01604, -0.026),
        inertia=(0.00534665, 0.0049779, 0.0013624, 1.5117e-05, -3.69e-07, -0.00022132),
        radius=0.045,
        corners=((0, 0, -0.1), (0, 0, 0)),
    ),
    Link(
        origin=(0, 0, 0),
        rpy=(np.pi / 2, 0, 0),
        range=(-1.69297, np.pi),
        motor=SMALL,
        mass=1.325,
        com=(0.06469, 0.03278, 0.02141),
        inertia=(0.0014745, 0.0019037, 0.0023652, -0.000488, 0.0002953, 0.00014749),
        radius=0.038,
        corners=((0, 0, 0), (0.076, 0, 0), (0.076, 0.05, 0)),
    ),
    Link(
        origin=(0.076, 0.097, 0),
        rpy=(-np.pi / 2, 0, 0),
        range=FULL_TURN,
        motor=SMALL,
        mass=0.17,
        com=(0, -0.00677, -0.01098),
        inertia=(9.3e-05, 5.87e-05, 0.000132, 0.0, 0.0, -3.6e-06),
        radius=0.032,
        corners=((0, 0, -0.034), (0, 0, -0.033)),
    ),
)
#: Posture of the joints [rad], elbow up, flange level. Inverse kinematics, first, third and fifth joint held: it
#: puts the palm of `xarm7_xhand` where `xhand_tabletop` has it; a test compares.
START_RAD = (0.0, 0.67435, 0.0, 0.98685, np.pi, 1.25829, np.pi / 2)


def add(
    spec: mujoco.MjSpec,
    parent: mujoco.MjsBody,
    place: tuple[float, float, float],
    quat: tuple[float, float, float, float],
) -> None:
    """Add the arm to `parent` of `spec` (whose angles are in radians): its base at `place` [m], turned by `quat`.

    Links meet what stands on a table, and the table, see `STANDS`; not one another, nor a hand. Bodies are `link_base`,
    `link1` to `link7`, joints and actuators `joint1` to `joint7`, as the maker calls them.
    """
    body = parent.add_body(
        name="link_base",
        pos=place,
        quat=quat,
        mass=BASE_MASS_KG,
        ipos=BASE_COM_M,
        fullinertia=BASE_INERTIA_KGM2,
        explicitinertial=True,
    )
    _add_capsules(body, 0.06, ((0, 0, 0.06), (0, 0, 0.14)), WHITE)
    for number, link in enumerate(LINKS, 1):
        body = _add_link(spec, body, link, number)
    body.add_site(name=FLANGE, size=(0.004, 0, 0))


def _add_link(spec: mujoco.MjSpec, parent: mujoco.MjsBody, link: Link, number: int) -> mujoco.MjsBody:
    """Return the new body of a link with its capsules, joint and position servo."""
    name, motor = f"joint{number}", link.motor
    body = parent.add_body(
        name=f"link{number}",
        pos=link.origin,
        quat=of_fixed_axes(link.rpy),
        mass=link.mass,
        ipos=link.com,
        fullinertia=link.inertia,
        explicitinertial=True,
        gravcomp=1,
    )
    _add_capsules(body, link.radius, link.corners, SILVER if number == len(LINKS) else WHITE)
    body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=(0, 0, 1),
        range=link.range,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        armature=motor.armature,
    )
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=motor.kp, kv=motor.kv)
    servo.forcelimited, servo.forcerange = True, (-motor.limit, motor.limit)
    servo.ctrllimited, servo.ctrlrange = True, link.range
    return body


def _add_capsules(
    body: mujoco.MjsBody,
    radius_m: float,
    corners: tuple[tuple[float, float, float], ...],
    rgba: tuple[float, float, float, float],
) -> None:
    """Add a capsule from each corner to the next; the body has its mass already."""
    for number, ends in enumerate(pairwise(corners)):
        body.add_geom(
            name=f"{body.name}_{number}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(radius_m, 0, 0),
            fromto=(*ends[0], *ends[1]),
            mass=0,
            contype=STANDS,
            conaffinity=0,
            rgba=rgba,
        )


ARM = Arm(
    name="xarm7",
    add=add,
    joints=tuple(f"joint{n}" for n in range(1, len(LINKS) + 1)),
    flange=FLANGE,
    start=START_RAD,
)
