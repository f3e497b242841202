"""What a policy is: it plans the commands of one episode from a random generator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.scenes import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """Commands of one episode and the state it starts from.

    Attributes
    ----------
    commands : (T, A) float64
        What the actuators take, at the scene's rate.
    qpos, qvel : (nq,), (nv,) float64
        State before settling.
    settle_s : float
        Time for which the first command is held before row 0, so that the episode begins at rest [s].
    object_shift_m : (3,) float64, optional
        Where the object is put on purpose, from its place in the model [m].
    """

    commands: Array
    qpos: Array
    qvel: Array
    settle_s: float
    object_shift_m: Array | None = None


Planner = Callable[[Scene, np.random.Generator, float], Plan]


@dataclass(frozen=True)
class Variant:
    """A policy with other parameters: speed, amplitude, levels.

    Attributes
    ----------
    words : str
        What is played, for people.
    plan : callable
        `(scene, rng, duration_s) -> Plan`.
    """

    words: str
    plan: Planner


@dataclass(frozen=True)
class Policy:
    """A scripted motion.

    Attributes
    ----------
    about : str
        One line for people.
    possible : callable
        `scene -> bool`.
    plan : callable
        `(scene, rng, duration_s) -> Plan`.
    variants : tuple of Variant
        The same kind of motion, made to show one thing; never part of the usual mix.
    """

    about: str
    possible: Callable[[Scene], bool]
    plan: Planner
    variants: tuple[Variant, ...] = ()


@dataclass(frozen=True, eq=False)
class Motion:
    """Commands that are at hand, to be played as they are.

    Attributes
    ----------
    name : str
        What it is called.
    commands : (T, A) float64
        What the actuators take, at the scene's rate.
    object_shift_m : (3,) float64
        Where the object stands, from its place in the model [m].
    """

    name: str
    commands: Array
    object_shift_m: Array
