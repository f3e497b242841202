"""Sweep all joints through the air, slowly and fast, then jump: away from the object."""

from __future__ import annotations

import numpy as np

from candata.policies import _postures as p
from candata.policies._contract import Array, Plan, Planner, Policy, Variant
from candata.policies._drive import servos
from candata.scenes import Scene

#: How far the hand backs off, or half of how far the object is put away, to keep the sweep free [m].
AWAY_M = 0.14
#: Share of an episode that is swept, the rest being a jump out and back; its stroke over the way to the far end of the
#: range; how long the sweep takes to end [s]. Record 43.
SWEEP_SHARE, STROKE, END_S = 0.7, 0.8, 0.25
#: When joints jump out, at random within the first share of what is left, and how much later each comes back. Chosen.
JUMP_WITHIN_SHARE, RETURN_AFTER_SHARE = 0.3, 0.45


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan: sines whose rate rises from slow reversals (friction) to fast ones (delay, inertia), then jumps.

    A motor that must jump is at its limit until the joint arrives: only there do a servo's own terms differ from the
    joint's, and which motor is weak shows.
    """
    hand, t = p.postures(scene), p.times(scene, duration_s)
    commands = np.repeat(hand.open[None], len(t), axis=0)
    travel, sweep_end_s = 0.9 * hand.sweep, SWEEP_SHARE * duration_s
    slow_hz, fast_hz = rng.uniform(0.3, 0.6, len(travel)), rng.uniform(1.5, 3.0, len(travel))
    phase = 2 * np.pi * (slow_hz * t[:, None] + (fast_hz - slow_hz) * t[:, None] ** 2 / (2 * sweep_end_s))
    sweep_envelope = p.blend(t, 0, 0.3) - p.blend(t, sweep_end_s - END_S, END_S)
    commands += sweep_envelope[:, None] * 0.5 * (1 - np.cos(phase)) * travel
    # Each joint at its own time: of commands that are all alike, which joint follows which could not be told.
    out = sweep_end_s + (duration_s - sweep_end_s) * (
        rng.uniform(0.0, JUMP_WITHIN_SHARE, len(travel)) + np.array([[0.0], [RETURN_AFTER_SHARE]])
    )
    # A motor without a servo has nothing that would stop it at the far end, nor damping to be told from its joint's.
    stroke = np.where(servos(scene) & (hand.sweep != 0), STROKE * p.way_to_far_end(scene, hand.open), 0.0)
    commands += ((t[:, None] >= out[0]) & (t[:, None] < out[1])) * stroke
    path, object_shift = _clear_of_object(scene, hand, len(t))
    axes = hand.carrier.axes
    if len(axes):
        waves = np.sin(2 * np.pi * rng.uniform(0.4, 1.5, len(axes)) * t[:, None])
        path[:, :3] += (p.blend(t, 0, 0.3)[:, None] * rng.uniform(0.005, 0.02) * waves) @ axes
    return p.finish(scene, commands, rng, path=path, shift=object_shift)


def _clear_of_object(scene: Scene, hand: p.Postures, count: int) -> tuple[Array, Array | None]:
    """Return the path `(count, 6)` of a hand that has backed off; if it cannot, how far the object is put away [m]."""
    away = hand.carrier.away
    is_moved = away is None and scene.object_id is not None
    return p.along(away, np.full(count, AWAY_M)), np.array([2 * AWAY_M, 0, 0]) if is_moved else None


def _reversals(share: float, low_hz: float, high_hz: float, sharpness: float = 0.0) -> Planner:
    """Return a planner of reversals about the middle of each joint's travel.

    Parameters
    ----------
    share : float
        Stroke over the travel from open to closed.
    low_hz, high_hz : float
        Rates at the start and at the end; the rate grows by equal factors.
    sharpness : float
        Above 0 the wave has flat tops: steps between two places.
    """

    def plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
        hand, t = p.postures(scene), p.times(scene, duration_s)
        growth = np.log(high_hz / low_hz)
        turns = low_hz * duration_s * np.expm1(growth * t / duration_s) / growth if growth else low_hz * t
        # Joints half a turn apart or less: their torques on each other do not repeat from stroke to stroke.
        wave = np.sin(2 * np.pi * turns[:, None] + rng.uniform(0, np.pi, len(hand.open)))
        wave = np.tanh(sharpness * wave) / np.tanh(sharpness) if sharpness else wave
        travel = hand.closed - hand.open
        commands = hand.open + 0.5 * travel + 0.5 * share * p.blend(t, 0, 0.3)[:, None] * wave * travel
        path, object_shift = _clear_of_object(scene, hand, len(t))
        return p.finish(scene, commands, rng, path=path, shift=object_shift, dither=False)

    return plan


def _jumps(share: float, rate_hz: float | None) -> Planner:
    """Return a planner of jumps from the open hand towards the far end of each joint's range and back.

    Parameters
    ----------
    share : float
        Stroke over the way to the far end.
    rate_hz : float, optional
        Jumps out and back each second of all joints at once; None lets one joint jump after the other, each once, so
        that fingers stay out of each other's way.
    """

    def plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
        hand, t = p.postures(scene), p.times(scene, duration_s)
        stroke = share * p.way_to_far_end(scene, hand.open)
        moving_columns = np.flatnonzero(stroke)
        out = np.zeros((len(t), len(stroke)))
        if rate_hz is None:
            turn = t / duration_s * len(moving_columns)
            for k, joint in enumerate(rng.permutation(moving_columns)):
                out[:, joint] = (turn >= k) & (turn < k + 0.5)
        else:
            out[:, moving_columns] = ((rate_hz * t) % 1 >= 0.5)[:, None]
        commands = hand.open + out * stroke
        path, object_shift = _clear_of_object(scene, hand, len(t))
        return p.finish(scene, commands, rng, path=path, shift=object_shift, dither=False)

    return plan


#: Small slow reversals show backlash and dry friction, several speeds tell friction from damping, fast ones show
#: delays, and strokes that the motors cannot follow tell a servo's damping from the joint's.
VARIANTS = (
    Variant("small reversals in the air, slow to fast", _reversals(0.06, 0.4, 4.0)),
    Variant("slow reversals in the air", _reversals(0.5, 0.3, 0.5)),
    Variant("reversals in the air at rising speed", _reversals(0.5, 0.25, 3.0)),
    Variant("fast reversals in the air", _reversals(0.9, 2.5, 4.0)),
    Variant("large steps in the air", _reversals(0.9, 1.0, 1.6, sharpness=6.0)),
    Variant("jumps of all joints in the air", _jumps(0.8, 1.5)),
    Variant("jumps of one joint after the other in the air", _jumps(0.8, None)),
)
POLICY = Policy("sweep all joints free of the object", p.has_hand, _plan, VARIANTS)
