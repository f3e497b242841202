"""The command `evaluate`: models, simulators and baselines on held-out episodes, one page for all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli import console
from candata_cli.effects_option import note_other_scene
from candata_cli.outputs import check_output
from candata_cli.torch_options import Device, Threads, need_torch, set_threads

if TYPE_CHECKING:
    from candata.datasets import Dataset
    from candata.schema.effect import EffectsFile

Targets = Annotated[
    list[Path],
    typer.Argument(
        metavar="[RUN...] DATASET",
        help="Folders of runs (their best checkpoints) or checkpoints, then the dataset: folder or registered name.",
    ),
]
Scene = Annotated[
    str | None,
    typer.Option(
        "--scene", metavar="SCENE", help="Simulators play this scene: a name or scene.yaml; else the episodes'."
    ),
]
Effects = Annotated[
    Path | None, typer.Option("--effects", metavar="FILE", help="Adds the simulator with this effects.yaml.")
]
Simulator = Annotated[
    bool | None,
    typer.Option("--simulator/--no-simulator", help="The nominal simulator; by default where a scene is known."),
]
Baselines = Annotated[bool, typer.Option("--baselines/--no-baselines", help="stays and keeps_velocity.")]
Joints = Annotated[
    str, typer.Option("--joints", help="recorded, servo (a lag fitted on training episodes) or simulator.")
]


def register(app: typer.Typer) -> None:
    """Add `evaluate`."""
    app.command(
        epilog="Examples: candata evaluate runs/first sim; "
        "candata evaluate runs/first runs/second real --scene scene.yaml --effects effects.yaml --out out/evaluation"
    )(evaluate)


@console.stoppable()
def evaluate(
    targets: Targets,
    split: Annotated[str, typer.Option("--split", help="train, val or test of the runs' split, or all.")] = "test",
    scene: Scene = None,
    effects: Effects = None,
    simulator: Simulator = None,
    baselines: Baselines = True,
    joints: Joints = "recorded",
    samples: Annotated[int, typer.Option("--samples", min=1, help="Samples averaged.")] = 16,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Steps of the sampler.")] = 10,
    execute: Annotated[
        int | None, typer.Option("--execute", min=1, help="Steps before the next forecast: 8, or the horizon.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the noise.")] = 0,
    history: Annotated[int | None, typer.Option("--history", min=1, help="Without a run: rows of the past, 8.")] = None,
    horizon: Annotated[
        int | None, typer.Option("--horizon", min=1, help="Without a run: steps to forecast, 16.")
    ] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate-hz", help="Without a run: rate of the steps, 10.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for the page; by default RUN/evaluation of the first run, or ./evaluation."),
    ] = None,
    device: Device = "cpu",
    threads: Threads = None,
    version: Annotated[
        str | None, typer.Option("--version", help="Version of the dataset (default: the newest).")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Score models on held-out episodes beside the simulator and plain baselines, all on one page.

    Forecasts from each window, and closed loops over whole episodes in which each sees its own poses; actions are
    replayed. Writes evaluation.json and evaluation.html.
    """
    *run_paths, data = targets
    folder = out or _default_folder(run_paths)
    check_output(folder, "folder")
    need_torch()
    from candata.reports.evaluation import summary, write_evaluation
    from candata.reports.evaluation_film import films
    from candata.training import EvaluationSettings
    from candata.training import evaluate as judge

    set_threads(threads)
    effects_file = _effects(effects)
    others: dict[str, Any] = {"baselines": baselines, "simulator": simulator, "joints": joints, "threads": threads or 1}
    shape = {"history": history, "horizon": horizon, "rate_hz": rate_hz}
    others["shape"] = {name: value for name, value in shape.items() if value is not None} or None
    repair = effects_file.effects if effects_file else None
    with console.stages() as stage:
        dataset = console.open_named(str(data), version)
        scene_name = scene or _repaired_scene(effects_file, effects, dataset)
        settings = EvaluationSettings(
            split, samples, steps, execute, seed, device, scene=scene_name, effects=repair, **others
        )
        evaluation, tracks = judge(run_paths, dataset, settings, stage)
        stage("drawing the episodes")
        page = write_evaluation(evaluation, tracks, folder, films(evaluation, dataset, tracks))
    if scene:
        _note_other_scene(effects_file, effects, scene)
    console.out(evaluation.model_dump_json(indent=2) if json else summary(evaluation))
    console.note(f"page: {page}")


def _default_folder(run_paths: list[Path]) -> Path:
    """Return where the page goes when no folder is named."""
    if not run_paths:
        return Path("evaluation")
    first = run_paths[0]
    return (first if first.is_dir() else first.parent) / "evaluation"


def _effects(path: Path | None) -> EffectsFile | None:
    """Return the repair that a file holds."""
    if path is None:
        return None
    from candata.effects import read_effects

    return read_effects(path)


def _repaired_scene(effects_file: EffectsFile | None, path: Path | None, dataset: Dataset) -> str | None:
    """Return the scene that the repair was made for; None where it names none, or all episodes name their own."""
    if effects_file is None or path is None or effects_file.scene is None:
        return None
    if None not in dataset.catalog(["scene"])["scene"].to_pylist():
        return None
    from candata.effects import scene_of

    return scene_of(effects_file, path)


def _note_other_scene(effects_file: EffectsFile | None, path: Path | None, scene: str) -> None:
    """Say that the repair was made for another scene than the one it is played in."""
    if effects_file is None or path is None:
        return
    from candata.scenes import load_scene

    note_other_scene(effects_file, path, load_scene(scene).digest)
