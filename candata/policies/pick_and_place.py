"""Grasp the object, carry it 10 to 25 cm along its support, put it down or let it drop, and draw back."""

from __future__ import annotations

import numpy as np

from candata.policies import _grasps as g
from candata.policies import _postures as p
from candata.policies._carrier import carrier, reachable_way
from candata.policies._contract import Array, Goal, Plan, Policy
from candata.scenes import Scene

#: Length for which the times below are written [s]; others stretch them.
USUAL_S = 8.0
#: How far the object is carried, and how high [m].
CARRY_M, HEIGHT_M = (0.10, 0.25), (0.07, 0.12)
#: Share of the episodes in which it is let drop from where it was carried.
DROP_SHARE = 0.2
#: Least height, and for how long at most, that counts as lifted [m, s].
LIFT_M, HELD_S = 0.05, 1.0


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; the grasp, where to, the height, the grip and whether it is let drop are random."""
    grasp, t = g.chosen_grasp(scene, rng), p.times(scene, duration_s)
    unit = duration_s / USUAL_S
    is_dropped, height_m, grip = rng.random() < DROP_SHARE, rng.uniform(*HEIGHT_M), rng.uniform(0.95, 1.1)
    displacement = _displacement(scene, rng, grasp, height_m)
    way_in = p.blend(t, 0.2 * unit, 1.0 * unit) - p.blend(t, 6.9 * unit, 0.8 * unit)
    lift = p.blend(t, 2.2 * unit, 0.9 * unit)
    carry = p.blend(t, 2.8 * unit, 1.9 * unit)
    if is_dropped:
        release_s = 5.0 * unit
    else:
        release_s = 6.3 * unit
        lift -= p.blend(t, 4.8 * unit, 1.3 * unit)
    closing = grip * (p.blend(t, 1.3 * unit, 0.8 * unit) - p.blend(t, release_s, 0.4 * unit))
    path = grasp.way_in(way_in) + p.along(carrier(scene).lift, height_m * lift)
    path[:, :3] += carry[:, None] * displacement
    plan = p.finish(scene, grasp.commands(closing), rng, path=path)
    goal = Goal(lift_m=LIFT_M, held_s=min(HELD_S, 0.2 * duration_s), place_m=None if is_dropped else displacement)
    return g.with_heading(scene, plan, grasp.heading_rad, goal)


def _displacement(scene: Scene, rng: np.random.Generator, grasp: g.Grasp, height_m: float) -> Array:
    """Return where to carry the object `(3,)` [m]: the first draw that the hand can follow, lifted, and drawn back."""
    hand = carrier(scene)
    corners = np.concatenate([grasp.way_in(np.array([1.0, 1.0, 0.0]))])
    corners[0] += p.along(hand.lift, np.array([height_m]))[0]
    direction = lambda: rng.standard_normal(len(hand.level)) @ hand.level  # noqa: E731
    return reachable_way(scene, rng, corners, direction, CARRY_M, "carry")


POLICY = Policy("grasp, carry along the support, put down or drop", g.can_carry, _plan, on_request=True)
