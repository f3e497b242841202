"""Command chunks filtered by a forecast: one chosen at each start, or none, and what that gained in another world."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.policies import Goal, Motion
from candata.policy_evaluation.candidates import AS_PLANNED, Candidates
from candata.policy_evaluation.choice import Choice, choose
from candata.policy_evaluation.chunk_bench import ChunkBench
from candata.policy_evaluation.chunk_worlds import ChunkWorld
from candata.policy_evaluation.filter_results import ChooserResult, FilterResult, StartResult, Withheld
from candata.policy_evaluation.ranking import CONFIDENCE, DRAWS, wilson
from candata.policy_evaluation.results import Interval
from candata.scenes import Scene
from candata.statistics import resamples

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Chunks drawn at a start for random choice in the withheld world. Chosen: they leave a success share of a start
#: uncertain by a sixth, which fifty starts average out.
RANDOM_DRAWS = 8
#: Streams of a seed: of a start's random choice, and of the bootstrap over starts.
RANDOM_STREAM, BOOTSTRAP_STREAM = 1, 3


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
    choosers: Sequence[ChunkChoices],
    candidates: Candidates,
    goal: Goal,
    scene: Scene,
    withheld: ChunkWorld,
    seed: int,
) -> Withheld:
    """Return what random choice, the planned chunks and each chooser's chunks come to in a withheld world.

    Only the chunks that are compared are played: these, and some drawn at random at each start.

    Parameters
    ----------
    choosers : sequence of ChunkChoices
        Who chose.
    candidates : Candidates
        Chunks; the first is the planned one where it is called so.
    goal : Goal
        What is meant.
    scene : Scene
        For the shape of the object.
    withheld : ChunkWorld
        Where they are played.
    seed : int
        Of random choice and of the bootstrap.
    """
    rng = np.random.default_rng([seed, BOOTSTRAP_STREAM])
    commands, has_plan = candidates.commands, candidates.names[0] == AS_PLANNED
    starts, count = commands.shape[:2]
    rngs = [np.random.default_rng([seed, RANDOM_STREAM, number]) for number in withheld.starts.numbers]
    drawn = np.stack([each.integers(count, size=min(RANDOM_DRAWS, count)) for each in rngs])
    chosen = np.stack([each.candidate for each in choosers], axis=1)
    played = np.concatenate([drawn, np.maximum(chosen, 0), np.zeros((starts, int(has_plan)), int)], axis=1)
    rows = np.arange(starts)[:, None]
    success = withheld.forecast(commands[rows, played], (seed,)).succeeds(goal, scene).astype(float)
    by_chance = success[:, : drawn.shape[1]].mean(1)
    results = {
        each.world.name: _chooser_result(success[:, drawn.shape[1] + k], chosen[:, k] >= 0, by_chance, rng)
        for k, each in enumerate(choosers)
    }
    return Withheld(
        random=success_share(by_chance.sum(), starts),
        planned=success_share(success[:, -1].sum(), starts) if has_plan else None,
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
    abstained = success_share(float((~has_chosen).sum()), len(has_chosen))
    if not has_chosen.any():
        return ChooserResult(abstained=abstained)
    gains = (success - by_chance)[has_chosen]
    return ChooserResult(
        abstained=abstained,
        after=success_share(success[has_chosen].sum(), int(has_chosen.sum())),
        before=success_share(by_chance[has_chosen].sum(), int(has_chosen.sum())),
        lift=paired_lift(gains, rng),
    )


def paired_lift(gains: Array, rng: np.random.Generator) -> Interval:
    """Return the mean of gains `(n,)` of success by start, with its interval by bootstrap over the starts.

    One start tells nothing of others: its interval is all that a gain can be.
    """
    if len(gains) < 2:
        return Interval(value=float(gains.mean()), low=-1.0, high=1.0)
    means = gains[resamples(rng, len(gains), DRAWS)].mean(1)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]).tolist()
    return Interval(value=float(gains.mean()), low=low, high=high)


def success_share(count: float, total: int) -> Interval:
    """Return a share with its Wilson interval; the mean of several draws a start counts as so many successes."""
    return wilson(round(count), total).model_copy(update={"value": float(count / total)})


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


def run_filter(
    bench: ChunkBench,
    goal_name: str,
    count: int,
    noise: float,
    stage: Callable[[str], None] = lambda _name: None,
) -> tuple[FilterResult, tuple[Motion, ...]]:
    """Return what the bench's model chooses, beside the simulators where there is a withheld world, and the chunks.

    Parameters
    ----------
    bench : ChunkBench
        Starts, worlds and what may be commanded.
    goal_name : str
        What the goal is called.
    count : int
        Candidates at each start, unless they are the motions of a file.
    noise : float
        Their noise, as a share of the recorded commands' standard deviation.
    stage : callable
        Called with what is being done.

    Raises
    ------
    CandataError
        As `ChunkBench.candidates` and `choose_chunks`.
    """
    request, seed = bench.request, bench.request.seed
    stage("planning the candidates")
    candidates = bench.candidates(count, noise)
    stage(f"forecasting by {bench.model.name}")
    judge = choose_chunks(bench.model, candidates.commands, candidates.playable, request.goal, seed)
    withheld = None
    if bench.withheld is not None:
        choosers = [judge]
        for world in bench.simulators:
            stage(f"forecasting by the {world.name}")
            choosers.append(choose_chunks(world, candidates.commands, candidates.playable, request.goal, seed))
        stage("playing in the withheld world")
        withheld = withheld_result(choosers, candidates, request.goal, bench.scene, bench.withheld, seed)
    dataset = bench.starts.windows.dataset
    result = FilterResult(
        dataset=f"{dataset.name}@{dataset.digest[:12]}",
        judge=bench.model.name,
        goal=goal_name,
        candidates=len(candidates.names),
        chunk_s=bench.chunk_s,
        seed=seed,
        starts=start_results(judge, candidates.names),
        withheld=withheld,
    )
    return result, chosen_motions(judge, candidates.commands)


def chosen_motions(judge: ChunkChoices, commands: Array) -> tuple[Motion, ...]:
    """Return the chosen chunks as motions, named by their episodes; the object stands where the scene has it."""
    return tuple(
        Motion(episode, commands[start, choice.candidate], np.zeros(3))
        for start, (episode, choice) in enumerate(zip(judge.world.starts.ids, judge.choices, strict=True))
        if choice.candidate is not None
    )
