"""A command chunk refined by sampling: model predictive path integral control on what a world forecasts.

Source: G. Williams et al., "Information theoretic MPC for model-based reinforcement learning", ICRA 2017, algorithm 2:
the mean of sampled commands, each weighed by exp(-S / lambda) of its cost S.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.errors import UsageError
from candata.policies import Goal
from candata.policy_evaluation.choice import MOST_SPREAD_PER_GAIN, SPREAD_WEIGHT
from candata.policy_evaluation.chunk_worlds import ChunkWorld
from candata.policy_evaluation.commands import CommandBounds

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Stream of a seed by which a start's chunks are sampled.
ROUND_STREAM = 2
#: Weight of the distance from the first commands: the mean square of the way in standard deviations of the noise.
#: Chosen: moving all commands by one deviation costs a tenth of a goal.
CHANGE_WEIGHT = 0.1
#: Noise of a round over that of the one before. Chosen: four rounds end at a third of the first.
NOISE_DECAY = 0.7


@dataclass(frozen=True)
class MppiSettings:
    """How chunks are refined.

    Attributes
    ----------
    candidates : int
        Sampled chunks of a round.
    rounds : int
        Rounds.
    noise : float
        Noise of the first round at a knot, in standard deviations of the recorded commands.
    temperature : float
        Lambda, as a share of the standard deviation of the costs of a round.
    seed : int
        Of the noise and of the forecasts.
    """

    candidates: int = 64
    rounds: int = 4
    noise: float = 0.3
    temperature: float = 0.3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class RefinedChunks:
    """Refined chunks, and what a world forecasts of them.

    Attributes
    ----------
    commands : (S, R, A) float64
        The refined chunk where it is surely better, else the one that was there.
    changed : (S,) bool
        Where it is another one.
    cost_before, cost_after : (S,) float64
        Mean cost of the chunk that was there, and of the one kept, by fresh samples.
    reached_before, reached_after : (S,) float64
        Shares of the samples that reach the goal.
    """

    commands: Array
    changed: Flags
    cost_before: Array
    cost_after: Array
    reached_before: Array
    reached_after: Array


def refine_chunks(
    world: ChunkWorld,
    planned: Array,
    previous: Array,
    numbers: Sequence[int] | NDArray[np.int64],
    bounds: CommandBounds,
    goal: Goal,
    settings: MppiSettings,
    stage: Callable[[str], None] = lambda _name: None,
) -> RefinedChunks:
    """Return the chunks refined in a world, all starts together.

    A refined chunk is kept where it lies within what the world has seen, and its cost by fresh samples is lower than
    that of the planned one by more than the spread of the two; else the planned one stays.

    Parameters
    ----------
    world : ChunkWorld
        Who forecasts.
    planned : (S, R, A) float64
        Chunks to begin with.
    previous : (S, A) float64
        Commands before.
    numbers : (S,) int64
        Number of each start, by which it draws, whatever others there are.
    bounds : CommandBounds
        Limits and rates, which every sampled chunk keeps.
    goal : Goal
        What is meant.
    settings : MppiSettings
        How.
    stage : callable
        Called with what is being done.

    Raises
    ------
    UsageError
        When a setting means nothing, the planned commands are not finite, or the chunks are longer than the world can
        roll.
    """
    _check(settings, planned)
    rngs = [np.random.default_rng([settings.seed, ROUND_STREAM, number]) for number in numbers]
    rows, count = planned.shape[1], settings.candidates
    first = bounds.kept(planned, previous)
    mean, before = first, np.repeat(previous[:, None], count, axis=1)
    scale = settings.noise * np.maximum(bounds.spread, np.finfo(float).tiny)
    for number in range(settings.rounds):
        stage(f"refining, round {number + 1} of {settings.rounds}")
        noise = bounds.noise(rngs, count, rows, settings.noise * NOISE_DECAY**number)
        noise[:, 0] = 0.0
        sampled = bounds.kept(mean[:, None] + noise, before)
        cost = world.forecast(sampled, (settings.seed, number)).cost(goal).cost
        score = cost.mean(0) + SPREAD_WEIGHT * cost.std(0)
        score = score + CHANGE_WEIGHT * (((sampled - first[:, None]) / scale) ** 2).mean((-1, -2))
        weights = path_weights(np.where(world.is_familiar(sampled), score, np.inf), settings.temperature)
        has_weight = weights.sum(1) > 0
        moved = bounds.kept(np.einsum("sn,snra->sra", weights, sampled), previous)
        mean = np.where(has_weight[:, None, None], moved, mean)
    return _accepted(world, first, mean, goal, settings)


def path_weights(cost: Array, temperature: float) -> Array:
    """Return the weights `(S, N)` of costs `(S, N)`: exp(-(S - min S) / lambda), scaled to a sum of 1; 0 of infinity.

    Lambda is `temperature` times the standard deviation of a start's finite costs; where these are all equal, the
    weights are. A start without a finite cost has no weight at all.
    """
    finite = np.isfinite(cost)
    known = finite.any(1)
    usual = np.where(finite, cost, 0.0)
    number = np.maximum(finite.sum(1), 1)
    mean = usual.sum(1) / number
    spread = np.sqrt((np.where(finite, usual - mean[:, None], 0.0) ** 2).sum(1) / number)
    least = np.where(known, np.where(finite, cost, np.inf).min(1), 0.0)
    scale = np.where(spread > 0, temperature * spread, 1.0)
    weights = np.where(finite, np.exp(-np.where(finite, cost - least[:, None], 0.0) / scale[:, None]), 0.0)
    return np.asarray(weights / np.where(known, weights.sum(1), 1.0)[:, None])


def _accepted(world: ChunkWorld, first: Array, refined: Array, goal: Goal, settings: MppiSettings) -> RefinedChunks:
    """Return the refined chunks where fresh samples say that they are surely better."""
    both = np.stack([first, refined], axis=1)
    made = world.forecast(both, (settings.seed, settings.rounds)).cost(goal)
    mean, spread = made.cost.mean(0), made.cost.std(0)
    gain = mean[:, 0] - mean[:, 1]
    changed = (gain > MOST_SPREAD_PER_GAIN * np.hypot(*spread.T)) & world.is_familiar(both)[:, 1]
    kept = changed.astype(int)
    start, reached = np.arange(len(first)), made.reached.mean(0)
    return RefinedChunks(both[start, kept], changed, mean[:, 0], mean[start, kept], reached[:, 0], reached[start, kept])


def _check(settings: MppiSettings, planned: Array) -> None:
    """Refuse settings that mean nothing, and commands that are no numbers."""
    for name, value, least in (
        ("candidates", settings.candidates, 2),
        ("rounds", settings.rounds, 1),
    ):
        if value < least:
            raise UsageError(f"{name} is out of range", expected=f"at least {least}", found=str(value))
    if settings.noise <= 0 or settings.temperature <= 0:
        raise UsageError("noise and temperature must be above 0", found=f"{settings.noise:g}, {settings.temperature:g}")
    if not np.isfinite(planned).all():
        raise UsageError("the policy plans what is no number", expected="finite commands", found="NaN or infinite")
