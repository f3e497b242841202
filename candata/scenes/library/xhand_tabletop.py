"""XHand on a 3-axis wrist beside an upright can on a table."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.scenes import tabletop
from candata.scenes.contract import HANDS, BuiltinScene
from candata.schema.scene import SceneFile

WRIST = ("wrist_x", "wrist_y", "wrist_z")
#: Wrist rails: stiffness [N/m] and damping [N s/m], about critical for the 1.7 kg that they carry.
WRIST_KP, WRIST_KV, WRIST_LIMIT_N = 3000.0, 140.0, 120.0


def build() -> mujoco.MjSpec:
    """Return the scene: table, wrist on rails, hand with its palm towards +y, a can."""
    hand = HANDS.load("xhand")
    spec = tabletop.table()
    hand.add(spec, _add_wrist(spec), tabletop.PALM_QUAT)
    tabletop.add_can(spec)
    tabletop.exclude_pairs(spec, ("palm", *hand.joints))
    tabletop.add_postures(spec, (0.0, 0.0, 0.0))
    return spec


def _add_wrist(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Return the body that three position-controlled slides carry."""
    body = spec.worldbody.add_body(name="wrist", pos=tabletop.PALM_PLACE_M)
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


def _file() -> SceneFile:
    """Return the roles."""
    hand = HANDS.load("xhand")
    joints = (*WRIST, *hand.joints)
    return SceneFile(
        model="builtin",
        rate_hz=tabletop.RATE_HZ,
        object="object",
        joints=joints,
        actuators=joints,
        fingertips=hand.fingertips,
        fingertip_frames=hand.fingertip_frames,
        support="table",
        groups={"wrist": WRIST, **tabletop.finger_groups(hand.joints)},
        noise=tabletop.NOISE,
    )


SCENE = BuiltinScene(
    file=_file(),
    build=build,
    policies=("grasp_lift_shake", "push", "squeeze", "roll", "free_sweep"),
    about="XHand (12 joints, 5 force-sensing fingertips) on a 3-axis wrist, a can on a table",
)
