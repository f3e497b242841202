"""Grasp the object, lift it, shake it, put it down, let go."""

from __future__ import annotations

import numpy as np

from candata.policies import _postures as p
from candata.policies._contract import Plan, Policy
from candata.scenes import Scene


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; grip, height, shaking direction, amplitude and frequency are random."""
    hand, t = p.postures(scene), p.times(scene, duration_s)
    unit = duration_s / 3.2
    grip = rng.uniform(0.95, 1.12)
    closed = p.blend(t, 0.1 * unit, rng.uniform(0.5, 0.8) * unit) - p.blend(t, 2.75 * unit, 0.3 * unit)
    commands = hand.open + grip * closed[:, None] * (hand.closed - hand.open)
    if len(hand.rails.columns):
        lift = p.blend(t, 1.0 * unit, 0.5 * unit) - p.blend(t, 2.35 * unit, 0.35 * unit)
        shaking = p.blend(t, 1.5 * unit, 0.15 * unit) - p.blend(t, 2.2 * unit, 0.15 * unit)
        count = len(hand.rails.columns)
        amplitude = rng.uniform(0.006, 0.016, count) * rng.choice([-1, 1], count)
        wave = np.sin(2 * np.pi * rng.uniform(1.5, 3.0) * (t - 1.5 * unit))
        commands[:, hand.rails.columns] += (shaking * wave)[:, None] * amplitude
        height = rng.uniform(0.04, 0.07)
        p.shift(commands, hand.rails.lift, height * lift)
    return p.finish(scene, commands, rng)


POLICY = Policy("grasp, lift, shake, put down, release", p.has_hand_and_object, _plan)
