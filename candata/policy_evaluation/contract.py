"""What every world of a policy evaluation takes and gives: starts, orders, and what came of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from candata.policies import Goal, Step
from candata.scenes import Scene
from candata.schema.outcome import SUCCESS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RealStarts:
    """The states at row 0 from which n recorded episodes began, in one scene.

    Attributes
    ----------
    ids : tuple of n str
        The episodes.
    tasks : tuple of n str
        What was played in each; empty where it is not known.
    numbers : (n,) int64
        Seed the random streams of a start, together with the seed of an evaluation: what a start draws does not depend
        on which others are played beside it.
    qpos, qvel : (n, nq), (n, nv) float64
        State at row 0, as the nominal scene estimates it.
    memory : (n, M) float64
        What actuators and plugins remember then, see `candata.simulate.loop.MEMORY`.
    """

    ids: tuple[str, ...]
    tasks: tuple[str, ...]
    numbers: NDArray[np.int64]
    qpos: Array
    qvel: Array
    memory: Array

    def __len__(self) -> int:
        """Return the number of starts."""
        return len(self.ids)

    def take(self, index: Sequence[int] | NDArray[np.int64]) -> RealStarts:
        """Return some of the starts; one may be there several times."""
        chosen = np.asarray(index, int)
        return RealStarts(
            tuple(self.ids[i] for i in chosen),
            tuple(self.tasks[i] for i in chosen),
            self.numbers[chosen],
            self.qpos[chosen],
            self.qvel[chosen],
            self.memory[chosen],
        )


@dataclass(frozen=True)
class Orders:
    """What a policy is going to do from n starts.

    Attributes
    ----------
    commands : (n, T, A) float64
        The planned commands at the scene's rate; of a closed loop, those that hold the hand open before it begins.
    begins : tuple of n callables or None
        `() -> step` of a closed loop, where `step` is `Observation -> (A,)`; None where the commands are planned.
    goals : tuple of n Goal or None
        What is meant with the object from each start; None where nothing is.
    settle_s : float
        Time for which the first commands are held before row 0 [s].
    """

    commands: Array
    begins: tuple[Callable[[], Step] | None, ...]
    goals: tuple[Goal | None, ...]
    settle_s: float


class PlayedPolicy(Protocol):
    """A policy that can be played in any world."""

    @property
    def name(self) -> str:
        """What it is called in tables."""

    def orders(self, scene: Scene, starts: RealStarts, seed: int, duration_s: float) -> Orders:
        """Return what it is going to do from some starts; the same for a start whatever others there are."""


@dataclass(frozen=True)
class Played:
    """What came of a policy from n starts in one world, T rows each.

    Attributes
    ----------
    outcomes : tuple of n str or None
        What became of the object (`candata.schema.outcome.OUTCOMES`); None where nothing was meant with it.
    object_pose : (n, T, 7) float64 [m, quaternion w x y z]
        True poses of a simulation, forecast poses of a learned world.
    joint_position : (n, T, J) float64 [rad, m]
        Joints.
    contact : (n, T) float64
        Probability that the hand touches the object; 0 or 1 in a simulation.
    commands : (n, T, A) float64
        What was commanded.
    rate_hz : float
        Rows a second: the scene's.
    spread_m : (n,) float64 or None
        Mean distance of sampled forecasts from their mean, over the episode [m]; None in a simulation.
    failed : (n,) bool
        Where the simulation became unstable; its outcome is not to be trusted.
    """

    outcomes: tuple[str | None, ...]
    object_pose: Array
    joint_position: Array
    contact: Array
    commands: Array
    rate_hz: float
    spread_m: Array | None
    failed: NDArray[np.bool_]

    @property
    def success(self) -> NDArray[np.bool_]:
        """Which starts `(n,)` ended in success."""
        return np.array([word == SUCCESS for word in self.outcomes], bool)

    @property
    def counted_success(self) -> Array:
        """Success `(n,)` as it counts: 1, 0, or NaN where the simulation became unstable."""
        return np.where(self.failed, np.nan, self.success)


class World(Protocol):
    """Where policies are played."""

    @property
    def name(self) -> str:
        """What it is called in tables: `nominal`, `repaired`, the name of a run, `withheld`."""

    @property
    def summary(self) -> str:
        """What it is, for people; of a learned world also what moves the joints."""

    def play(self, policy: PlayedPolicy, starts: RealStarts, seed: int, duration_s: float) -> Played:
        """Return what comes of a policy from all starts, played as one batch.

        Raises
        ------
        DataError
            When the policy fails, gives no commands, takes too long, or reads a channel that the world lacks.
        """
