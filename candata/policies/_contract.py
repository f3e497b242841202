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
    """

    commands: Array
    qpos: Array
    qvel: Array
    settle_s: float


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
    """

    about: str
    possible: Callable[[Scene], bool]
    plan: Callable[[Scene, np.random.Generator, float], Plan]
