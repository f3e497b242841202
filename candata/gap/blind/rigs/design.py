"""A random small scene: MJCF text, the roles of its parts, and what its hand is to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import yaml

from candata.gap.blind.rigs.fingers import (
    CHAINS,
    GRAVITY_M_S2,
    SPRING_RATIO,
    Chain,
    Finger,
    Place,
    Role,
    Servo,
    chance,
    finger,
    tag,
    uniform,
)
from candata.schema.scene import Noise, SceneFile

Situation = Literal["none", "rest", "meeting", "pressing", "pushed", "rolling", "pinched", "held", "lifted", "carried"]
#: How often a situation is drawn. Chosen: objects that nothing touches and objects that are touched about as often.
SITUATIONS: dict[Situation, float] = {
    "none": 0.11, "rest": 0.22, "meeting": 0.08, "pressing": 0.07, "pushed": 0.19, "rolling": 0.07, "pinched": 0.12,
    "held": 0.05, "lifted": 0.06, "carried": 0.03,
}  # fmt: skip
#: Situations in which something else than the support touches the object.
TOUCHED: tuple[Situation, ...] = ("pushed", "rolling", "pinched", "held", "lifted", "carried")
TRAITS = ("plain", "cut", "mimic", "filtered", "integrating", "delayed", "spring", "free_base")
#: Traits that are drawn at rest and cut in motion.
ALSO_CUT = ("mimic", "filtered", "spring", "free_base")
#: Rates [Hz] and the physics steps [s] that divide their control steps.
CLOCKS = {50: (0.002, 0.0025, 0.004, 0.005), 80: (0.0025, 0.00125), 100: (0.002, 0.0025, 0.005, 0.001),
          125: (0.002, 0.004), 200: (0.0025, 0.005, 0.001)}  # fmt: skip


class Thing(NamedTuple):
    """The object: kind, half sizes [m] (radius first for what is round), mass [kg], friction, height of its middle."""

    kind: Literal["block", "ball", "can", "roller"]
    half: tuple[float, ...]
    mass: float
    friction: float
    middle: float

    def reach(self, azimuth: float) -> float:
        """Return how far its side lies from its middle in a horizontal direction [m]."""
        if self.kind == "block":
            c, s = abs(np.cos(azimuth)), abs(np.sin(azimuth))
            return float(min(self.half[0] / max(c, 1e-9), self.half[1] / max(s, 1e-9)))
        return self.half[0]


class Hand(NamedTuple):
    """Fingers with the bodies of all of them, and their servos, those of a wrist last."""

    fingers: tuple[Finger, ...]
    xml: str
    servos: tuple[Servo, ...]


class Drive(NamedTuple):
    """What an actuator takes: its name, its servo, and whether its command is a velocity that it integrates."""

    name: str
    servo: Servo
    integrates: bool


@dataclass(frozen=True)
class Rig:
    """A drawn scene and the outline of its episodes.

    Attributes
    ----------
    xml : str
        MJCF.
    file : SceneFile
        What `scene.yaml` says; its noise is null where it is not declared.
    noise : Noise
        The true noise of pose, hinges and forces.
    slide_noise_m : float
        The true noise of slides.
    situation, trait : str
    cut : bool
        Whether episodes are cut from longer logs, in motion.
    drives : tuple of Drive
        In the order of `action`.
    follows : tuple of (str, str, float)
        Joints that an equality holds at a ratio of another: where they start.
    thing : Thing or None
    tasks, episodes, rows : int
        Different motions, episodes (the tasks in turn), rows of each.
    jitter : bool
        Whether each episode places the object anew; else each task does.
    """

    xml: str
    file: SceneFile
    noise: Noise
    slide_noise_m: float
    situation: Situation
    trait: str
    cut: bool
    drives: tuple[Drive, ...]
    follows: tuple[tuple[str, str, float], ...]
    thing: Thing | None
    tasks: int
    episodes: int
    rows: int
    jitter: bool

    @property
    def yaml(self) -> str:
        """Text of `scene.yaml`."""
        return yaml.safe_dump(self.file.model_dump(mode="json", exclude_defaults=True), sort_keys=False)


def split_trait(text: str) -> tuple[str, bool]:
    """Return the structural trait and whether episodes are cut: `mimic cut` is (`mimic`, True)."""
    words = text.split()
    return (words[0] if words[0] != "cut" else "plain"), "cut" in words


def all_traits() -> tuple[str, ...]:
    """Return the texts of all traits, those that are also cut twice."""
    return (*TRAITS, *(f"{trait} cut" for trait in ALSO_CUT))


def draw_rig(rng: np.random.Generator, trait: str, episodes: int, duration_s: float | None = None) -> Rig:
    """Return a scene drawn for a trait; it may turn out not to be sane.

    Parameters
    ----------
    rng : numpy.random.Generator
    trait : str
        One of `all_traits()`.
    episodes : int
    duration_s : float, optional
        Length of an episode; 1.2 to 2.5 s by default.
    """
    kind, cut = split_trait(trait)
    rate = int(rng.choice(list(CLOCKS)))
    step = float(rng.choice(CLOCKS[rate]))
    names = [s for s in SITUATIONS if _suits(kind, cut, s)]
    odds = np.array([SITUATIONS[s] for s in names])
    situation: Situation = names[int(rng.choice(len(names), p=odds / odds.sum()))]
    thing = _thing(rng, situation)
    hand = _hand(rng, kind, situation, thing)
    drives = _drives(rng, kind, hand)
    table = thing is not None or situation in ("pressing", "meeting") or chance(rng, 0.4)
    xml = _mjcf(rng, kind, situation, step, thing, hand, drives, table)
    noise, slide_noise, declared = _noise(rng, thing is not None, drives)
    joints = [d.servo.joint for d in drives]
    order = drives
    if chance(rng, 0.3):
        joints = [joints[i] for i in rng.permutation(len(joints))]
        order = tuple(drives[i] for i in rng.permutation(len(drives)))
    tips = [f.tip_body if chance(rng, 0.15) else f.tip for f in hand.fingers]
    support = "table" if thing is not None and situation != "carried" and chance(rng, 0.85) else None
    file = SceneFile(
        model="scene.xml", rate_hz=rate, object="object" if thing else None, joints=tuple(joints),
        actuators=tuple(d.name for d in order), fingertips=tuple(tips) if thing or chance(rng, 0.5) else (),
        support=support, noise=noise if declared else None,
    )  # fmt: skip
    rows = max(round((duration_s or uniform(rng, 1.2, 2.5)) * rate), 10)
    tasks = int(rng.choice([t for t in (2, 3, 4, 6, episodes) if t <= episodes] or [episodes]))
    return Rig(
        xml, file, noise, slide_noise, situation, kind, cut, order, tuple(t for f in hand.fingers for t in f.follows), thing,
        tasks, episodes, rows, chance(rng, 0.5),
    )  # fmt: skip


def _suits(trait: str, cut: bool, situation: Situation) -> bool:
    """Tell whether a trait is drawn in a situation: heavy or staged grips stand on a base that does not give."""
    if trait == "free_base":
        return situation in ("none", "rest", "meeting", "pushed", "rolling")
    if trait == "integrating":
        return situation not in ("held", "carried")
    if trait == "mimic":
        return situation not in ("carried", "pressing")
    return True


def _thing(rng: np.random.Generator, situation: Situation) -> Thing | None:
    """Return the object of a situation; None without one."""
    if situation == "none" or (situation in ("meeting", "pressing") and chance(rng, 0.4)):
        return None
    kinds = {"rolling": ["ball", "roller"], "pushed": ["block", "can", "ball"], "carried": ["block", "can"],
             "held": ["block", "can", "block"], "lifted": ["block", "can"]}  # fmt: skip
    kind = str(rng.choice(kinds.get(situation, ["block", "can", "ball"])))
    wide, tall = uniform(rng, 0.014, 0.03), uniform(rng, 0.018, 0.045)
    mass, friction = uniform(rng, 0.03, 0.25), uniform(rng, 0.4, 1.2)
    if kind == "ball":
        return Thing("ball", (wide,), mass, friction, wide)
    if kind == "roller":
        return Thing("roller", (wide, tall), mass, friction, wide)
    if kind == "can":
        return Thing("can", (wide, tall), mass, friction, tall)
    return Thing("block", (wide, uniform(rng, 0.014, 0.03), tall), mass, friction, tall)


def _hand(rng: np.random.Generator, trait: str, situation: Situation, thing: Thing | None) -> Hand:
    """Return the hand: fingers that work on the object or on each other first, then free ones."""
    fingers = _workers(rng, trait, situation, thing)
    if trait == "mimic" and len(fingers) == 2 and all(s.slides for f in fingers for s in f.servos):
        fingers[1] = _tied(fingers[1], fingers[0])
    xml, wrist = "".join(f.xml for f in fingers), ()
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
) -> Finger:  # fmt: skip
    """Return a finger that moves beside or above the object and does not reach it."""
    chain: Chain = "two_hinges" if trait == "mimic" and marks else CHAINS[int(rng.choice(len(CHAINS)))]
    if trait == "spring" and marks and chain == "slide_hinge":
        chain = "hinge"
    above = not crowded and chance(rng, 0.4)
    size = max(thing.half) + thing.middle if thing else 0.0
    far = uniform(rng, 0.0, 0.03) if above or thing is None else size + uniform(rng, 0.12, 0.2)
    height = (2 * thing.middle if thing else 0.0) + uniform(rng, 0.04, 0.08) if above else uniform(rng, 0.03, 0.1)
    place = Place(far * np.cos(angle), far * np.sin(angle), height, uniform(rng, 0, 2 * np.pi), 0.0)
    return finger(rng, f"f{k}", chain, place, "free", 0.0, follows=trait == "mimic" and marks,
                  spring=trait == "spring" and marks)  # fmt: skip


def _workers(rng: np.random.Generator, trait: str, situation: Situation, thing: Thing | None) -> list[Finger]:
    """Return the fingers that touch something."""
    solref = (uniform(rng, 0.01, 0.03), 1.0) if chance(rng, 0.3) else None
    slick = uniform(rng, 0.3, 1.2)

    def make(chain: Chain, place: Place, role: Role, force: float, k: int) -> Finger:
        marked = k == 0
        if marked and trait == "mimic" and chain in ("hinge", "slide_hinge"):
            chain = "two_hinges"
        if marked and trait == "spring":
            chain = {"slide_hinge": "hinge", "plunger": "sweeper"}.get(chain, chain)  # type: ignore[assignment]
        return finger(
            rng, f"f{k}", chain, place, role, force, follows=marked and trait == "mimic" and chain == "two_hinges",
            spring=marked and trait == "spring", collide_links=chance(rng, 0.1), tip_friction=slick, tip_solref=solref,
        )  # fmt: skip

    def pick(*chains: Chain) -> Chain:
        if trait == "mimic" and "two_hinges" in chains:
            return "two_hinges"
        return chains[int(rng.choice(len(chains)))]

    if situation == "meeting":
        z, angle = uniform(rng, 0.1, 0.14), uniform(rng, 0, np.pi)
        return [make(pick(*CHAINS), Place(0.0, 0.0, z, angle + k * np.pi, 0.0), "push", uniform(rng, 0.3, 2.0), k)
                for k in range(2)]  # fmt: skip
    if situation == "pressing":
        far = 0.1 if thing else 0.0
        return [make(pick("plunger", "sweeper"), Place(far, 0.08 * k, 0.0, uniform(rng, -0.5, 0.5), 0.0), "press",
                     uniform(rng, 0.3, 2.5), k) for k in range(int(rng.integers(1, 3)))]  # fmt: skip
    if thing is None or situation in ("rest", "none"):
        return []
    if situation == "carried":
        return [_tray(rng, thing)]
    height = thing.middle * uniform(rng, 0.85, 1.15)
    angle = uniform(rng, 0, 2 * np.pi) if thing.kind in ("ball", "can") else float(rng.choice([0.0, np.pi / 2]))
    if thing.kind == "roller":
        angle = 0.0
    if situation in ("pushed", "rolling"):
        count = int(rng.integers(1, 3))
        return [make(pick(*CHAINS), Place(0.0, 0.0, height, angle + k * np.pi, thing.reach(angle)), "push",
                     uniform(rng, 0.3, 1.5) * max(thing.mass * GRAVITY_M_S2, 0.5), k) for k in range(count)]  # fmt: skip
    # Two fingers hold by friction: each presses with a few times what the object's weight asks of it.
    grip = uniform(rng, 1.5, 3.5) * thing.mass * GRAVITY_M_S2 / (2 * max(thing.friction, slick))
    chains: tuple[Chain, ...] = ("slide", "hinge") if situation in ("lifted", "held") else CHAINS
    chain = pick(*chains)
    return [make(chain, Place(0.0, 0.0, height, angle + k * np.pi, thing.reach(angle)), "grip", max(grip, 0.3), k)
            for k in range(2)]  # fmt: skip


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


def _drives(rng: np.random.Generator, trait: str, hand: Hand) -> tuple[Drive, ...]:
    """Return the actuators of a hand; of an integrating one all, or the first alone, take velocities."""
    every = chance(rng, 0.6)
    return tuple(
        Drive(f"m_{s.joint}", s, trait == "integrating" and (every or i == 0)) for i, s in enumerate(hand.servos)
    )


def _mjcf(
    rng: np.random.Generator, trait: str, situation: Situation, step: float, thing: Thing | None, hand: Hand,
    drives: tuple[Drive, ...], table: bool,
) -> str:
    """Return the MJCF of a scene."""
    option = tag("option", timestep=step, integrator=str(rng.choice(["Euler", "implicitfast"])),
                 cone=str(rng.choice(["pyramidal", "elliptic"])))  # fmt: skip
    world = tag("geom", name="table", type="plane", size=(1.0, 1.0, 0.1),
                friction=(uniform(rng, 0.3, 1.0), 0.005, 0.0001)) if table else ""  # fmt: skip
    world += _object_xml(rng, situation, thing) if thing else ""
    fingers = hand.xml
    if trait == "free_base":
        fingers = _based(rng, fingers, sum(f.mass for f in hand.fingers), table)
    ties = "".join(
        tag("joint", joint1=a, joint2=b, polycoef=(0.0, ratio, 0.0, 0.0, 0.0),
            solref=(uniform(rng, 0.01, 0.03), 1.0) if chance(rng, 0.4) else None)
        for f in hand.fingers for a, b, ratio in f.follows
    )  # fmt: skip
    motors = "".join(_motors(rng, trait, step, drives))
    return tag(
        "mujoco",
        tag("compiler", angle="radian") + option + tag("worldbody", world + fingers)
        + (tag("equality", ties) if ties else "") + tag("actuator", motors),
        model="small",
    )  # fmt: skip


def _object_xml(rng: np.random.Generator, situation: Situation, thing: Thing) -> str:
    """Return the object's body at its place: on the table, on the tray, or aside of fingers that need its room."""
    shapes = {"block": "box", "ball": "sphere", "can": "cylinder", "roller": "cylinder"}
    rolls = thing.kind in ("ball", "roller")
    geom = tag(
        "geom", name="shape", type=shapes[thing.kind], size=thing.half, mass=thing.mass,
        quat=(1.0, 1.0, 0.0, 0.0) if thing.kind == "roller" else None,  # a roller lies along y
        friction=(thing.friction, 0.005, uniform(rng, 0.0001, 0.001) if rolls else 0.0001),
        condim=6 if rolls and chance(rng, 0.7) else (4 if chance(rng, 0.15) else None),
        solref=(uniform(rng, 0.01, 0.03), 1.0) if chance(rng, 0.25) else None,
    )  # fmt: skip
    aside = -0.12 if situation == "pressing" else 0.0
    lift = 0.06 if situation == "carried" else 0.0
    return tag("body", tag("freejoint") + geom, name="object", pos=(aside, 0.0, thing.middle + lift))


def _based(rng: np.random.Generator, fingers: str, mass: float, table: bool) -> str:
    """Return the fingers on a base that gives: sprung slides, a sprung ball, a sprung free joint, or a free block."""
    kind = str(rng.choice(["slides", "ball", "free", *(["block"] if table else [])]))
    base_mass = uniform(rng, 0.4, 1.5)
    total, height = base_mass + mass, 0.22
    omega, ratio = uniform(rng, 14.0, 30.0), uniform(rng, *SPRING_RATIO)
    stiffness, damping = total * omega**2, 2 * ratio * total * omega
    at = (0.0, 0.0, height)
    geom = tag("geom", type="box", size=(0.04, 0.04, 0.015), pos=at, mass=base_mass, contype=0, conaffinity=0)
    # Turning about the base's middle, at the height of the fingers' roots.
    turning = total * 0.05**2
    if kind == "slides":
        axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
        some = axes[: int(rng.integers(1, 4))]
        joints = "".join(
            tag("joint", name=f"base_{i}", type="slide", axis=axis, stiffness=stiffness, damping=damping)
            for i, axis in enumerate(some)
        )
    elif kind == "ball":
        stiff = max(turning * omega**2, 4 * total * GRAVITY_M_S2 * 0.1)
        joints = tag("joint", name="base", type="ball", pos=at, stiffness=stiff,
                     damping=2 * ratio * np.sqrt(stiff * turning))  # fmt: skip
    elif kind == "free":
        joints = tag("joint", name="base", type="free", stiffness=stiffness, damping=damping)
    else:  # a free block stands beside, its arm carries the fingers
        heavy = uniform(rng, 2.5, 5.0)
        joints = tag("freejoint", name="base")
        geom = tag("geom", name="foot", type="box", size=(0.09, 0.09, 0.05), pos=(-0.38, 0.0, 0.05), mass=heavy)
    if kind == "free":  # its spring turns it about its frame's origin, which is therefore its middle
        return tag("body", joints + tag("geom", type="box", size=(0.1, 0.1, 0.02), mass=base_mass, contype=0,
                                        conaffinity=0) + tag("body", fingers, pos=(0.0, 0.0, -height)),
                   name="base_body", pos=at)  # fmt: skip
    return tag("body", joints + geom + fingers, name="base_body")


def _motors(rng: np.random.Generator, trait: str, step: float, drives: tuple[Drive, ...]) -> list[str]:
    """Return the actuators' XML."""
    lag, general, delay = uniform(rng, 0.02, 0.08), chance(rng, 0.4), uniform(rng, 0.01, 0.06)
    smooth = chance(rng, 0.3)
    out = []
    for drive in drives:
        s = drive.servo
        ends = sorted((s.rest, s.away, s.toward))
        wide = 0.03 if s.slides else 0.3
        common = {"name": drive.name, "joint": s.joint, "forcerange": None if s.limit is None else (-s.limit, s.limit)}
        shown = (ends[0] - wide, ends[-1] + wide)
        if drive.integrates:
            out.append(tag("intvelocity", **common, kp=s.kp, kv=s.kv, actrange=shown))
        elif trait == "filtered" and general:
            out.append(tag("general", **common, dyntype="filter", dynprm=lag, gainprm=s.kp, biastype="affine",
                           biasprm=(0.0, -s.kp, -s.kv)))  # fmt: skip
        else:
            extra: dict[str, object] = {"timeconst": lag} if trait == "filtered" else {}
            if trait == "delayed":
                late = delay if smooth else step * max(round(delay / step), 1)
                extra = {"delay": late, "nsample": int(np.ceil(late / step)) + 2,
                         "interp": "linear" if smooth else None}  # fmt: skip
            out.append(tag("position", **common, kp=s.kp, kv=s.kv, **extra,
                           ctrlrange=shown if chance(rng, 0.4) else None))  # fmt: skip
    return out


def _noise(rng: np.random.Generator, has_object: bool, drives: tuple[Drive, ...]) -> tuple[Noise, float, bool]:
    """Return the true noise, that of slides [m], and whether it is declared; then slides have what hinges have."""
    declared = chance(rng, 0.55)
    only_slides = all(d.servo.slides for d in drives)
    joint = float(np.exp(rng.uniform(np.log(0.0003), np.log(0.003))))
    slide = float(np.exp(rng.uniform(np.log(0.00005), np.log(0.0005))))
    if declared:
        joint = slide = slide if only_slides or any(d.servo.slides for d in drives) else joint
    noise = Noise(
        object_pose=(uniform(rng, 0.0002, 0.001), uniform(rng, 0.002, 0.009)) if has_object else (0.0, 0.0),
        joint_position=joint, fingertip_force=float(np.exp(rng.uniform(np.log(0.008), np.log(0.05)))),
        force_step=0.05 if declared and chance(rng, 0.1) else 0.0,
    )  # fmt: skip
    return Noise(**{**noise.model_dump(), **({"joint_position": slide} if only_slides else {})}), slide, declared

