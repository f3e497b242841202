"""Hold the object where it stands and squeeze it harder and softer."""

from __future__ import annotations

import numpy as np

from candata.policies import _postures as p
from candata.policies._contract import Plan, Planner, Policy, Variant
from candata.scenes import Scene


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; squeezing rate and depth are random, and the object is dragged a little."""
    hand, t = p.postures(scene), p.times(scene, duration_s)
    unit = duration_s / 3.2
    grip_profile = p.blend(t, 0.1 * unit, rng.uniform(0.4, 0.7) * unit) - p.blend(t, 2.7 * unit, 0.35 * unit)
    depth, rate = rng.uniform(0.1, 0.25), rng.uniform(0.7, 1.6)
    wave = 1 + depth * np.sin(2 * np.pi * rate * (t - 0.8 * unit)) * p.blend(t, 0.8 * unit, 0.2 * unit)
    commands = hand.open + (grip_profile * wave)[:, None] * (hand.closed - hand.open)
    axes = hand.carrier.axes
    pull = p.blend(t, 1.2 * unit, 0.6 * unit) - p.blend(t, 2.1 * unit, 0.5 * unit)
    path = p.along(rng.uniform(-0.012, 0.012, len(axes)) @ axes, pull)
    return p.finish(scene, commands, rng, path=path)


def _levels(*grips: float) -> Planner:
    """Return a planner that holds the object at one grip after the other; 1 is the grasping posture."""

    def plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
        hand, t = p.postures(scene), p.times(scene, duration_s)
        level_s = duration_s / (len(grips) + 1)
        steps = np.diff([0.0, *grips, 0.0])
        grip_profile = sum(step * p.blend(t, (k + 0.1) * level_s, 0.5 * level_s) for k, step in enumerate(steps))
        commands = hand.open + np.asarray(grip_profile)[:, None] * (hand.closed - hand.open)
        return p.finish(scene, commands, rng, dither=False)

    return plan


#: Light holds show dead bands and biases, firm ones gains and limits, both together tell them apart.
VARIANTS = (
    Variant("hold lightly, then firmly", _levels(0.8, 0.9, 1.0, 1.2)),
    Variant("hold lightly", _levels(0.8, 0.85, 0.9)),
)
POLICY = Policy("hold and squeeze harder and softer", p.has_hand_and_object, _plan, VARIANTS)
