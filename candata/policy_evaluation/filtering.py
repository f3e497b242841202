"""Command chunks filtered by a forecast: one chosen at each start, or none, and what that gained in another world."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from candata.policies import Goal
from candata.policy_evaluation.choice import Choice, choose
from candata.policy_evaluation.chunk_worlds import ChunkWorld
from candata.policy_evaluation.filter_results import ChooserResult, StartResult, Withheld
from candata.scenes import Scene
from candata.statistics import resamples
from candata.training.results import Success

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Chunks drawn at a start for random choice in the withheld world, and bootstrap samples of a difference. Chosen: the
#: first leaves a success share of a start uncertain by a sixth, which fifty starts average out.
RANDOM_DRAWS, DRAWS = 8, 2000


@dataclass(frozen=True, eq=False)
class ChunkChoices:
    """What one forecaster chose.

    Attributes
    ----------
    world : ChunkWorld
        Who forecast.
    choices : tuple of Choice
        One a start.
    reached : (S, N) float64
        Share of each chunk's samples that reach the goal.
    """

    world: ChunkWorld
    choices: tuple[Choice, ...]
    reached: Array

    @property
    def candidate(self) -> NDArray[np.int64]:
        """`(S,)` number of the chunk chosen at each start, -1 where nothing was."""
        return np.array([-1 if c.candidate is None else c.candidate for c in self.choices], np.int64)


def choose_chunks(world: ChunkWorld, commands: Array, playable: Flags, goal: Goal, seed: int) -> ChunkChoices:
    """Return what a world chooses of chunks `(S, N, R, A)`, of which `playable (S, N)` may be played.

    Raises
    ------
    UsageError
        When the chunks are longer than what the world can roll, or the goal has no cost.
    """
    cost = world.forecast(commands, (seed,)).cost(goal)
    choices = choose(cost, playable & world.is_familiar(commands))
    return ChunkChoices(world, choices, cost.reached.mean(0))


def withheld_result(
    choosers: Sequence[ChunkChoices], commands: Array, goal: Goal, scene: Scene, withheld: ChunkWorld, seed: int
) -> Withheld:
    """Return what random choice and each chooser's chunks come to in a withheld world.

    Only the chunks that are compared are played: those chosen, and some drawn at random at each start.

    Parameters
    ----------
    choosers : sequence of ChunkChoices
        Who chose.
    commands : (S, N, R, A) float64
        Chunks.
    goal : Goal
        What is meant.
    scene : Scene
        For the shape of the object.
    withheld : ChunkWorld
        Where they are played.
    seed : int
        Of random choice and of the bootstrap.
    """
    rng = np.random.default_rng([seed, 1])
    starts, count = commands.shape[:2]
    drawn = rng.integers(count, size=(starts, min(RANDOM_DRAWS, count)))
    chosen = np.stack([each.candidate for each in choosers], axis=1)
    played = np.concatenate([drawn, np.maximum(chosen, 0)], axis=1)
    rows = np.arange(starts)[:, None]
    success = withheld.forecast(commands[rows, played], (seed,)).succeeds(goal, scene).astype(float)
    by_chance = success[:, : drawn.shape[1]].mean(1)
    results = {
        each.world.name: _chooser_result(success[:, drawn.shape[1] + k], chosen[:, k] >= 0, by_chance, rng)
        for k, each in enumerate(choosers)
    }
    return Withheld(
        random=_share(by_chance.sum(), starts),
        choosers=results,
        success={
            each.world.name: _flags(success[:, drawn.shape[1] + k], chosen[:, k]) for k, each in enumerate(choosers)
        },
    )


def _flags(success: Array, chosen: NDArray[np.int64]) -> tuple[bool | None, ...]:
    """Return whether each start's chosen chunk succeeded; None where nothing was chosen."""
    return tuple(None if c < 0 else bool(s) for s, c in zip(success, chosen.tolist(), strict=True))


def _chooser_result(success: Array, has_chosen: Flags, by_chance: Array, rng: np.random.Generator) -> ChooserResult:
    """Return what one chooser came to where it chose, beside random choice at the same starts."""
    abstained = _share(float((~has_chosen).sum()), len(has_chosen))
    if not has_chosen.any():
        return ChooserResult(abstained=abstained)
    gains = (success - by_chance)[has_chosen]
    means = gains[resamples(rng, len(gains), DRAWS)].mean(1)
    low, high = np.quantile(means, [0.025, 0.975]).tolist()
    return ChooserResult(
        abstained=abstained,
        after=_share(success[has_chosen].sum(), int(has_chosen.sum())),
        before=_share(by_chance[has_chosen].sum(), int(has_chosen.sum())),
        lift=float(gains.mean()),
        lift_low=low,
        lift_high=high,
    )


def _share(count: float, total: int) -> Success:
    """Return a share with its 95 % Wilson interval; the mean of several draws a start counts as so many successes."""
    low, high = map(float, binomtest(round(count), total).proportion_ci(0.95, "wilson"))
    return Success(count=round(count), total=total, share=float(count / total), low=low, high=high)


def start_results(judge: ChunkChoices, names: Sequence[str]) -> tuple[StartResult, ...]:
    """Return what the judge chose at each start, in words and numbers; `names` are those of the chunks."""
    return tuple(
        StartResult(
            id=episode,
            candidate=None if choice.candidate is None else names[choice.candidate],
            reason=choice.reason,
            gain=choice.gain,
            spread=choice.spread,
            forecast_before=float(reached.mean()),
            forecast_after=None if choice.candidate is None else float(reached[choice.candidate]),
        )
        for episode, choice, reached in zip(judge.world.starts.ids, judge.choices, judge.reached, strict=True)
    )


def filter_chunks(
    worlds: Sequence[ChunkWorld],
    commands: Array,
    playable: Flags,
    goal: Goal,
    seed: int,
    stage: Callable[[str], None] = lambda _name: None,
) -> tuple[ChunkChoices, ...]:
    """Return what each world chooses of the same chunks `(S, N, R, A)`; the first one is the judge.

    Raises
    ------
    UsageError
        As `choose_chunks`.
    """
    choices = []
    for world in worlds:
        stage(f"forecasting by {world.name}")
        choices.append(choose_chunks(world, commands, playable, goal, seed))
    return tuple(choices)
