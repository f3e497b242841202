"""Where a scene's joints put its fingertips: as MuJoCo says."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from candata.models._kinematics import Fingertips  # noqa: E402
from candata.scenes import load_scene  # noqa: E402
from candata.scenes.kinematics import hand_kinematics  # noqa: E402

HAND = """<mujoco>
  <worldbody>
    <geom name="table" type="box" size=".5 .5 .02" pos="0 0 .1"/>
    <body name="base" pos=".1 0 .5" euler="20 10 0">CARRIER
      <geom size=".02" mass=".1"/>
      <body name="link" pos="0 0 .1" euler="0 30 0">
        <joint name="lift" type="slide" axis="0 0 1" ref=".05"/>
        <joint name="bend" axis="0 1 0" pos="0 0 -.02"/>
        <geom type="capsule" fromto="0 0 0 0 0 .1" size=".01" mass=".1"/>
        <body name="tip" pos="0 0 .1">
          <joint name="curl" axis="1 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 .05" size=".01" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
  COUPLING
  <actuator><position name="bend" joint="bend" kp="1"/></actuator>
</mujoco>"""
COUPLING = '<equality><joint joint1="curl" joint2="bend" polycoef=".1 .8 0 0 0"/></equality>'
SCENE = """model: hand.xml
rate_hz: 100
joints: [lift, bend]
actuators: [bend]
fingertips: [tip]
support: table
"""


def scene(folder: Path, coupling: str = COUPLING, carrier: str = ""):
    (folder / "hand.xml").write_text(HAND.replace("COUPLING", coupling).replace("CARRIER", carrier))
    (folder / "scene.yaml").write_text(SCENE)
    return load_scene(folder / "scene.yaml")


def test_fingertips_are_where_the_simulator_puts_them(tmp_path):
    found = scene(tmp_path)
    hand = hand_kinematics(found)
    assert hand.driven_joints == (1,)
    assert hand.support_height_m == pytest.approx(0.12)
    model, data = found.model, mujoco.MjData(found.model)
    readings = np.array([0.02, 0.6])
    for name, value in (("lift", 0.02), ("bend", 0.6), ("curl", 0.1 + 0.8 * 0.6)):
        data.qpos[model.joint(name).qposadr] = value
    mujoco.mj_kinematics(model, data)
    tip = model.body("tip").id
    end = data.xpos[tip] + data.xmat[tip].reshape(3, 3) @ [0, 0, 0.05]  # the capsule's far centre
    tips = Fingertips(hand)(torch.tensor(readings, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(tips[0], end, atol=1e-6)  # float32, in metres


@pytest.mark.parametrize("fields", [{"coupling": ""}, {"carrier": '<freejoint name="free"/>'}])
def test_joints_that_are_not_read_leave_it_open(tmp_path, fields):
    assert hand_kinematics(scene(tmp_path, **fields)) is None
