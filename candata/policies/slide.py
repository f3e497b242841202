"""Press the object on its support, pull it along, and loosen the grip until it slips."""

from __future__ import annotations

import numpy as np

from candata.policies import _grasps as g
from candata.policies import _postures as p
from candata.policies._carrier import carrier, reachable_way
from candata.policies._contract import Array, Goal, Plan, Policy
from candata.scenes import Scene

#: Length for which the times below are written [s]; others stretch them.
USUAL_S = 6.0
#: How far the object is pulled, and how much lower than its grasp the hand is held meanwhile [m]. Chosen.
PULL_M, PRESS_M = (0.10, 0.16), (0.002, 0.006)
#: Grip while the pull begins, and by how much it is looser at its end. Chosen: it slips on the way.
GRIP, LOOSER = (0.85, 1.0), (0.5, 0.8)


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; the grasp, where to, how firm and how much looser in the end are random."""
    grasp, t, hand = g.chosen_grasp(scene, rng), p.times(scene, duration_s), carrier(scene)
    unit = duration_s / USUAL_S
    way_in = p.blend(t, 0.2 * unit, 0.9 * unit) - p.blend(t, 4.9 * unit, 0.8 * unit)
    press = rng.uniform(*PRESS_M) * p.blend(t, 1.7 * unit, 0.3 * unit)
    closing = rng.uniform(*GRIP) * p.blend(t, 1.1 * unit, 0.6 * unit) - rng.uniform(*LOOSER) * p.blend(
        t, 2.4 * unit, 1.8 * unit
    )
    closing *= 1 - p.blend(t, 4.4 * unit, 0.4 * unit)
    pull = _pull(scene, rng, grasp)
    path = grasp.way_in(way_in) - p.along(hand.lift, press)
    path[:, :3] += p.blend(t, 2.0 * unit, 2.2 * unit)[:, None] * pull
    plan = p.finish(scene, grasp.commands(np.maximum(closing, 0.0)), rng, path=path)
    return g.with_heading(scene, plan, grasp.heading_rad, Goal(slip=True))


def _pull(scene: Scene, rng: np.random.Generator, grasp: g.Grasp) -> Array:
    """Return the pull `(3,)` [m]: the way the hand came, where that is along the support, else any that it can follow.

    The other way the palm would push the object, and nothing could slip.
    """
    hand, ends = carrier(scene), grasp.way_in(np.array([1.0, 0.0]))
    out = grasp.approach @ hand.level.T @ hand.level

    def direction() -> Array:
        random = rng.standard_normal(len(hand.level)) @ hand.level
        return out + 0.3 * random if np.linalg.norm(out) > 0.5 else random

    return reachable_way(scene, rng, ends, direction, PULL_M, "pull")


POLICY = Policy("press on the support, pull along until it slips", g.can_carry, _plan, on_request=True)
