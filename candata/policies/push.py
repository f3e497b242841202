"""Push the object over its support with half-closed fingers, and come back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candata.policies import _postures as p
from candata.policies._contract import Array, Goal, Plan, Policy, Variant
from candata.scenes import Scene

#: How far the hand stands back before the first stroke [m].
CLEAR_M = 0.035
#: How far the hand is lowered [m].
LOW_M = 0.03
#: Length of the long stroke, and how far the hand backs off for it [m].
FAR_M, BACK_M = 0.15, 0.05
#: Distance from the end of the stroke at which the object has arrived, as a share of the stroke: it stands up to 1 cm
#: off, and leaves the fingers to the side. Chosen.
ARRIVED_SHARE = 0.6


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; if nothing carries the hand, the fingers alone push by closing and opening twice."""
    hand, t = p.postures(scene), p.times(scene, duration_s)
    unit = duration_s / 3.2
    closing_share = rng.uniform(0.05, 0.2)
    commands = np.repeat((hand.open + closing_share * (hand.closed - hand.open))[None], len(t), axis=0)
    stroke = p.blend(t, 0.1 * unit, rng.uniform(1.1, 1.4) * unit) - p.blend(t, 1.6 * unit, 0.6 * unit)
    second_stroke = p.blend(t, 2.2 * unit, 0.6 * unit)
    if hand.carrier.stroke is None:
        commands += (0.6 * (stroke + second_stroke))[:, None] * (hand.closed - hand.open)
        return p.finish(scene, commands, rng)
    reach = rng.uniform(0.05, 0.08)
    # The stroke starts clear of the object, so that an episode holds the onset of contact.
    path = _beside(hand, rng.uniform(0.045, 0.06), len(t))
    way = (reach + CLEAR_M) * (stroke + rng.uniform(0.5, 0.9) * second_stroke) - CLEAR_M
    plan = p.finish(scene, commands, rng, path=path + p.along(hand.carrier.stroke, way))
    return replace(plan, goal=Goal(place_m=reach * hand.carrier.stroke, place_tolerance_m=ARRIVED_SHARE * reach))


def _beside(hand: p.Postures, back_off_m: float, count: int) -> Array:
    """Return the path `(count, 6)` of a hand that is held lower than the object's middle, and backs off by so much [m].

    Higher, the object would tip; backing off puts the fingertips, not the links behind them, beside it. A hand above
    the object stays there: it pushes with the fingers that straddle it.
    """
    if not hand.carrier.sideways:
        return np.zeros((count, 6))
    lower = p.along(hand.carrier.lift, np.full(count, -LOW_M))
    return lower + p.along(hand.carrier.away, np.full(count, back_off_m))


def _far_stroke(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan of one long even stroke and a slow way back; as `_plan` if nothing carries the hand."""
    hand, t = p.postures(scene), p.times(scene, duration_s)
    if hand.carrier.stroke is None:
        return _plan(scene, rng, duration_s)
    unit = duration_s / 3.2
    commands = np.repeat((hand.open + 0.1 * (hand.closed - hand.open))[None], len(t), axis=0)
    stroke = np.clip((t / unit - 0.2) / 2.0, 0, 1) - p.blend(t, 2.4 * unit, 0.7 * unit)
    path = _beside(hand, BACK_M, len(t)) + p.along(hand.carrier.stroke, (FAR_M + CLEAR_M) * stroke - CLEAR_M)
    return p.finish(scene, commands, rng, path=path, dither=False)


VARIANTS = (Variant("push the object far at an even speed", _far_stroke),)
POLICY = Policy("push the object over its support", p.has_hand_and_object, _plan, VARIANTS)
