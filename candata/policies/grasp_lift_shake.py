"""Grasp the object, lift it, shake it, put it down, let go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candata.policies import _grasps as g
from candata.policies import _postures as p
from candata.policies._contract import Goal, Plan, Planner, Policy, Variant
from candata.scenes import Scene

#: Share of the wrist's lift that the object must make, for a share of the episode: a grasp may give a little. Chosen.
LIFTED_SHARE, HELD_SHARE = 0.5, 0.2


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; grip, height, shaking direction, amplitude and frequency are random.

    The postures of the scene are those of its own object: another one is held by a sampled grasp.
    """
    hand, t = p.postures(scene), p.times(scene, duration_s)
    unit = duration_s / 3.2
    grasp = g.chosen_grasp(scene, rng) if scene.has_other_object and g.can_carry(scene) else None
    grip = rng.uniform(0.95, 1.12)
    if grasp is None:
        grip_profile = p.blend(t, 0.1 * unit, rng.uniform(0.5, 0.8) * unit) - p.blend(t, 2.75 * unit, 0.3 * unit)
        commands = hand.open + grip * grip_profile[:, None] * (hand.closed - hand.open)
        path = np.zeros((len(t), 6))
    else:
        grip_profile = p.blend(t, 0.4 * unit, 0.5 * unit) - p.blend(t, 2.7 * unit, 0.2 * unit)
        commands = grasp.commands(grip * grip_profile)
        path = grasp.way_in(p.blend(t, 0.0, 0.4 * unit) - p.blend(t, 2.9 * unit, 0.3 * unit))
    axes = hand.carrier.axes
    if not len(axes):
        return p.finish(scene, commands, rng)
    lift = p.blend(t, 1.0 * unit, 0.5 * unit) - p.blend(t, 2.35 * unit, 0.35 * unit)
    shake_envelope = p.blend(t, 1.5 * unit, 0.15 * unit) - p.blend(t, 2.2 * unit, 0.15 * unit)
    amplitude = rng.uniform(0.006, 0.016, len(axes)) * rng.choice([-1, 1], len(axes))
    wave = np.sin(2 * np.pi * rng.uniform(1.5, 3.0) * (t - 1.5 * unit))
    height = rng.uniform(0.04, 0.07)
    path += p.along(amplitude @ axes, shake_envelope * wave) + p.along(hand.carrier.lift, height * lift)
    plan = p.finish(scene, commands, rng, path=path)
    if hand.carrier.lift is None:
        return plan
    goal = Goal(lift_m=LIFTED_SHARE * height, held_s=HELD_SHARE * duration_s)
    return replace(plan, goal=goal) if grasp is None else g.with_heading(scene, plan, grasp.heading_rad, goal)


def _carry(lift_m: float, side_m: float) -> Planner:
    """Return a planner that lifts by `lift_m`, carries to both sides by `side_m` each way, and puts down.

    If nothing carries the hand, the object is held where it stands.
    """

    def plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
        hand, t = p.postures(scene), p.times(scene, duration_s)
        unit = duration_s / 3.2
        grip_profile = p.blend(t, 0.1 * unit, 0.6 * unit) - p.blend(t, 2.85 * unit, 0.25 * unit)
        commands = hand.open + 1.05 * grip_profile[:, None] * (hand.closed - hand.open)
        lift = p.blend(t, 0.8 * unit, 0.4 * unit) - p.blend(t, 2.4 * unit, 0.4 * unit)
        way_out = p.blend(t, 1.2 * unit, 0.4 * unit) - p.blend(t, 1.6 * unit, 0.6 * unit)
        way_back = p.blend(t, 1.6 * unit, 0.6 * unit) - p.blend(t, 2.2 * unit, 0.3 * unit)
        path = p.along(hand.carrier.level.sum(0), side_m * (way_out - way_back))
        path += p.along(hand.carrier.lift, lift_m * lift)
        return p.finish(scene, commands, rng, path=path, dither=False)

    return plan


#: A carried object tells what grows with its place (lengths) from what does not (offsets), and what the support does
#: from what the sensors add.
VARIANTS = (
    Variant("lift and carry to both sides", _carry(0.06, 0.08)),
    Variant("lift high and put down", _carry(0.12, 0.0)),
)
POLICY = Policy("grasp, lift, shake, put down, release", p.has_hand_and_object, _plan, VARIANTS)
