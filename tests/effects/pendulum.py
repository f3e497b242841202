"""One joint, its servo and a mass: the test bed of effects of the drive."""

from __future__ import annotations

import numpy as np

from tests.effects.gripper import write_scene

#: An arm of 0.1 kg at 0.1 m: up to 0.1 N m of weight, a third of what the servo gives.
XML = """<mujoco><compiler angle="radian"/><option timestep="0.0025" integrator="implicitfast"/><worldbody>
  <body><joint name="a" axis="0 1 0" armature="1e-3" damping="2e-3"/>
    <geom type="capsule" size="0.01" fromto="0 0 0 0.1 0 0" mass="0.02"/>
    <geom type="sphere" size="0.02" pos="0.1 0 0" mass="0.1"/></body>
</worldbody><actuator>SERVO</actuator></mujoco>"""
SERVO = '<position name="a" joint="a" kp="2" kv="0.06" forcerange="-0.3 0.3" ctrlrange="-3 3"/>'
ROLES = "model: scene.xml\nrate_hz: 100\njoints: [a]\nactuators: [a]\n"


def write_pendulum(folder, servo: str = SERVO, **options: str):
    """The scene of a pendulum with another servo, or other options such as `integrator`."""
    xml = XML.replace("SERVO", servo)
    for name, value in options.items():
        xml = xml.replace('integrator="implicitfast"', f'{name}="{value}"')
    folder.mkdir(parents=True, exist_ok=True)
    return write_scene(folder, xml, ROLES)


def excitation(seed: int, duration_s: float = 3.0) -> np.ndarray:
    """Commands `(T, 1)` at 100 Hz that are slow, then fast, then saturate: sines and steps drawn by the seed."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(int(100 * duration_s)) / 100
    slow = rng.uniform(0.3, 0.6) * np.sin(2 * np.pi * rng.uniform(0.2, 0.4) * time_s)
    fast = rng.uniform(0.2, 0.5) * np.sin(2 * np.pi * rng.uniform(1.0, 2.0) * time_s)
    steps = rng.choice([-1.0, -0.4, 0.5, 1.0], len(time_s) // 50 + 1).repeat(50)[: len(time_s)]
    share = np.clip(3 * time_s / duration_s, 0, 3)
    out = np.where(share < 1, slow, np.where(share < 2, slow + fast, steps))
    return np.asarray(out - out[0])[:, None]
