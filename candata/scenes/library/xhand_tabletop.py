"""XHand on a 3-axis wrist beside an upright can on a table."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.scenes.contract import HANDS, BuiltinScene
from candata.scenes.objects.can import HALF_HEIGHT_M as CAN_HALF_HEIGHT_M
from candata.scenes.objects.can import MASS_KG as CAN_MASS_KG
from candata.scenes.objects.can import RADIUS_M as CAN_RADIUS_M
from candata.schema.scene import Noise, SceneFile

RATE_HZ = 80.0
#: Five physics steps a control step: 2.5 ms.
SUBSTEPS = 5
WRIST = ("wrist_x", "wrist_y", "wrist_z")
#: How the names of a finger's joints begin.
FINGERS = ("thumb", "index", "mid", "ring", "pinky")
#: Wrist rails: stiffness [N/m] and damping [N s/m], about critical for the 1.7 kg that they carry.
WRIST_KP, WRIST_KV, WRIST_LIMIT_N = 3000.0, 140.0, 120.0
CAN_START_M = (0.138, 0.058)
HAND_HEIGHT_M = 0.085
#: Collision bit of what stands on the table (MuJoCo manual, "contype"); the hand never reaches the table itself.
STANDS = 2
#: Sliding, torsional [m] and rolling [m] friction of tin on wood; low enough that a push slides the can, not tips it.
TABLE_FRICTION = (0.3, 0.005, 0.0001)
#: Postures [rad] that hold the can by all five fingertips (found by simulated grasps of 400 random postures, of
#: which 73 % lifted it; this one lies in the middle of the good ones).
THUMB_OPEN, THUMB_GRASP = (1.35, 0.0, 0.1), (1.35, 0.85, 0.8)
FINGER_OPEN, FINGER_GRASP = (0.05, 0.3), (0.5, 1.0)


def build() -> mujoco.MjSpec:
    """Return the scene: table, wrist on rails, hand with its palm towards +y, a can."""
    hand = HANDS.load("xhand")
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = 1 / RATE_HZ / SUBSTEPS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.default.geom.friction = (0.8, 0.005, 0.0001)
    spec.default.geom.condim = 4
    spec.default.geom.solref = (0.01, 1.0)
    _add_table(spec)
    wrist = _add_wrist(spec)
    # Palm z (fingers) along world +x, palm y up, palm normal x along world +y.
    hand.add(spec, wrist, (0.5, 0.5, 0.5, 0.5))
    _add_can(spec)
    _exclude_neighbours(spec, hand.joints)
    for name, thumb, finger in (("open", THUMB_OPEN, FINGER_OPEN), ("grasp", THUMB_GRASP, FINGER_GRASP)):
        _add_posture(spec, name, (*thumb, 0.0, *finger * 4))
    return spec


def _add_table(spec: mujoco.MjSpec) -> None:
    """Add light, camera and a table whose top is z = 0 (a plane: its contacts are found in closed form)."""
    spec.worldbody.add_light(pos=(0.2, -0.6, 1.2), dir=(-0.1, 0.4, -1), castshadow=True)
    spec.worldbody.add_camera(
        name="report", pos=(0.42, 0.46, 0.30), fovy=38, xyaxes=(-0.82, 0.57, 0, -0.26, -0.37, 0.89)
    )
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0.4, 0.4, 0.05),
        contype=STANDS,
        conaffinity=STANDS,
        friction=TABLE_FRICTION,
        rgba=(0.82, 0.78, 0.72, 1),
    )


def _add_wrist(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Return the body that three position-controlled slides carry."""
    body = spec.worldbody.add_body(name="wrist", pos=(0, 0, HAND_HEIGHT_M))
    body.add_geom(
        name="wrist",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(0.02, 0, 0),
        mass=0.6,
        contype=0,
        conaffinity=0,
        rgba=(0.3, 0.3, 0.35, 1),
    )
    for name, axis in zip(WRIST, np.eye(3), strict=True):
        body.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis,
            range=(-0.25, 0.25),
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            armature=0.2,
            damping=2.0,
        )
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=WRIST_KP, kv=WRIST_KV)
        servo.forcelimited, servo.forcerange = True, (-WRIST_LIMIT_N, WRIST_LIMIT_N)
        servo.ctrllimited, servo.ctrlrange = True, (-0.25, 0.25)
    return body


def _add_can(spec: mujoco.MjSpec) -> None:
    """Add the free can, standing in front of the palm.

    The hand meets a cylinder; the table meets a box whose corners lie on the rim. A cylinder on a plane has three
    contact points whose places jump with the least tilt, so that it creeps when its mass is off centre.
    """
    can = spec.worldbody.add_body(name="object", pos=(*CAN_START_M, CAN_HALF_HEIGHT_M))
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


def _exclude_neighbours(spec: mujoco.MjSpec, joints: tuple[str, ...]) -> None:
    """Let the hand touch the object and the table only: its own links never meet in these motions."""
    bodies = ["palm", *joints]
    for i, first_body in enumerate(bodies):
        for second_body in bodies[i + 1 :]:
            spec.add_exclude(bodyname1=first_body, bodyname2=second_body)


def _add_posture(spec: mujoco.MjSpec, name: str, hinges: tuple[float, ...]) -> None:
    """Add a keyframe with the hand in a posture, the can where it stands."""
    can = (*CAN_START_M, CAN_HALF_HEIGHT_M, 1.0, 0.0, 0.0, 0.0)
    spec.add_key(name=name, qpos=(0.0, 0.0, 0.0, *hinges, *can), ctrl=(0.0, 0.0, 0.0, *hinges))


def _file() -> SceneFile:
    """Return the roles."""
    hand = HANDS.load("xhand")
    joints = (*WRIST, *hand.joints)
    return SceneFile(
        model="builtin",
        rate_hz=RATE_HZ,
        object="object",
        joints=joints,
        actuators=joints,
        fingertips=hand.fingertips,
        fingertip_frames=hand.fingertip_frames,
        support="table",
        groups={"wrist": WRIST, **{f: tuple(j for j in hand.joints if j.startswith(f)) for f in FINGERS}},
        noise=Noise(
            object_pose=(0.001, np.deg2rad(0.5).item()),
            joint_position=0.002,
            fingertip_force=0.02,
            force_step=0.05,
        ),
    )


SCENE = BuiltinScene(
    file=_file(),
    build=build,
    policies=("grasp_lift_shake", "push", "squeeze", "roll", "free_sweep"),
    about="XHand (12 joints, 5 force-sensing fingertips) on a 3-axis wrist, a can on a table",
)
