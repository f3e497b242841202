"""Hold the object loosely and turn it by moving neighbouring joints against each other."""

from __future__ import annotations

import numpy as np

from candata.policies import _postures as p
from candata.policies._contract import Plan, Policy
from candata.scenes import Scene


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; each joint has its own phase, so that the contacts roll."""
    hand, t = p.postures(scene), p.times(scene, duration_s)
    unit = duration_s / 3.2
    grip_profile = p.blend(t, 0.1 * unit, rng.uniform(0.5, 0.7) * unit) - p.blend(t, 2.75 * unit, 0.35 * unit)
    travel = hand.closed - hand.open
    commands = hand.open + (rng.uniform(0.92, 1.0) * grip_profile)[:, None] * travel
    roll_envelope = p.blend(t, 0.8 * unit, 0.3 * unit) - p.blend(t, 2.5 * unit, 0.3 * unit)
    phase = rng.uniform(0, 2 * np.pi, len(travel))
    wave = np.sin(2 * np.pi * rng.uniform(0.6, 1.2) * t[:, None] + phase)
    commands += roll_envelope[:, None] * wave * 0.16 * np.abs(travel)
    return p.finish(scene, commands, rng)


POLICY = Policy("roll the object between the fingers", p.has_hand_and_object, _plan)
