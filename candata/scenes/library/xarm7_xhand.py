"""XHand on an xArm7 beside an upright can on a table: `xhand_tabletop` with an arm in the place of the rails."""

from __future__ import annotations

import mujoco

from candata.scenes import tabletop
from candata.scenes.composition import compose
from candata.scenes.contract import ARMS, HANDS, BuiltinScene
from candata.schema.scene import SceneFile

ARM, HAND = "xarm7", "xhand"
#: The table reaches under the arm [m].
TABLE_HALF_WIDTH_M = 0.65
#: Where the arm's base stands on the table [m]. Chosen among five places behind the palm, 5 cm apart: the hand is
#: farthest from a singular posture.
BASE_M = (-0.5, 0.0, 0.0)
#: Sensor noise of the arm's encoders [rad], of which the maker says that the flange comes back within 0.1 mm.
ARM_NOISE_RAD = 0.0002


def build() -> mujoco.MjSpec:
    """Return the scene: table, arm, hand with its palm towards +y, a can."""
    spec = compose(ARM, HAND, world=tabletop.table(TABLE_HALF_WIDTH_M), base_m=BASE_M)
    tabletop.add_can(spec)
    tabletop.add_postures(spec, ARMS.load(ARM).start)
    return spec


def _file() -> SceneFile:
    """Return the roles."""
    arm, hand = ARMS.load(ARM), HANDS.load(HAND)
    joints = (*arm.joints, *hand.joints)
    return SceneFile(
        model="builtin",
        rate_hz=tabletop.RATE_HZ,
        object="object",
        joints=joints,
        actuators=joints,
        fingertips=hand.fingertips,
        fingertip_frames=hand.fingertip_frames,
        support="table",
        groups={"arm": arm.joints, **tabletop.finger_groups(hand.joints)},
        noise=tabletop.NOISE.model_copy(
            update={
                "joint_position": (
                    *[ARM_NOISE_RAD] * len(arm.joints),
                    *[tabletop.NOISE.joint_position] * len(hand.joints),
                )
            }
        ),
    )


SCENE = BuiltinScene(
    file=_file(),
    build=build,
    policies=("grasp_lift_shake", "push", "squeeze", "roll", "free_sweep"),
    about="XHand (12 joints, 5 force-sensing fingertips) on an xArm7 (7 joints), a can on a table",
)
