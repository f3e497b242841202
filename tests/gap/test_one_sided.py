"""What recordings tell of one end only is said so, of faults played by plain MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

from candata.reports import advice, summary, words
from candata.scenes import load_scene
from candata.schema.episode import Episode, EpisodeMeta

RATE_HZ, EPISODES, ROWS = 100.0, 8, 100
NOISE_RAD, NOISE_N, NOISE_M = 0.001, 0.02, 0.0001
#: Joints so light that they creep under what dry friction holds, and motors that ask for 0.2 N m at most.
ARM = """<mujoco><option timestep="0.0025" integrator="implicitfast"/><worldbody>
  <body pos="0 0 .5"><joint name="a" axis="0 0 1" damping=".002"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".04" contype="0" conaffinity="0"/>
    <body pos=".2 0 0"><joint name="b" axis="0 0 1" damping=".002"/>
      <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".04" contype="0" conaffinity="0"/></body></body>
  </worldbody><actuator><position name="a" joint="a" kp="2" kv=".12" forcerange="-1 1"/>
  <position name="b" joint="b" kp="2" kv=".12" forcerange="-1 1"/></actuator></mujoco>"""
#: A link of 0.1 N m on its lower stop.
LINK = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
  <body pos="0 0 .5"><joint name="a" axis="0 -1 0" range="0 1.5" damping=".001" armature=".0005"
    solreflimit=".005 1" solimplimit=".99 .999 .001"/>
    <geom type="sphere" pos=".1 0 0" size=".02" mass=".102" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><position name="a" joint="a" kp="20" kv=".2" forcerange="-.6 .6"/></actuator></mujoco>"""
#: A finger that presses on a block with 1.6 N at most.
FINGER = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
  <geom name="table" type="plane" size="1 1 .1"/>
  <body name="block" pos="0 0 .03"><freejoint/><geom name="block" type="box" size=".03 .03 .03" mass=".3"/></body>
  <body pos=".09 0 .075"><joint name="a" axis="0 -1 0" range="-1 1" damping=".01" armature=".0005"/>
    <geom name="tip" type="sphere" pos="-.09 0 0" size=".01" mass=".02"/></body></worldbody>
  <actuator><position name="a" joint="a" kp="1" kv=".04" forcerange="-.4 .4"/></actuator></mujoco>"""


class Fault(NamedTuple):
    """A scene, its commands, and how the real one differs from it."""

    xml: str
    joints: tuple[str, ...]
    centre: float
    swing: float
    change: Callable[[mujoco.MjModel], None] = lambda model: None
    play_rad: float = 0.0
    band_n: float = 0.0


def dry(newton_metre: float) -> Callable[[mujoco.MjModel], None]:
    def change(model):
        model.dof_frictionloss[:] = newton_metre

    return change


def limited(newton_metre: float) -> Callable[[mujoco.MjModel], None]:
    def change(model):
        model.actuator_forcerange[:] = (-newton_metre, newton_metre)

    return change


def force_on(model, data, tip):
    """The force `(3,)` on a geom in its body's frame."""
    total, local = np.zeros(3), np.zeros(6)
    for i, contact in enumerate(data.contact):
        if tip not in contact.geom:
            continue
        mujoco.mj_contactForce(model, data, i, local)
        total += (1.0 if contact.geom[1] == tip else -1.0) * contact.frame.reshape(3, 3).T @ local[:3]
    return data.xmat[model.geom_bodyid[tip]].reshape(3, 3).T @ total


def played(fault: Fault, index: int) -> Episode:
    """An episode, stepped by MuJoCo alone; the play of the gears is between commands and motors."""
    rng = np.random.default_rng(index)
    model = mujoco.MjModel.from_xml_string(fault.xml)
    fault.change(model)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    tips = [i for i in range(model.ngeom) if model.geom(i).name == "tip"]
    t = (np.arange(ROWS) / RATE_HZ)[:, None]
    rate, size = rng.uniform(0.8, 1.6, (1, model.nu)), fault.swing * rng.uniform(0.8, 1, (1, model.nu))
    target = np.clip((t - 0.1) / 0.2, 0, 1) * (fault.centre + size * np.sin(2 * np.pi * rate * (t - 0.1)))
    output, position, pose, force = target[0], [], [], [np.zeros((len(tips), 3))]
    for row in target:
        position.append(np.concatenate([data.joint(name).qpos for name in fault.joints]))
        pose += [np.concatenate([data.body("block").xpos, data.body("block").xquat])] if tips else []
        felt = np.zeros((len(tips), 3))
        for _ in range(4):
            output = np.clip(output, row - fault.play_rad / 2, row + fault.play_rad / 2)
            data.ctrl[:] = output
            mujoco.mj_step(model, data)
            felt += [force_on(model, data, tip) for tip in tips] if tips else 0.0
        force.append(np.where(np.abs(felt / 4) < fault.band_n, 0.0, felt / 4))
    read = {"joint_position": np.array(position) + NOISE_RAD * rng.standard_normal((ROWS, model.nu))}
    if tips:
        read["fingertip_force"] = np.array(force[:-1]) + NOISE_N * rng.standard_normal((ROWS, len(tips), 3))
        read["object_pose"] = np.array(pose)
        read["object_pose"][:, :3] += NOISE_M * rng.standard_normal((ROWS, 3))
    meta = EpisodeMeta(
        id=f"e{index}",
        source="real",
        rate_hz=RATE_HZ,
        joint_names=fault.joints,
        actuator_names=fault.joints,
        fingertip_names=("tip",) * len(tips),
    )
    return Episode(meta, {"time_ns": np.arange(ROWS) * round(1e9 / RATE_HZ), "action": target, **read})


@pytest.fixture
def said(judge, tmp_path):
    """The function that gives the diagnosis of a fault, searched for among some effects."""

    def make(fault: Fault, *effects: str):
        (tmp_path / "scene.xml").write_text(fault.xml)
        names = ", ".join(fault.joints)
        tips = "object: block\nfingertips: [tip]\n" if "tip" in fault.xml else ""
        (tmp_path / "scene.yaml").write_text(
            f"model: scene.xml\nrate_hz: {RATE_HZ}\njoints: [{names}]\nactuators: [{names}]\n{tips}"
            f"noise: {{joint_position: {NOISE_RAD}, fingertip_force: {NOISE_N}, object_pose: [{NOISE_M}, 0.0001]}}\n"
        )
        episodes = [played(fault, i) for i in range(EPISODES)]
        return judge(load_scene(tmp_path / "scene.yaml"), episodes, only=effects)

    return make


def the_number(found):
    """The one parameter of the one effect named."""
    ((estimate,),) = ([*e.parameters.values()] for e in found.report.effects)
    (written,) = found.effects.effects[0].parameters.values()
    assert written == estimate.value
    return estimate


def test_friction_that_sticks_is_known_to_be_no_less(said):
    """More than the 0.2 N m that motors ask for holds a joint, however much more."""
    found = said(Fault(ARM, ("a", "b"), 0.0, 0.1, dry(0.4)), "joint_dry_friction")
    number = the_number(found)
    assert (number.bounded, number.high) == ("low", None)
    assert 0.1 < number.low < number.value < 0.21
    text = " ".join(summary(found.report).split())
    assert "frictionloss_Nm at least 0." in text
    assert "more explains as well" in text
    assert "at least" in words.cause_sentence(found.report)
    assert "known from one side: with any more" in words.unknowns_sentence(found.report)
    assert "at least" in advice.changes(found.report)[0].instruction


def test_moderate_friction_has_two_ends(said):
    number = the_number(said(Fault(ARM, ("a", "b"), 0.0, 0.1, dry(0.04)), "joint_dry_friction"))
    assert number.bounded == "both"
    assert number.low < 0.04 < number.high
    assert number.high - number.low < 0.01


def test_a_motor_that_does_not_lift_its_link_is_known_to_have_no_more(said):
    found = said(Fault(LINK, ("a",), 0.012, 0.01, limited(0.04)), "torque_limit")
    number = the_number(found)
    assert (number.bounded, number.low) == ("high", None)
    assert 0.08 < number.value < number.high < 0.11
    assert "limit at most 0.1" in words.cause_sentence(found.report)


def test_play_that_no_motion_crosses_is_known_to_be_no_less(said):
    number = the_number(said(Fault(ARM, ("a", "b"), 0.0, 0.012, play_rad=0.15), "backlash"))
    assert number.bounded == "low"
    assert 0.01 < number.low < number.value < 0.03


def test_a_dead_band_above_all_forces_is_known_to_be_no_less(said):
    number = the_number(said(Fault(FINGER, ("a",), 0.1, 0.09, band_n=2.6), "tactile_dead_band"))
    assert number.bounded == "low"
    assert 0.8 < number.low < number.value < 2.6


def test_one_of_two_faults_is_known_from_one_side_and_the_other_from_both(said):
    """The second joint sticks, the first one's servo is weak."""

    def change(model):
        model.dof_frictionloss[1] = 0.4
        model.actuator_gainprm[0, 0] *= 0.7
        model.actuator_biasprm[0, 1] *= 0.7

    found = said(Fault(ARM, ("a", "b"), 0.0, 0.1, change), "joint_dry_friction", "servo_gain")
    numbers = {(e.name, e.element): next(iter(e.parameters.values())) for e in found.report.effects}
    assert set(numbers) == {("joint_dry_friction", "b"), ("servo_gain", "a")}
    friction, gain = numbers["joint_dry_friction", "b"], numbers["servo_gain", "a"]
    assert friction.bounded == "low"
    # Friction of 0.1 already moves the joints as 0.4 does, of 0.08 some by 2 mrad.
    assert 0.07 < friction.low < friction.value < 0.11
    assert gain.bounded == "both"
    assert gain.low < 0.7 < gain.high
