"""From a run, a dataset and options to the worlds, starts and candidates of a filter or a refinement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.errors import UsageError, Where
from candata.loaders import Normaliser, Windows
from candata.loaders.splits import group_ids
from candata.policies import Goal, read_motions, read_step_policy
from candata.policy_evaluation.candidates import Candidates, motion_candidates, noisy_candidates, policy_chunks
from candata.policy_evaluation.chunk_starts import ChunkStarts, chunk_starts
from candata.policy_evaluation.chunk_worlds import ChunkWorld, simulated_world
from candata.policy_evaluation.commands import CommandBounds, command_bounds
from candata.policy_evaluation.goals import check_held
from candata.policy_evaluation.seen import Withheld
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.training import evaluated_runs
from candata.training.episode_scenes import episode_scenes
from candata.training.evaluation import EvaluationSettings, held_out_windows, model_entrant

Array = NDArray[np.float64]
#: Names of the simulators among the worlds.
NOMINAL, REPAIRED, WITHHELD = "nominal simulator", "repaired simulator", "withheld world"


@dataclass(frozen=True)
class ChunkRequest:
    """What is to be filtered or refined.

    Attributes
    ----------
    goal : Goal
        What is meant.
    policy : str
        `recorded`: what was commanded from each start on; else `FILE.parquet` with motions that are the candidates,
        or what `read_step_policy` takes.
    starts : int
        Most episodes of the test split.
    at_s : float or None
        Time of each start in its episode [s]; by default the first row with a whole history.
    chunk_s : float or None
        Length of a chunk [s]; by default the model's horizon.
    samples, steps : int
        Samples of a forecast, and steps of its sampler.
    seed : int
        Of everything that is drawn.
    scene : str or None
        Scene of the simulators; by default the one that the episodes name.
    effects : tuple of EffectSetting or None
        Effects of the repaired simulator; None leaves it out.
    withheld : Withheld or None
        The withheld world; None leaves it out.
    """

    goal: Goal
    policy: str = "recorded"
    starts: int = 50
    at_s: float | None = None
    chunk_s: float | None = None
    samples: int = 8
    steps: int = 4
    seed: int = 0
    scene: str | None = None
    effects: tuple[EffectSetting, ...] | None = None
    withheld: Withheld | None = None


@dataclass(frozen=True, eq=False)
class ChunkBench:
    """Starts, worlds and what may be commanded.

    Attributes
    ----------
    request : ChunkRequest
        What was asked for.
    scene : Scene
        Nominal scene.
    starts : ChunkStarts
        At the model's rate.
    bounds : CommandBounds
        What may be commanded.
    rows : int
        Control steps of a chunk.
    model : ChunkWorld
        The trained model.
    simulators : tuple of ChunkWorld
        The nominal simulator, and the repaired one where effects were given.
    withheld : ChunkWorld or None
        Where choices are judged.
    """

    request: ChunkRequest
    scene: Scene
    starts: ChunkStarts
    bounds: CommandBounds
    rows: int
    model: ChunkWorld
    simulators: tuple[ChunkWorld, ...]
    withheld: ChunkWorld | None

    @property
    def chunk_s(self) -> float:
        """Length of a chunk [s]."""
        return self.rows / self.bounds.rate_hz

    def planned(self) -> Array:
        """Return what the policy does `(S, R, A)` from each start on.

        Raises
        ------
        UsageError
            When the policy is a file of motions: they are candidates, and none of them is the plan.
        CandataError
            As `read_step_policy` and `policy_chunks`.
        """
        policy = self.request.policy
        if policy == "recorded":
            return self.starts.recorded(self.rows)
        if policy.endswith(".parquet"):
            raise UsageError("motions of a file are candidates, no policy", expected="recorded, or a policy")
        return policy_chunks(read_step_policy(policy), self.scene, self.starts, self.rows, self.request.seed)

    def candidates(self, count: int, noise: float) -> Candidates:
        """Return the candidates: of a file of motions these, else the planned chunks with noise.

        Raises
        ------
        CandataError
            As `motion_candidates`, `noisy_candidates` and `planned`.
        """
        policy = self.request.policy
        if policy.endswith(".parquet"):
            motions = read_motions(policy, self.scene).motions
            return motion_candidates(motions, self.starts, self.bounds, self.rows)
        return noisy_candidates(self.planned(), self.starts, self.bounds, count, noise, self.request.seed)


def chunk_bench(
    run: Path, dataset: Dataset, request: ChunkRequest, stage: Callable[[str], None] = lambda _name: None
) -> ChunkBench:
    """Return the bench of a trained model on the test episodes of its split.

    Raises
    ------
    UsageError
        When the run is of another hand, has seen the test episodes, reads no planned commands, or its horizon is
        shorter than the chunk; when the episodes are not of one scene.
    DataError
        When no episode has a start.
    CandataError
        As `candata.training.evaluate`.
    """
    for option, value in (("--at", request.at_s), ("--chunk", request.chunk_s)):
        if value is not None and not np.isfinite(value):
            raise UsageError(f"{option} is no time", expected="seconds", found=f"{value:g}")
    settings = EvaluationSettings(samples=request.samples, steps=request.steps, seed=request.seed)
    evaluated = evaluated_runs.read_runs([run], None)
    (judge,) = evaluated
    if not judge.run.config.get("planned_actions", False):
        raise UsageError(
            f"{judge.name} does not read the planned commands",
            expected="a model that was trained with planned_actions",
            found=judge.run.model,
            where=Where(path=str(run)),
            fix="to it all chunks are alike; train one with --config planned_actions=true",
        )
    split, _ = evaluated_runs.split_of(evaluated, dataset)
    ids = group_ids(dataset, split, settings.group)
    evaluated_runs.refuse_seen(judge, evaluated_runs.seen_ids(judge, dataset, split, ids) or (), settings.group)
    evaluated_runs.check_scaled(evaluated, dataset, ids)
    stage("reading the dataset")
    held_out = held_out_windows(dataset, split, evaluated, settings)
    entrant = model_entrant(judge, held_out, settings)
    scene = _one_scene(held_out, request.scene)
    starts = chunk_starts(entrant.windows, request.starts, request.at_s)
    stride = int(starts.windows.stride[starts.windows.owner[0]])
    horizon_s = starts.windows.horizon / starts.windows.rate_hz
    chunk_s = horizon_s if request.chunk_s is None else request.chunk_s
    rows = round(chunk_s * starts.windows.rate_hz * stride)
    if rows < 2 or chunk_s > horizon_s + 1e-9:
        raise UsageError(
            f"a chunk is longer than {judge.name} can roll" if rows >= 2 else "a chunk is too short",
            expected=f"at most {horizon_s:g} s" if rows >= 2 else "at least two control steps",
            found=f"{chunk_s:g} s",
            fix="give another --chunk, or train a model with a longer --horizon",
        )
    check_held(request.goal, chunk_s)
    normaliser = Normaliser.model_validate(judge.run.normaliser)
    simulated = {NOMINAL: ()} | ({} if request.effects is None else {REPAIRED: request.effects})
    worlds = [simulated_world(name, starts, rows, request.scene, effects) for name, effects in simulated.items()]
    withheld = None
    if request.withheld is not None:
        request.withheld.check(scene)
        withheld = simulated_world(WITHHELD, starts, rows, request.scene, request.withheld.effects)
    model = ChunkWorld(judge.name, entrant.forecaster, starts, normaliser)
    return ChunkBench(request, scene, starts, command_bounds(scene, held_out), rows, model, tuple(worlds), withheld)


def _one_scene(windows: Windows, scene: str | None) -> Scene:
    """Return the scene of all episodes."""
    scenes = list(episode_scenes(windows, scene).scenes.values())
    if len(scenes) > 1:
        raise UsageError(
            "the test episodes play in several scenes",
            expected="one scene and object",
            found=", ".join(each.name for each in scenes),
            fix="filter the dataset by scene first: candata registry filter",
        )
    return scenes[0]
