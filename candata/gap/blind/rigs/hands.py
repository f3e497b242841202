"""The hand of a random small scene: fingers that work on the object or on each other, and free ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.gap.blind.rigs.fingers import CHAINS, Chain, Finger, finger
from candata.gap.blind.rigs.links import Place
from candata.gap.blind.rigs.servos import GRAVITY_M_S2, Role, Servo
from candata.gap.blind.rigs.situations import Situation, Thing
from candata.gap.blind.rigs.text import chance, tag, uniform


class Hand(NamedTuple):
    """Fingers with the bodies of all of them, and their servos, those of a wrist last."""

    fingers: tuple[Finger, ...]
    xml: str
    servos: tuple[Servo, ...]


def draw_hand(rng: np.random.Generator, trait: str, situation: Situation, thing: Thing | None) -> Hand:
    """Return the hand: fingers that work on the object or on each other first, then free ones."""
    fingers = _workers(rng, trait, situation, thing)
    if trait == "mimic" and len(fingers) == 2 and all(s.slides for f in fingers for s in f.servos):
        fingers[1] = _tied(fingers[1], fingers[0])
    xml = "".join(f.xml for f in fingers)
    wrist: tuple[Servo, ...] = ()
    if situation == "lifted" and thing is not None:
        xml, wrist = _wrist(rng, xml, sum(f.mass for f in fingers) + thing.mass)
    most = 4 - len(fingers)
    least = 0 if fingers else 1
    extra = int(rng.choice(np.arange(least, most + 1), p=_falling(most + 1 - least)))
    start = uniform(rng, 0, 2 * np.pi)
    for i in range(extra):
        k = len(fingers)
        marks = trait in ("mimic", "spring") and k == 0
        added = _free(rng, trait, thing, start + 2 * np.pi * i / max(extra, 1), k, marks, bool(fingers))
        fingers.append(added)
        xml += added.xml
    return Hand(tuple(fingers), xml, tuple(s for f in fingers for s in f.servos) + wrist)


def _tied(jaw: Finger, leader: Finger) -> Finger:
    """Return a jaw that an equality moves with another one, against it."""
    mine, other = jaw.servos[0], leader.servos[0]
    ratio = 1.0 if mine.toward * other.toward > 0 else -1.0
    return jaw._replace(servos=(), follows=((mine.joint, other.joint, ratio),))


def _wrist(rng: np.random.Generator, xml: str, load: float) -> tuple[str, tuple[Servo, ...]]:
    """Return fingers on a vertical slide that lifts them, and its servo."""
    mass, omega, travel = uniform(rng, 0.15, 0.4), uniform(rng, 28.0, 45.0), uniform(rng, 0.015, 0.05)
    total = mass + load
    kp, whole = total * omega**2, 2 * uniform(rng, 0.5, 1.2) * total * omega
    sag = total * GRAVITY_M_S2 / kp
    joint = tag("joint", name="wrist", type="slide", axis=(0.0, 0.0, 1.0), damping=0.3 * whole)
    palm = tag("geom", type="box", size=(0.05, 0.03, 0.01), pos=(0.0, 0.0, 0.25), mass=mass, contype=0, conaffinity=0)
    servo = Servo("wrist", True, "lift", sag, sag, sag + travel, kp, 0.7 * whole, None)
    return tag("body", joint + palm + xml, name="palm"), (servo,)


def _falling(count: int) -> np.ndarray:
    """Return odds of few to many, each 0.6 times as likely as the one before."""
    odds = 0.6 ** np.arange(count)
    return odds / odds.sum()


def _free(
    rng: np.random.Generator, trait: str, thing: Thing | None, angle: float, k: int, marks: bool, crowded: bool
) -> Finger:
    """Return a finger that moves beside or above the object and does not reach it."""
    chain: Chain = "two_hinges" if trait == "mimic" and marks else CHAINS[int(rng.choice(len(CHAINS)))]
    if trait == "spring" and marks and chain == "slide_hinge":
        chain = "hinge"
    above = not crowded and chance(rng, 0.4)
    size = max(thing.half) + thing.middle if thing else 0.0
    far = uniform(rng, 0.0, 0.03) if above or thing is None else size + uniform(rng, 0.12, 0.2)
    height = (2 * thing.middle if thing else 0.0) + uniform(rng, 0.04, 0.08) if above else uniform(rng, 0.03, 0.1)
    place = Place(far * np.cos(angle), far * np.sin(angle), height, uniform(rng, 0, 2 * np.pi), 0.0)
    return finger(
        rng, f"f{k}", chain, place, "free", 0.0, follows=trait == "mimic" and marks, spring=trait == "spring" and marks
    )


class _Work(NamedTuple):
    """What a finger that touches something is to be: its chain, where it works, what for, and how hard it presses."""

    chain: Chain
    place: Place
    role: Role
    force_N: float


class _Pads(NamedTuple):
    """What the fingertips of a hand share: friction, and solref where it is not MuJoCo's own."""

    friction: float
    solref: tuple[float, float] | None


def _workers(rng: np.random.Generator, trait: str, situation: Situation, thing: Thing | None) -> list[Finger]:
    """Return the fingers that touch something."""
    pads = _Pads(uniform(rng, 0.3, 1.2), (uniform(rng, 0.01, 0.03), 1.0) if chance(rng, 0.3) else None)
    if situation in ("meeting", "pressing"):
        works = _apart(rng, trait, situation, thing)
    elif thing is None or situation in ("rest", "none"):
        works = []
    elif situation == "carried":
        return [_tray(rng, thing)]
    else:
        works = _on_object(rng, trait, situation, thing, pads)
    return [_worker(rng, trait, pads, work, k) for k, work in enumerate(works)]


def _apart(rng: np.random.Generator, trait: str, situation: Situation, thing: Thing | None) -> list[_Work]:
    """Return the work of fingers that press each other above the object, or the table beside it."""
    if situation == "meeting":
        height, angle = uniform(rng, 0.1, 0.14), uniform(rng, 0, np.pi)
        places = [Place(0.0, 0.0, height, angle + k * np.pi, 0.0) for k in range(2)]
        return [_Work(_pick(rng, trait, CHAINS), place, "push", uniform(rng, 0.3, 2.0)) for place in places]
    far = 0.1 if thing else 0.0
    count = int(rng.integers(1, 3))
    places = [Place(far, 0.08 * k, 0.0, uniform(rng, -0.5, 0.5), 0.0) for k in range(count)]
    down: tuple[Chain, ...] = ("plunger", "sweeper")
    return [_Work(_pick(rng, trait, down), place, "press", uniform(rng, 0.3, 2.5)) for place in places]


def _on_object(rng: np.random.Generator, trait: str, situation: Situation, thing: Thing, pads: _Pads) -> list[_Work]:
    """Return the work of fingers that push the object, or hold it between two of them."""
    height = thing.middle * uniform(rng, 0.85, 1.15)
    angle = uniform(rng, 0, 2 * np.pi) if thing.kind in ("ball", "can") else float(rng.choice([0.0, np.pi / 2]))
    if thing.kind == "roller":
        angle = 0.0
    places = [Place(0.0, 0.0, height, angle + k * np.pi, thing.reach(angle)) for k in range(2)]
    weight = thing.mass * GRAVITY_M_S2
    if situation in ("pushed", "rolling"):
        some = places[: int(rng.integers(1, 3))]
        force = max(weight, 0.5)
        return [_Work(_pick(rng, trait, CHAINS), place, "push", uniform(rng, 0.3, 1.5) * force) for place in some]
    # Two fingers hold by friction, of which MuJoCo takes the larger of a pair: each presses with a few times what the
    # object's weight asks of it.
    grip = max(uniform(rng, 1.5, 3.5) * weight / (2 * max(thing.friction, pads.friction)), 0.3)
    strong: tuple[Chain, ...] = ("slide", "hinge") if situation in ("lifted", "held") else CHAINS
    chain = _pick(rng, trait, strong)
    return [_Work(chain, place, "grip", grip) for place in places]


def _pick(rng: np.random.Generator, trait: str, chains: tuple[Chain, ...]) -> Chain:
    """Return one of the chains; two hinges for a joint that follows another."""
    if trait == "mimic" and "two_hinges" in chains:
        return "two_hinges"
    return chains[int(rng.choice(len(chains)))]


#: What takes the place of chains that cannot bear a trait.
_BEARS: dict[str, dict[Chain, Chain]] = {
    "mimic": {"hinge": "two_hinges", "slide_hinge": "two_hinges"},
    "spring": {"slide_hinge": "hinge", "plunger": "sweeper"},
}


def _worker(rng: np.random.Generator, trait: str, pads: _Pads, work: _Work, k: int) -> Finger:
    """Return a finger that touches something; the first bears the hand's trait."""
    marked = trait if k == 0 else ""
    chain = _BEARS.get(marked, {}).get(work.chain, work.chain)
    return finger(
        rng,
        f"f{k}",
        chain,
        work.place,
        work.role,
        work.force_N,
        follows=marked == "mimic" and chain == "two_hinges",
        spring=marked == "spring",
        collide_links=chance(rng, 0.1),
        tip_friction=pads.friction,
        tip_solref=pads.solref,
    )


def _tray(rng: np.random.Generator, thing: Thing) -> Finger:
    """Return a fingertip that is a tray under the object, on a vertical slide."""
    mass, side = uniform(rng, 0.1, 0.3), max(thing.half[0], thing.half[1] if thing.kind == "block" else 0) + 0.02
    total = mass + thing.mass
    omega = uniform(rng, 28.0, 45.0)
    kp, travel = total * omega**2, uniform(rng, 0.006, 0.03)
    whole = 2 * uniform(rng, 0.5, 1.2) * total * omega
    joint = tag("joint", name="f0_z", type="slide", axis=(0.0, 0.0, 1.0), damping=0.3 * whole)
    pad = tag("geom", name="f0_tip", type="box", size=(side, side, 0.004), pos=(0.0, 0.0, -0.004), mass=mass)
    servo = Servo("f0_z", True, "carry", 0.0, -0.3 * travel, travel, kp, 0.7 * whole, None)
    xml = tag("body", joint + pad, name="f0", pos=(0.0, 0.0, 0.06))
    return Finger(xml, (servo,), "f0_tip", "f0", mass=mass)
