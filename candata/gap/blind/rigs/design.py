"""A random small scene: MJCF text, the roles of its parts, and the outline of its episodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import yaml

from candata.gap.blind.rigs.hands import Hand, draw_hand
from candata.gap.blind.rigs.mjcf import scene_xml
from candata.gap.blind.rigs.servos import Drive
from candata.gap.blind.rigs.situations import SITUATIONS, Situation, Thing, draw_thing, suits
from candata.gap.blind.rigs.text import chance, uniform
from candata.schema.scene import Noise, SceneFile

TRAITS = ("plain", "cut", "mimic", "filtered", "integrating", "delayed", "spring", "free_base")
#: Traits that are drawn at rest and cut in motion.
ALSO_CUT = ("mimic", "filtered", "spring", "free_base")
#: Rates [Hz] and the physics steps [s] that divide their control steps.
CLOCKS = {
    50: (0.002, 0.0025, 0.004, 0.005),
    80: (0.0025, 0.00125),
    100: (0.002, 0.0025, 0.005, 0.001),
    125: (0.002, 0.004),
    200: (0.0025, 0.005, 0.001),
}
#: Noise, 1 sd: of hinges [rad], of slides [m], of both where one number declares it, of forces [N], of an object's
#: place [m] and turn [rad]. Chosen: encoders of 12 bits to potentiometers, trackers by markers to trackers by a camera.
NOISE = {
    "hinge": (0.0003, 0.003),
    "slide": (0.00005, 0.0005),
    "both": (0.00015, 0.0008),
    "force": (0.008, 0.05),
    "place": (0.0002, 0.001),
    "turn": (0.002, 0.009),
}
#: Step in which some sensors report forces [N].
FORCE_STEP_N = 0.05


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
    names = [s for s in SITUATIONS if suits(kind, cut, s)]
    odds = np.array([SITUATIONS[s] for s in names])
    situation: Situation = names[int(rng.choice(len(names), p=odds / odds.sum()))]
    thing = draw_thing(rng, situation)
    hand = draw_hand(rng, kind, situation, thing)
    drives = drives_of(rng, kind, hand)
    table = thing is not None or situation in ("pressing", "meeting") or chance(rng, 0.4)
    xml = scene_xml(rng, kind, situation, step, thing, hand, drives, table)
    noise, slide_noise, declared = _noise(rng, thing is not None, drives)
    joints = [d.servo.joint for d in drives]
    order = drives
    if chance(rng, 0.3):
        joints = [joints[i] for i in rng.permutation(len(joints))]
        order = tuple(drives[i] for i in rng.permutation(len(drives)))
    tips = [f.tip_body if chance(rng, 0.15) else f.tip for f in hand.fingers]
    support = "table" if thing is not None and situation != "carried" and chance(rng, 0.85) else None
    file = SceneFile(
        model="scene.xml",
        rate_hz=rate,
        object="object" if thing else None,
        joints=tuple(joints),
        actuators=tuple(d.name for d in order),
        fingertips=tuple(tips) if thing or chance(rng, 0.5) else (),
        support=support,
        noise=noise if declared else None,
    )
    rows = max(round((duration_s or uniform(rng, 1.2, 2.5)) * rate), 10)
    tasks = int(rng.choice([t for t in (2, 3, 4, 6, episodes) if t <= episodes] or [episodes]))
    return Rig(
        xml,
        file,
        noise,
        slide_noise,
        situation,
        kind,
        cut,
        order,
        tuple(t for f in hand.fingers for t in f.follows),
        thing,
        tasks,
        episodes,
        rows,
        chance(rng, 0.5),
    )


def drives_of(rng: np.random.Generator, trait: str, hand: Hand) -> tuple[Drive, ...]:
    """Return the actuators of a hand; of an integrating one all, or the first alone, take velocities."""
    every = chance(rng, 0.6)
    return tuple(
        Drive(f"m_{s.joint}", s, trait == "integrating" and (every or i == 0)) for i, s in enumerate(hand.servos)
    )


def _noise(rng: np.random.Generator, has_object: bool, drives: tuple[Drive, ...]) -> tuple[Noise, float, bool]:
    """Return the true noise, that of slides [m], and whether it is declared: slides and hinges have the same then."""
    declared = chance(rng, 0.55)
    hinge, slide, both, force = (_spread(rng, *NOISE[name]) for name in ("hinge", "slide", "both", "force"))
    kinds = {d.servo.slides for d in drives}
    if declared and len(kinds) == 2:
        hinge = slide = both
    noise = Noise(
        object_pose=(_spread(rng, *NOISE["place"]), _spread(rng, *NOISE["turn"])) if has_object else (0.0, 0.0),
        joint_position=slide if kinds == {True} else hinge,
        fingertip_force=force,
        force_step=FORCE_STEP_N if declared and chance(rng, 0.1) else 0.0,
    )
    return noise, slide, declared


def _spread(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number of three digits, drawn evenly in its logarithm."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")
