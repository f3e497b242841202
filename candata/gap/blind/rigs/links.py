"""Links of a finger of a random small scene: their shapes, and their bodies as MJCF text."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from candata.gap.blind.rigs.servos import GRAVITY_M_S2
from candata.gap.blind.rigs.text import tag, uniform


class Place(NamedTuple):
    """Where a finger works: a point, the direction it comes along, how far before the point it meets a surface."""

    x: float
    y: float
    z: float
    azimuth: float
    surface: float


class Links(NamedTuple):
    """What all links of a finger share."""

    name: str
    radius: float
    collide: bool
    friction: float
    solref: tuple[float, float] | None
    spring: bool

    def link(self, length: float, mass: float, thick: float = 0.006) -> str:
        """Return a capsule that hangs down by a length."""
        off = None if self.collide else 0
        return tag(
            "geom",
            type="capsule",
            fromto=(0.0, 0.0, 0.0, 0.0, 0.0, -length),
            size=thick,
            mass=mass,
            contype=off,
            conaffinity=off,
        )

    def pad(self, rng: np.random.Generator, down: float, mass: float) -> str:
        """Return the fingertip's geom, so far below its body's frame."""
        shape = str(rng.choice(["sphere", "sphere", "sphere", "capsule", "box"]))
        r = self.radius
        size = {"sphere": (r,), "capsule": (r, 0.006), "box": (r, r, r)}[shape]
        axis = (1.0, 1.0, 0.0, 0.0) if shape == "capsule" else None  # it lies across the finger's motion
        return tag(
            "geom",
            name=f"{self.name}_tip",
            type=shape,
            size=size,
            pos=(0.0, 0.0, -down),
            mass=mass,
            quat=axis,
            friction=(self.friction, 0.005, 0.0001),
            solref=self.solref,
        )


def placed_body(name: str, place: Place, x: float, z: float, inner: str) -> str:
    """Return a body at `(x, 0, z)` of the frame that looks along the place's azimuth, its point as origin."""
    c, s = np.cos(place.azimuth), np.sin(place.azimuth)
    half = place.azimuth / 2
    return tag(
        "body",
        inner,
        name=name,
        pos=(place.x + c * x, place.y + s * x, z),
        quat=(float(np.cos(half)), 0.0, 0.0, float(np.sin(half))),
    )


class Shape(NamedTuple):
    """Dimensions of a hanging chain: its links [m, kg], and the turns at rest and where the surface is met [rad]."""

    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    tip_mass: float
    rest: float
    touch: float
    bend: float
    ratio: float

    @property
    def far(self) -> float:
        """Length of the second link."""
        return sum(self.lengths[1:])

    @property
    def mass(self) -> float:
        """Mass of the whole chain."""
        return sum(self.masses) + self.tip_mass

    @property
    def inertia(self) -> float:
        """Inertia about the first hinge, stretched."""
        links = sum(m * L**2 / 3 for m, L in zip(self.masses, self.lengths, strict=True))
        return links + self.tip_mass * sum(self.lengths) ** 2 + sum(self.masses[1:]) * self.lengths[0] ** 2

    @property
    def load(self) -> float:
        """Torque of its weight about the first hinge [N m], a little less than stretched out."""
        return self.mass * GRAVITY_M_S2 * sum(self.lengths) * 0.6

    @property
    def reached(self) -> tuple[float, float]:
        """How far ahead of the first hinge, and how far below, the tip is where the surface is met."""
        turned = self.touch + self.bend
        ahead = self.lengths[0] * np.sin(self.touch) + self.far * np.sin(turned)
        return float(ahead), float(self.lengths[0] * np.cos(self.touch) + self.far * np.cos(turned))


def drawn_shape(rng: np.random.Generator, two: bool, follows: bool, sweeps: bool) -> Shape:
    """Return drawn dimensions; a joint that follows stands at its ratio of the first."""
    lengths = (uniform(rng, 0.05, 0.1), *((uniform(rng, 0.03, 0.06),) if two else ()))
    touch = -uniform(rng, 0.3, 0.6) if sweeps else uniform(rng, -0.1, 0.35)
    ratio = uniform(rng, 0.4, 1.2)
    bend = ratio * touch if follows else uniform(rng, -0.2, 0.5)
    return Shape(
        lengths,
        tuple(uniform(rng, 0.01, 0.04) for _ in lengths),
        uniform(rng, 0.004, 0.015),
        touch - uniform(rng, 0.12, 0.4),
        touch,
        bend if two else 0.0,
        ratio,
    )
