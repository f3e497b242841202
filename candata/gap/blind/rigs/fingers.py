"""Fingers of a random small scene, as MJCF text: chains of links with position servos."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from candata.gap.blind.rigs.links import Links, Place, Shape, drawn_shape, placed_body
from candata.gap.blind.rigs.servos import GRAVITY_M_S2, Ends, Role, Servo, driven
from candata.gap.blind.rigs.text import chance, tag, uniform

Chain = Literal["hinge", "two_hinges", "slide", "slide_hinge", "plunger", "sweeper"]
CHAINS: tuple[Chain, ...] = ("hinge", "two_hinges", "slide", "slide_hinge")
#: Natural frequency [rad/s] and damping ratio of a compliant part. Chosen: visible sag and ringing, and stable.
SPRING_RADPS, SPRING_RATIO = (22.0, 55.0), (0.08, 0.5)
#: Axis of a hinge that swings a hanging link ahead.
SWING = (0.0, -1.0, 0.0)


class Finger(NamedTuple):
    """A finger's bodies in the world's frame, its servos, its fingertip geom, and joints that follow others.

    `follows` holds (follower, leader, ratio); `mass` is the finger's, in kg.
    """

    xml: str
    servos: tuple[Servo, ...]
    tip: str
    tip_body: str
    follows: tuple[tuple[str, str, float], ...] = ()
    mass: float = 0.1


def finger(
    rng: np.random.Generator,
    name: str,
    chain: Chain,
    place: Place,
    role: Role,
    force_N: float,
    *,
    follows: bool = False,
    spring: bool = False,
    collide_links: bool = False,
    tip_friction: float = 1.0,
    tip_solref: tuple[float, float] | None = None,
) -> Finger:
    """Return a finger that meets a surface on its way toward a place.

    Parameters
    ----------
    rng : numpy.random.Generator
    name : str
        Prefix of all its names.
    chain : str
        Kind of chain: hanging hinges, jaws on slides, a slide with a hinge; a `plunger` goes straight down onto the
        table, a `sweeper` swings down onto it.
    place : Place
        Where it works.
    role : str
        What its commands do.
    force_N : float
        What it presses with at the far end of its commands, where something is in its way.
    follows, spring : bool
        Whether its last hinge is held by an equality to the one before, and whether a passive hinge bends in it.
    collide_links : bool
        Whether the links collide as the fingertip does.
    tip_friction, tip_solref
        Of the fingertip's geom.
    """
    radius = uniform(rng, 0.007, 0.012)
    links = Links(name, radius, collide_links, tip_friction, tip_solref, spring)
    makers = {"slide": _jaw, "plunger": _plunger, "slide_hinge": _railed}
    if chain in makers:
        return makers[chain](rng, links, place, role, force_N)
    return _hanging(
        rng, links, place, role, force_N, two=chain == "two_hinges", follows=follows, sweeps=chain == "sweeper"
    )


def _hanging(
    rng: np.random.Generator,
    links: Links,
    place: Place,
    role: Role,
    force_N: float,
    *,
    two: bool,
    follows: bool,
    sweeps: bool,
) -> Finger:
    """Return a chain of one or two hinges that hangs down; it swings toward +x of its frame."""
    name, shape = links.name, drawn_shape(rng, two, follows, sweeps)
    wander = uniform(rng, 0.2, 0.5) if role == "free" else 0.0
    ends = Ends(shape.rest, shape.rest - uniform(rng, 0.0, 0.3), shape.touch + wander)
    base = driven(rng, f"{name}_a", role, SWING, shape.inertia, shape.load, ends, force=force_N * sum(shape.lengths))
    servos: tuple[Servo, ...] = (base.servo,)
    ties: tuple[tuple[str, str, float], ...] = ()
    rooted = links.spring and chance(rng, 0.5)
    flexes = links.spring and not rooted
    end, tip_mass = shape.lengths[-1], shape.tip_mass
    inner = _bent(rng, links, end, tip_mass) if flexes else links.pad(rng, end, tip_mass)
    if two:
        second, more, ties = _second(rng, name, shape, base.servo, role, force_N, follows)
        inner = second + links.link(shape.far, shape.masses[1]) + inner
        inner = tag("body", inner, name=f"{name}_end", pos=(0.0, 0.0, -shape.lengths[0]))
        servos += more
    xml = base.xml + links.link(shape.lengths[0], shape.masses[0], 0.007) + inner
    ahead, down = shape.reached
    height = down + (links.radius if sweeps else place.z)
    at = -place.surface - (0.0 if sweeps else links.radius) - ahead
    tip_body = f"{name}_pad" if flexes else (f"{name}_end" if two else name)
    if rooted:
        stem = _root(rng, name, shape.inertia, shape.load) + tag("body", xml, name=name)
        whole = placed_body(f"{name}_root", place, at, height, stem)
    else:
        whole = placed_body(name, place, at, height, xml)
    return Finger(whole, servos, f"{name}_tip", tip_body, ties, shape.mass)


def _second(
    rng: np.random.Generator, name: str, shape: Shape, first: Servo, role: Role, force_N: float, follows: bool
) -> tuple[str, tuple[Servo, ...], tuple[tuple[str, str, float], ...]]:
    """Return the second hinge, its servo, or what ties it to the first one."""
    small = 0.2 * shape.inertia
    if follows:
        sign = 1.0 if first.toward >= first.away else -1.0
        axis = (0.0, -sign, 0.0)
        joint = tag("joint", name=f"{name}_b", axis=axis, damping=uniform(rng, 1, 6) * small, armature=small)
        return joint, (), ((f"{name}_b", f"{name}_a", shape.ratio),)
    moves = uniform(rng, 0.05, 0.3)
    ends = Ends(shape.bend, shape.bend - moves, shape.bend + moves)
    force = force_N * shape.far
    middle = driven(rng, f"{name}_b", role, SWING, small, 0.3 * shape.load, ends, force=force)
    return middle.xml, (middle.servo,), ()


def _bent(rng: np.random.Generator, links: Links, down: float, tip_mass: float) -> str:
    """Return a fingertip on a springy hinge at the end of a link."""
    length = uniform(rng, 0.008, 0.02)
    own = tip_mass * (length**2 + links.radius**2)
    armature = uniform(rng, 2, 8) * own
    omega = uniform(rng, *SPRING_RADPS)
    stiffness = max((own + armature) * omega**2, 4 * tip_mass * GRAVITY_M_S2 * length)
    axis = (0.0, 1.0, 0.0) if chance(rng, 0.7) else (1.0, 0.0, 0.0)
    joint = tag(
        "joint",
        name=f"{links.name}_flex",
        axis=axis,
        stiffness=stiffness,
        armature=armature,
        damping=2 * uniform(rng, *SPRING_RATIO) * np.sqrt(stiffness * (own + armature)),
    )
    inner = joint + links.pad(rng, length, tip_mass)
    return tag("body", inner, name=f"{links.name}_pad", pos=(0.0, 0.0, -down + length))


def _root(rng: np.random.Generator, name: str, inertia: float, load: float) -> str:
    """Return a springy hinge, with a block, at the root of a finger."""
    omega = uniform(rng, *SPRING_RADPS)
    stiffness = max(2 * inertia * omega**2, load / 0.15)
    axis = (0.0, 1.0, 0.0) if chance(rng, 0.6) else (1.0, 0.0, 0.0)
    joint = tag(
        "joint",
        name=f"{name}_flex",
        axis=axis,
        stiffness=stiffness,
        armature=inertia,
        damping=2 * uniform(rng, *SPRING_RATIO) * np.sqrt(2 * stiffness * inertia),
    )
    block = tag("geom", type="box", size=(0.01, 0.01, 0.01), mass=0.02, contype=0, conaffinity=0)
    return joint + block


def _jaw(rng: np.random.Generator, links: Links, place: Place, role: Role, force_N: float) -> Finger:
    """Return a jaw on a horizontal slide."""
    name, mass, gap = links.name, uniform(rng, 0.05, 0.25), uniform(rng, 0.01, 0.035)
    moves = uniform(rng, 0.01, 0.03) if role == "free" else 0.0
    slide = driven(
        rng,
        f"{name}_s",
        role,
        (1.0, 0.0, 0.0),
        mass,
        0.0,
        Ends(0.0, -uniform(rng, 0.0, 0.02), gap + moves),
        slides=True,
        force=force_N,
    )
    bar = tag("geom", type="box", size=(0.01, 0.008, 0.02), pos=(-0.02, 0.0, 0.03), mass=mass, contype=0, conaffinity=0)
    tip = _bent(rng, links, 0.0, 0.012) if links.spring else links.pad(rng, 0.0, 0.01)
    at = -place.surface - links.radius - gap
    body = f"{name}_pad" if links.spring else name
    return Finger(
        placed_body(name, place, at, place.z, slide.xml + bar + tip),
        (slide.servo,),
        f"{name}_tip",
        body,
        mass=mass + 0.01,
    )


def _plunger(rng: np.random.Generator, links: Links, place: Place, role: Role, force_N: float) -> Finger:
    """Return a finger on a vertical slide above the table; its weight lets it sag below its command."""
    name, mass, gap = links.name, uniform(rng, 0.05, 0.2), uniform(rng, 0.01, 0.03)
    slide = driven(
        rng,
        f"{name}_z",
        role,
        (0.0, 0.0, -1.0),
        mass,
        0.0,
        Ends(0.0, -uniform(rng, 0.0, 0.02), gap),
        slides=True,
        lifts=True,
        force=force_N,
    )
    sag = (mass + 0.01) * GRAVITY_M_S2 / slide.servo.kp
    rod = tag(
        "geom", type="capsule", fromto=(0.0, 0.0, 0.0, 0.0, 0.0, 0.06), size=0.006, mass=mass, contype=0, conaffinity=0
    )
    xml = slide.xml + rod + links.pad(rng, 0.0, 0.01)
    return Finger(
        placed_body(name, place, 0.0, links.radius + gap + sag, xml),
        (slide.servo,),
        f"{name}_tip",
        name,
        mass=mass + 0.01,
    )


def _railed(rng: np.random.Generator, links: Links, place: Place, role: Role, force_N: float) -> Finger:
    """Return a hanging hinge on a slide that goes toward the place, or up and down."""
    name = links.name
    gap = uniform(rng, 0.005, 0.02)
    hanging = _hanging(
        rng,
        links._replace(name=f"{name}_f"),
        place._replace(surface=place.surface + gap),
        role,
        force_N,
        two=False,
        follows=False,
        sweeps=False,
    )
    mass = uniform(rng, 0.1, 0.3)
    ahead = (float(np.cos(place.azimuth)), float(np.sin(place.azimuth)), 0.0)
    upright = chance(rng, 0.3)
    axis, ends = ((0.0, 0.0, 1.0), Ends(0.0, 0.02, 0.0)) if upright else (ahead, Ends(0.0, -0.015, gap))
    slide = driven(rng, f"{name}_s", role, axis, mass + hanging.mass, 0.0, ends, slides=True, lifts=upright)
    carriage = tag(
        "geom", type="box", size=(0.02, 0.02, 0.01), pos=(place.x, place.y, 0.25), mass=mass, contype=0, conaffinity=0
    )
    xml = tag("body", slide.xml + carriage + hanging.xml, name=name)
    return Finger(xml, (slide.servo, *hanging.servos), hanging.tip, hanging.tip_body, mass=mass + hanging.mass)
