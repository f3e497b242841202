"""The commands `policy filter` and `policy refine`: command chunks chosen, and mended, by what a model forecasts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output
from candata_cli.torch_options import Threads, need_torch, set_threads

if TYPE_CHECKING:
    from candata.policy_evaluation.chunk_bench import ChunkRequest
    from candata.policy_evaluation.seen import Withheld
    from candata.schema.effect import EffectSetting

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run (its best checkpoint), or a checkpoint.")]
Data = Annotated[str, typer.Argument(metavar="DATASET", help="Folder or registered name; its test episodes are used.")]
GoalName = Annotated[str, typer.Option("--goal", help="lift[:m[,s]], place:x,y (m), turn[:rad] or topple.")]
Policy = Annotated[
    str,
    typer.Option(
        "--policy", metavar="NAME|FILE", help="recorded, FILE.safetensors, FILE.py:function or package.module:function."
    ),
]
Starts = Annotated[int, typer.Option("--starts", min=1, help="Most test episodes.")]
At = Annotated[
    float | None, typer.Option("--at", metavar="S", help="Start in each episode; the first whole history by default.")
]
Chunk = Annotated[float | None, typer.Option("--chunk", metavar="S", help="Length; the model's horizon by default.")]
Candidates = Annotated[int, typer.Option("--candidates", min=2, help="Chunks at each start.")]
Noise = Annotated[
    float, typer.Option("--noise", min=0.0, help="Of the candidates, as a share of the recorded commands' spread.")
]
Samples = Annotated[int, typer.Option("--samples", min=1, help="Samples of each forecast.")]
Steps = Annotated[int, typer.Option("--steps", min=1, help="Steps of the sampler.")]
SceneName = Annotated[
    str | None, typer.Option("--scene", metavar="SCENE", help="Of the simulators; else the episodes'.")
]
Effects = Annotated[
    Path | None,
    typer.Option("--effects", metavar="FILE", help="The repaired simulator takes part, in the world of --withheld."),
]
WithheldFile = Annotated[
    Path | None,
    typer.Option(
        "--withheld", metavar="FILE", help="World in which choices are judged: an effects.yaml, or a seal.json."
    ),
]
ChosenFile = Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Chosen chunks as a .parquet.")]
PolicyFile = Annotated[
    Path | None, typer.Option("--out", metavar="FILE", help="A policy that does so: a .safetensors and its card.")
]
ChunksFile = Annotated[Path | None, typer.Option("--chunks", metavar="FILE", help="Refined chunks as a .parquet.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Of all that is drawn.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def register(app: typer.Typer) -> None:
    """Add `policy filter` and `policy refine`."""
    policy = console.group(app, "policy", console.POLICY)
    policy.command(
        "filter",
        epilog="Example: candata policy filter runs/first real --goal lift --candidates 64 --out chosen.parquet",
    )(filter_commands)
    policy.command(
        "refine",
        epilog="Example: candata policy refine runs/first real --goal lift --policy grasp.safetensors "
        "--out refined.safetensors",
    )(refine_commands)


@console.stoppable()
def filter_commands(
    run: RunPath,
    data: Data,
    goal: GoalName = "lift",
    policy: Policy = "recorded",
    starts: Starts = 50,
    at: At = None,
    chunk: Chunk = None,
    candidates: Candidates = 64,
    noise: Noise = 0.3,
    samples: Samples = 8,
    steps: Steps = 4,
    scene: SceneName = None,
    effects: Effects = None,
    withheld: WithheldFile = None,
    out: ChosenFile = None,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Choose one of several command chunks at each start by what a model forecasts, or abstain.

    `--policy` may be a .parquet of motions: these are the candidates then. With `--withheld` the choices of the model
    and of the simulators are played in that world, beside random choice.
    """
    _check_file(out, ".parquet", "--out")
    _check_used(effects, withheld is not None, "--withheld, the world in which its choices are judged")
    need_torch()
    set_threads(threads)
    from candata.policies import write_motions
    from candata.policy_evaluation.chunk_bench import chunk_bench
    from candata.policy_evaluation.filter_results import filter_text
    from candata.policy_evaluation.filtering import run_filter

    request = _request(goal, policy, starts, at, chunk, samples, steps, seed, scene, effects, withheld)
    with console.stages() as stage:
        bench = chunk_bench(run, console.open_named(data), request, stage)
        result, motions = run_filter(bench, goal, candidates, noise, stage)
    if out is not None:
        chosen = write_motions(out, bench.scene, motions) if motions else "none, nothing is written"
        console.note(f"chosen chunks: {chosen}")
    console.out(result.model_dump_json(indent=2) if json else filter_text(result))


@console.stoppable()
def refine_commands(
    run: RunPath,
    data: Data,
    goal: GoalName = "lift",
    policy: Policy = "recorded",
    starts: Starts = 50,
    at: At = None,
    chunk: Chunk = None,
    candidates: Candidates = 64,
    rounds: Annotated[int, typer.Option("--rounds", min=1, help="Rounds of sampling.")] = 4,
    noise: Noise = 0.3,
    samples: Samples = 8,
    steps: Steps = 4,
    scene: SceneName = None,
    effects: Effects = None,
    withheld: WithheldFile = None,
    out: PolicyFile = None,
    chunks: ChunksFile = None,
    seed: Seed = 0,
    threads: Threads = None,
    json: Json = False,
) -> None:
    """Refine the command chunk at each start by what a model forecasts (MPPI), and distil a policy from the chunks.

    A chunk is changed only where the model is sure that it gets better. `--out` plays by `candata generate-sim
    --policy-module FILE.safetensors`. With `--withheld` the chunks are played in that world, beside those that the
    simulators refine.
    """
    _check_file(out, ".safetensors", "--out")
    _check_file(out and out.with_suffix(".json"), ".json", "--out")
    _check_file(chunks, ".parquet", "--chunks")
    needs = "--withheld, the world in which its chunks are judged, or --out, whose policy learns from it"
    _check_used(effects, withheld is not None or out is not None, needs)
    need_torch()
    set_threads(threads)
    from candata.policies import write_motions
    from candata.policy_evaluation.chunk_bench import chunk_bench
    from candata.policy_evaluation.distillation import write_network
    from candata.policy_evaluation.refine_results import refine_text
    from candata.policy_evaluation.refinement import MppiSettings
    from candata.policy_evaluation.refining import refined_motions, refined_network, run_refine

    request = _request(goal, policy, starts, at, chunk, samples, steps, seed, scene, effects, withheld)
    with console.stages() as stage:
        bench = chunk_bench(run, console.open_named(data), request, stage)
        settings = MppiSettings(candidates=candidates, rounds=rounds, noise=noise, seed=seed)
        result, refined = run_refine(bench, goal, settings, stage)
        if out is not None:
            stage("distilling a policy")
            write_network(out, refined_network(bench, refined.commands))
    if out is not None:
        console.note(f"policy: {out}")
    if chunks is not None:
        console.note(f"refined chunks: {write_motions(chunks, bench.scene, refined_motions(bench, refined))}")
    console.out(result.model_dump_json(indent=2) if json else refine_text(result))


def _check_file(path: Path | None, suffix: str, option: str) -> None:
    """Refuse a file that cannot be written, or has another suffix, before anything is computed."""
    if path is None:
        return
    if path.suffix.lower() != suffix:
        from candata.errors import UsageError

        raise UsageError(f"{option} {path.name} has another suffix", expected=f"a {suffix} file")
    check_output(path, "file", option)


def _check_used(effects: Path | None, is_used: bool, expected: str) -> None:
    """Refuse a repaired simulator that would change nothing."""
    if effects is not None and not is_used:
        from candata.errors import UsageError

        raise UsageError(
            "the repaired simulator has nothing to do",
            expected=expected,
            found=f"--effects {effects} alone",
            fix="add it, or leave --effects out",
        )


def _request(
    goal: str,
    policy: str,
    starts: int,
    at_s: float | None,
    chunk_s: float | None,
    samples: int,
    steps: int,
    seed: int,
    scene: str | None,
    effects: Path | None,
    withheld: Path | None,
) -> ChunkRequest:
    """Return what both commands ask for."""
    from candata.policy_evaluation.chunk_bench import ChunkRequest
    from candata.policy_evaluation.goals import parsed_goal

    meant = parsed_goal(goal)
    worlds = _effects(effects), _withheld(withheld)
    return ChunkRequest(meant, policy, starts, at_s, chunk_s, samples, steps, seed, scene, *worlds)


def _effects(path: Path | None) -> tuple[EffectSetting, ...] | None:
    """Return the effects of a file; None without one."""
    if path is None:
        return None
    from candata.effects import read_effects

    return tuple(read_effects(path).effects)


def _withheld(path: Path | None) -> Withheld | None:
    """Return the world in which choices are judged; None without a file."""
    if path is None:
        return None
    from candata.policy_evaluation.seen import withheld_effects

    return withheld_effects(path)
