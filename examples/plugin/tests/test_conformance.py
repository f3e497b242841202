"""What every plug-in must keep: two lines each."""

from candata_example.coaster import OBJECT
from candata_example.frozen_pose import RULE
from candata_example.json_lines import FORMAT
from candata_example.linear import MODEL
from candata_example.return_spring import EFFECT
from candata_example.two_finger import DEVICE
from candata_example.two_finger_tabletop import SCENE
from candata_example.wave import POLICY

from candata.testing import (
    CheckConformance,
    DeviceConformance,
    EffectConformance,
    FormatConformance,
    ModelConformance,
    ObjectConformance,
    PolicyConformance,
    SceneConformance,
)


class TestReturnSpring(EffectConformance):
    effect = EFFECT


class TestLinear(ModelConformance):
    model = MODEL


class TestJsonLines(FormatConformance):
    format = FORMAT


class TestTwoFinger(DeviceConformance):
    device = DEVICE


class TestWave(PolicyConformance):
    policy = POLICY


class TestTwoFingerTabletop(SceneConformance):
    scene = SCENE


class TestCoaster(ObjectConformance):
    object = OBJECT


class TestFrozenPose(CheckConformance):
    rule = RULE

    def damage(self, arrays, rate_hz, rng):
        """The tracker loses the object in the second half."""
        pose = arrays["object_pose"].copy()
        pose[len(pose) // 2 :] = pose[len(pose) // 2]
        return arrays | {"object_pose": pose}
