"""What a policy is: it plans the commands of one episode from a random generator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.scenes import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Goal:
    """What an episode is meant to do with the object; a field left at its default asks for nothing.

    Attributes
    ----------
    lift_m : float
        Least height that the object gains over row 0 [m], for `held_s` without a break.
    held_s : float
        How long it stays lifted [s].
    place_m : (3,) float64, optional
        Displacement of the object's origin at the last row from row 0 [m].
    place_tolerance_m : float
        Greatest distance from `place_m`, along the support, that still counts [m].
    turn_rad : float
        Least angle about the vertical by which the object is turned at some row while a fingertip touches it, from
        row 0 [rad].
    topple : bool
        The object is meant to end on another side than it began.
    slip : bool
        The object is meant to slip out of the fingers.
    """

    lift_m: float = 0.0
    held_s: float = 0.0
    place_m: Array | None = None
    place_tolerance_m: float = 0.05
    turn_rad: float = 0.0
    topple: bool = False
    slip: bool = False


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
    goal : Goal, optional
        What the commands are meant to do with the object; None where nothing is meant.
    """

    commands: Array
    qpos: Array
    qvel: Array
    settle_s: float
    object_shift_m: Array | None = None
    goal: Goal | None = None


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
    on_request : bool
        Played where it is named only: never part of the usual mix.
    """

    about: str
    possible: Callable[[Scene], bool]
    plan: Planner
    variants: tuple[Variant, ...] = ()
    on_request: bool = False


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


@dataclass(frozen=True)
class Observation:
    """What a policy sees before a control step.

    Attributes
    ----------
    row : int
        Control step, from 0.
    time_s : float
        Time since row 0 [s].
    readings : mapping of str to ndarray
        The channels that the episode stores, with their noise: `object_pose (7,)` [m, quaternion w x y z],
        `joint_position (J,)` [rad, m], `fingertip_force (F, 3)` [N].
    action : (A,) float64
        The previous commands; at row 0 those that open the hand.
    """

    row: int
    time_s: float
    readings: Mapping[str, Array]
    action: Array


Step = Callable[[Observation], Array]
