"""Chunks refined, judged in a withheld world, and a network distilled from them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from candata.policies import Goal, Motion
from candata.policies._network import SUFFIX, Network, read_network
from candata.policy_evaluation.chunk_bench import ChunkBench
from candata.policy_evaluation.chunk_worlds import ChunkWorld
from candata.policy_evaluation.distillation import chunk_rows, distilled_last_layer, distilled_network
from candata.policy_evaluation.filtering import BOOTSTRAP_STREAM, paired_lift, success_share
from candata.policy_evaluation.refine_results import RefinedSuccess, RefineResult
from candata.policy_evaluation.refinement import MppiSettings, RefinedChunks, refine_chunks
from candata.scenes import Scene
from candata.training.simulator import Simulator

Array = NDArray[np.float64]


def run_refine(
    bench: ChunkBench, goal_name: str, settings: MppiSettings, stage: Callable[[str], None] = lambda _name: None
) -> tuple[RefineResult, RefinedChunks]:
    """Return what refinement did, and the chunks as the bench's model refined them.

    Where there is a withheld world, the simulators refine the same chunks too, and all are played there.

    Raises
    ------
    CandataError
        As `ChunkBench.planned` and `refine_chunks`.
    """
    goal = bench.request.goal
    planned, previous, numbers = bench.planned(), bench.starts.previous, bench.starts.numbers
    worlds = [bench.model, *(bench.simulators if bench.withheld is not None else ())]
    refined = {
        world.name: refine_chunks(world, planned, previous, numbers, bench.bounds, goal, settings, stage)
        for world in worlds
    }
    first = refined[bench.model.name]
    withheld = None
    if bench.withheld is not None:
        stage("playing in the withheld world")
        kept = bench.bounds.kept(planned, previous)
        withheld = _withheld(bench.withheld, kept, refined, goal, bench.scene, bench.request.seed)
    dataset = bench.starts.windows.dataset
    result = RefineResult(
        dataset=f"{dataset.name}@{dataset.digest[:12]}",
        model=bench.model.name,
        goal=goal_name,
        chunk_s=bench.chunk_s,
        starts=len(planned),
        changed=int(first.changed.sum()),
        forecast_before=float(first.reached_before.mean()),
        forecast_after=float(first.reached_after.mean()),
        withheld=withheld,
    )
    return result, first


def _withheld(
    world: ChunkWorld, planned: Array, refined: dict[str, RefinedChunks], goal: Goal, scene: Scene, seed: int
) -> dict[str, RefinedSuccess]:
    """Return the success of the planned chunks and of each refinement, by who refined."""
    commands = np.stack([planned, *(each.commands for each in refined.values())], axis=1)
    success = world.forecast(commands, (seed,)).succeeds(goal, scene).astype(float)
    rng = np.random.default_rng([seed, BOOTSTRAP_STREAM])
    results = {}
    for k, (name, each) in enumerate(refined.items(), start=1):
        results[name] = RefinedSuccess(
            changed=int(each.changed.sum()),
            before=success_share(success[:, 0].sum(), len(success)),
            after=success_share(success[:, k].sum(), len(success)),
            lift=paired_lift(success[:, k] - success[:, 0], rng),
        )
    return results


def refined_network(bench: ChunkBench, commands: Array) -> Network:
    """Return a network that does what refined chunks `(S, R, A)` do: the policy's own, its last layer fitted anew.

    Where the policy is no network, it is a new one. What it would have seen is simulated, with the repair where there
    is one.

    Raises
    ------
    CandataError
        As `read_network` and `distilled_last_layer`.
    """
    world = bench.simulators[-1]
    rows = chunk_rows(world.starts, commands, cast(Simulator, world.forecaster))
    policy = bench.request.policy
    if policy.endswith(SUFFIX):
        return distilled_last_layer(read_network(Path(policy))[0], rows)
    return distilled_network(rows, bench.scene, bench.request.seed)


def refined_motions(bench: ChunkBench, refined: RefinedChunks) -> tuple[Motion, ...]:
    """Return the refined chunks as motions, named by their episodes."""
    return tuple(
        Motion(name, commands, np.zeros(3)) for name, commands in zip(bench.starts.ids, refined.commands, strict=True)
    )
