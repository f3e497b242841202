"""What kind of drive an actuator is, in words and units."""

from __future__ import annotations

import mujoco
import pytest

from candata.scenes.drives import drive_of, pulled_by

MODEL = """<mujoco><worldbody>
  <body name="a"><joint name="turn" axis="0 1 0" range="-1 1" limited="true"/><geom size=".1"/><site name="s"/>
    <body name="b" pos=".2 0 0"><joint name="rail" type="slide" range="-1 1"/><geom size=".1"/></body></body>
  <body name="c" pos="0 1 0"><joint name="ball" type="ball"/><geom size=".1"/><site name="t"/></body></worldbody>
  <tendon><fixed name="both"><joint joint="turn" coef="1"/><joint joint="rail" coef="1"/></fixed>
    <fixed name="alone"><joint joint="turn" coef="2"/></fixed>
    <spatial name="cord"><site site="s"/><site site="t"/></spatial></tendon>
  <actuator>{}</actuator></mujoco>"""


def drive(actuator: str):
    """Kind, gains and unit of stiffness of one actuator, and what it pulls."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(actuator))
    found = drive_of(model, 0)
    return found.kind, found.kp, found.kv, found.units.kp, pulled_by(model, 0)


@pytest.mark.parametrize(
    ("actuator", "found"),
    [
        ('<position joint="turn" kp="3" kv=".5"/>', ("position servo", 3, 0.5, "N m/rad", "joint turn")),
        ('<position joint="rail" kp="3"/>', ("position servo", 3, 0, "N/m", "joint rail")),
        ('<position tendon="both" kp="3"/>', ("position servo", 3, 0, "N/m", "tendon both")),
        ('<position tendon="alone" kp="3"/>', ("position servo", 3, 0, "N m/rad", "tendon alone")),
        ('<position joint="turn" kp="3" timeconst=".1"/>', ("position servo", 3, 0, "N m/rad", "joint turn")),
        (
            '<general joint="turn" biastype="affine" gainprm=".1" biasprm="0 -600 -5"/>',
            ("position servo", 600, 5, "N m/rad", "joint turn"),
        ),
        ('<velocity joint="turn" kv="2"/>', ("velocity servo", None, 2, "N m/rad", "joint turn")),
        ('<intvelocity joint="turn" kp="4"/>', ("integrated-velocity servo", 4, 0, "N m/rad", "joint turn")),
        ('<motor joint="turn" gear="5"/>', ("torque motor", None, None, "N m/rad", "joint turn")),
        ('<general joint="turn"/>', ("torque motor", None, None, "N m/rad", "joint turn")),
        ('<general joint="turn" dyntype="filter" dynprm=".1"/>', ("torque motor", None, None, "N m/rad", "joint turn")),
        ('<motor joint="rail"/>', ("force motor", None, None, "N/m", "joint rail")),
        ('<motor site="s"/>', ("force motor", None, None, "N/m", "site s")),
        ('<motor tendon="cord"/>', ("force motor", None, None, "N/m", "tendon cord")),
        ('<damper joint="turn" kv="2" ctrlrange="0 1"/>', ("damper", None, None, "N m/rad", "joint turn")),
        ('<adhesion body="b" ctrlrange="0 1"/>', ("adhesion", None, None, "N/m", "body b")),
        ('<muscle joint="turn" lengthrange="-1 1"/>', ("muscle", None, None, "N m/rad", "joint turn")),
        (
            '<general joint="turn" biastype="affine" biasprm="0 -2 0" gainprm="0"/>',
            ("general", 2, None, "N m/rad", "joint turn"),
        ),
    ],
)
def test_an_actuator_is_told_by_what_it_does(actuator, found):
    assert drive(actuator) == found
