"""All actuators wave about where they begin, each at a pace of its own."""

from __future__ import annotations

import numpy as np

from candata.policies import Plan, Policy, command_limits
from candata.scenes import Scene

#: Share of the range of an actuator, and the slowest and fastest wave [Hz]. Chosen: a motion that a small hand follows.
SHARE, SLOW_HZ, FAST_HZ = 0.3, 0.3, 1.0


def plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the waves of one episode."""
    low, high = command_limits(scene).T
    time_s = np.arange(round(duration_s * scene.file.rate_hz))[:, None] / scene.file.rate_hz
    pace_hz = rng.uniform(SLOW_HZ, FAST_HZ, len(low))
    begin = np.clip(scene.model.actuator_length0[scene.actuator_ids], low, high)
    commands = begin + SHARE * (high - low) * np.sin(2 * np.pi * pace_hz * time_s)
    rest = np.array(scene.model.qpos0), np.zeros(scene.model.nv)
    return Plan(np.clip(commands, low, high), *rest, settle_s=0.5)


POLICY = Policy("wave with every actuator", possible=lambda scene: len(scene.actuator_ids) > 0, plan=plan)
