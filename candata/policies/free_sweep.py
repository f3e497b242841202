"""Sweep all joints through the air, slowly and fast, away from the object."""

from __future__ import annotations

import numpy as np

from candata.policies import _postures as p
from candata.policies._contract import Plan, Policy
from candata.scenes import Scene

#: How far the wrist backs off, or the object is put away, to keep the sweep free [m].
AWAY_M = 0.14


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan: sines whose rate rises from slow reversals (friction) to fast ones (delay, inertia)."""
    hand, t = p.postures(scene), p.times(scene, duration_s)
    commands = np.repeat(hand.open[None], len(t), axis=0)
    travel = 0.9 * hand.sweep
    slow, fast = rng.uniform(0.3, 0.6, len(travel)), rng.uniform(1.5, 3.0, len(travel))
    phase = 2 * np.pi * (slow * t[:, None] + (fast - slow) * t[:, None] ** 2 / (2 * duration_s))
    commands += p.blend(t, 0, 0.3)[:, None] * 0.5 * (1 - np.cos(phase)) * travel
    aside = None
    if hand.rails.away is not None:
        p.shift(commands, hand.rails.away, AWAY_M)
        rails = hand.rails.columns
        waves = np.sin(2 * np.pi * rng.uniform(0.4, 1.5, len(rails)) * t[:, None])
        commands[:, rails] += p.blend(t, 0, 0.3)[:, None] * rng.uniform(0.005, 0.02) * waves
    elif scene.object_id is not None:
        aside = np.array([2 * AWAY_M, 0, 0])
    return p.finish(scene, commands, rng, shift=aside)


POLICY = Policy("sweep all joints free of the object", p.has_hand, _plan)
