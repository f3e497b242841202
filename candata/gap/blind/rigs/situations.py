"""What goes on in a random small scene, and its object."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from candata.gap.blind.rigs.text import chance, uniform

Situation = Literal["none", "rest", "meeting", "pressing", "pushed", "rolling", "pinched", "held", "lifted", "carried"]
#: How often a situation is drawn. Chosen: objects that nothing touches and objects that are touched about as often.
SITUATIONS: dict[Situation, float] = {
    "none": 0.11,
    "rest": 0.22,
    "meeting": 0.08,
    "pressing": 0.07,
    "pushed": 0.19,
    "rolling": 0.07,
    "pinched": 0.12,
    "held": 0.05,
    "lifted": 0.06,
    "carried": 0.03,
}
#: Situations in which something else than the support touches the object.
TOUCHED: tuple[Situation, ...] = ("pushed", "rolling", "pinched", "held", "lifted", "carried")


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


def suits(trait: str, cut: bool, situation: Situation) -> bool:
    """Tell whether a trait is drawn in a situation: heavy or staged grips stand on a base that does not give."""
    if trait == "free_base":
        return situation in ("none", "rest", "meeting", "pushed", "rolling")
    if trait == "integrating":
        return situation not in ("held", "carried")
    if trait == "mimic":
        return situation not in ("carried", "pressing")
    return True


def draw_thing(rng: np.random.Generator, situation: Situation) -> Thing | None:
    """Return the object of a situation; None without one."""
    if situation == "none" or (situation in ("meeting", "pressing") and chance(rng, 0.4)):
        return None
    kinds = {
        "rolling": ["ball", "roller"],
        "pushed": ["block", "can", "ball"],
        "carried": ["block", "can"],
        "held": ["block", "can", "block"],
        "lifted": ["block", "can"],
    }
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
