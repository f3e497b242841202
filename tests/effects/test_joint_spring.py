"""A spring in a joint against its closed form, alone and beside one that the model has."""

from __future__ import annotations

import numpy as np
import pytest

from candata.repair import export_mjcf
from candata.scenes import load_scene
from candata.schema.effect import EffectSetting
from candata.simulate import at_rest, rollout
from candata.simulate.world import build_worlds
from tests.effects.gripper import write_scene

XML = """
<mujoco><compiler angle="{angle}"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
<body><joint name="a" axis="0 0 1" armature="1e-3" {spring}/><geom type="capsule" size="0.01" fromto="0 0 0 .1 0 0"/>
</body></worldbody><actuator><position name="a" joint="a" kp="2" kv="0.2" forcerange="-3 3"/></actuator></mujoco>
"""
ROLES = "model: scene.xml\nrate_hz: 80\njoints: [a]\nactuators: [a]\n"


def scene_of(folder, spring: str = "", angle: str = "radian"):
    return write_scene(folder, XML.format(spring=spring, angle=angle), ROLES)


def spring(stiffness: float, torque: float) -> tuple[EffectSetting, ...]:
    return (EffectSetting(name="joint_spring", parameters={"stiffness_Nm_rad": stiffness, "torque_Nm": torque}),)


def rest(scene, target: float, effects=()) -> float:
    """Where the joint comes to rest."""
    return float(
        rollout(scene, np.full((1, 240, 1), target), *at_rest(scene, 1), [effects]).readings["joint_position"][0, -1, 0]
    )


@pytest.mark.parametrize(("stiffness", "torque"), [(0.5, 0.0), (0.5, 0.3), (0.0, 0.3)])
def test_servo_and_spring_rest_where_both_pull_alike(tmp_path, stiffness, torque):
    """kp (u - q) + torque - stiffness q = 0."""
    scene = scene_of(tmp_path)
    # A torque alone is a spring wound by 1000 rad.
    assert rest(scene, 0.4, spring(stiffness, torque)) == pytest.approx((0.8 + torque) / (2 + stiffness), rel=2e-4)


def test_it_adds_to_the_spring_of_the_model(tmp_path):
    """kp (u - q) + k0 (r0 - q) + torque - stiffness q = 0."""
    scene = scene_of(tmp_path, 'stiffness="0.6" springref="-0.5"')
    assert rest(scene, 0.4) == pytest.approx((0.8 - 0.3) / 2.6, rel=1e-6)
    assert rest(scene, 0.4, spring(0.5, 0.2)) == pytest.approx((0.8 - 0.3 + 0.2) / 3.1, rel=1e-6)


@pytest.mark.parametrize("angle", ["radian", "degree"])
@pytest.mark.parametrize("own", ["", 'springdamper="0.2 1"', 'stiffness="0.6"'])
def test_the_exported_model_holds_it(tmp_path, own, angle):
    scene = scene_of(tmp_path, own, angle)
    found = export_mjcf(scene, spring(0.5, 0.3), tmp_path / "out")
    written, target = (
        load_scene(tmp_path / "out" / found.scene).model,
        build_worlds(scene, [spring(0.5, 0.3)]).models[0],
    )
    assert (found.way, [h.name for h in found.held]) == ("patch", ["joint_spring"])
    for field in ("jnt_stiffness", "qpos_spring", "dof_damping"):
        assert getattr(written, field) == pytest.approx(getattr(target, field), rel=1e-9), field
