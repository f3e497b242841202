"""Driven joints of a random small scene: position servos drawn to be stable."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from candata.gap.blind.rigs.text import chance, tag, uniform

Role = Literal["free", "push", "grip", "lift", "press", "carry"]
GRAVITY_M_S2 = 9.81
#: Natural frequency [rad/s] and damping ratio of a servo with its joint, and of a slide that carries weight. Chosen:
#: small hobby servos to stiff drives, all stable at 5 ms steps.
SERVO_RADPS, SERVO_RATIO, LIFT_RADPS = (12.0, 36.0), (0.35, 1.2), (28.0, 45.0)


class Ends(NamedTuple):
    """Where a joint is at rest, farthest away, and farthest toward what its finger works on [rad or m]."""

    rest: float
    away: float
    toward: float


class Servo(NamedTuple):
    """A driven joint: its commands at rest, farthest away, and farthest toward what the finger works on."""

    joint: str
    slides: bool
    role: Role
    rest: float
    away: float
    toward: float
    kp: float
    kv: float
    limit: float | None


class Drive(NamedTuple):
    """What an actuator takes: its name, its servo, and whether its command is a velocity that it integrates."""

    name: str
    servo: Servo
    integrates: bool


class Driven(NamedTuple):
    """A joint drawn with its servo: XML of the joint, and the servo."""

    xml: str
    servo: Servo


def driven(
    rng: np.random.Generator,
    name: str,
    role: Role,
    axis: tuple[float, float, float],
    inertia: float,
    load: float,
    ends: Ends,
    *,
    slides: bool = False,
    lifts: bool = False,
    force: float = 0.0,
) -> Driven:
    """Return a joint and its servo; `force` [N or N m] is what it presses with at `toward`, which grows by it.

    `inertia` is what the joint moves without its armature, `load` the weight [N or N m] that it holds.
    """
    armature = uniform(rng, 0.3, 4.0) * inertia if not slides else uniform(rng, 0.0, 0.5) * inertia
    total, omega = inertia + armature, uniform(rng, *(LIFT_RADPS if lifts else SERVO_RADPS))
    kp = max(total * omega**2, load / (0.03 if slides else 0.25))
    whole = 2 * uniform(rng, *SERVO_RATIO) * np.sqrt(kp * total)
    passive = uniform(rng, 0.05, 0.5) * whole
    press = min(force / kp, 0.03 if slides else 0.5)
    reach = 0.3 * kp * (0.05 if slides else 1.0)
    sign = 1.0 if lifts or chance(rng, 0.5) else -1.0
    start, far, near = (sign * v for v in (ends.rest, ends.away, ends.toward + press))
    wide = (uniform(rng, 0.01, 0.05) if slides else uniform(rng, 0.3, 0.8)) + abs(press)
    limited = chance(rng, 0.6)
    joint = tag(
        "joint",
        name=name,
        type="slide" if slides else "hinge",
        axis=[sign * v for v in axis],
        damping=passive,
        armature=armature,
        range=(min(start, far, near) - wide, max(start, far, near) + wide) if limited else None,
        frictionloss=uniform(rng, 0.02, 0.1) * reach if chance(rng, 0.2) else None,
    )
    limit = max(uniform(rng, 0.6, 2.0) * reach, 1.5 * load, 1.5 * force) if chance(rng, 0.25) else None
    return Driven(joint, Servo(name, slides, role, start, far, near, kp, float(whole - passive), limit))
