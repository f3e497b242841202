"""`candata diagnose`: where recordings and simulator differ, which effect causes it, how far the gap shrinks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from collections.abc import Callable

    from candata.datasets import Dataset
    from candata.gap import Diagnosis
    from candata.reports import ReportContext
    from candata.scenes import Scene

VERDICTS = (
    "no_gap",
    "explained",
    "partly_explained",
    "ambiguous",
    "unknown_effect",
    "too_little_data",
    "out_of_budget",
)


EXAMPLES = """\b
Examples:
  candata diagnose real --scene scene.yaml --out out/diagnosis
  candata diagnose today --against yesterday --scene scene.yaml --out out/change
"""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog=EXAMPLES)(diagnose)


GivenEffects = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Effects that the nominal simulator holds already: an effects.yaml."),
]
Against = Annotated[
    str | None,
    typer.Option(
        metavar="DATASET",
        help="Say what changed since these recordings: what the simulator leaves open in them is no news.",
    ),
]
Edit = Annotated[
    str | None, typer.Option(help="Recordings of another object or task: is the shrinkage kept, nothing refitted?")
]
Run = Annotated[
    Path | None,
    typer.Option("--run", metavar="RUN", help="Say too how far this trained model closes the gap (candata train)."),
]
BudgetS = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Give the best answer so far after so many CPU seconds: out_of_budget."),
]
Keep = Annotated[
    bool,
    typer.Option("--cache/--no-cache", help="Keep what was simulated for the next diagnosis of these recordings."),
]
CacheDir = Annotated[
    Path | None,
    typer.Option(help="Where that is kept (default: the user's cache); see candata gap signatures."),
]

SharedSignatures = Annotated[
    bool,
    typer.Option("--shared-signatures", help="Take what candata gap signatures simulated for the same commands."),
]


@console.stoppable()
def diagnose(
    dataset: Annotated[str, typer.Argument(help="Dataset of recordings: its folder or registered name.")],
    scene: Annotated[str, typer.Option(help="Nominal simulator: a scene.yaml or a built-in scene.")],
    out: Annotated[Path, typer.Option(help="Folder for report.json, report.html and effects.yaml.")],
    version: Annotated[str | None, typer.Option(help="Version of the dataset (default: the newest).")] = None,
    effects: GivenEffects = None,
    jobs: Annotated[int, typer.Option(min=1, help="Threads; the result does not depend on it.")] = os.cpu_count() or 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of folds, null replays and resamples.")] = 0,
    fail_on: Annotated[
        str, typer.Option(help=f"Exit 1 on these verdicts, comma separated: {', '.join(VERDICTS)}.")
    ] = "",
    against: Against = None,
    edit: Edit = None,
    run: Run = None,
    edit_scene: Annotated[str | None, typer.Option(help="Nominal simulator of --edit (default: --scene).")] = None,
    only: Annotated[
        str, typer.Option(help="Effects to search among, comma separated (default: all that can act).")
    ] = "",
    budget: BudgetS = None,
    keep: Keep = True,
    cache_dir: CacheDir = None,
    shared_signatures: SharedSignatures = False,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Say where recordings and simulator differ, which effect causes it, and how far it shrinks."""
    failing_verdicts, names = _verdicts(fail_on), console.words(only)
    _refuse_pairs(edit, edit_scene, against, cache_dir, keep, run, effects, shared_signatures)
    cache = _try_outputs(out, cache_dir, keep)
    from candata.gap import diagnose as find
    from candata.reports import report_context, summary

    world = _nominal(scene, effects)
    edit_data = None if edit is None else _edit_data(edit, edit_scene, world, effects)
    with console.stoppable(_kept_words(cache), goes_on=keep), console.stages(with_bar=True) as stage:
        data = console.open_named(dataset, version)
        _check_run(run, data)
        diagnosis = find(
            data,
            world,
            jobs=jobs,
            seed=seed,
            cache=cache,
            only=names,
            against=None if against is None else console.open_named(against),
            budget=budget,
            shared_signatures=shared_signatures,
            progress=stage,
            ends=stage.ends,
        )
        stage.ends(None)
        context = report_context(diagnosis, world, out)
        page = _write_report(diagnosis, world, context, stage)
    if edit_data is not None or run is not None:
        with console.stoppable(f"the report without --edit and --run stands in {out}"), console.stages() as stage:
            diagnosis = diagnosis if edit_data is None else _with_edit_test(diagnosis, *edit_data, jobs, seed, stage)
            diagnosis = diagnosis if run is None else _with_model(diagnosis, run, data, scene, stage)
            page = _write_report(diagnosis, world, context, stage)
    console.out(diagnosis.report.model_dump_json(indent=2) if json else summary(diagnosis.report, context))
    console.note(f"report: {page}")
    if diagnosis.report.verdict in failing_verdicts:
        raise typer.Exit(1)


def _kept_words(cache: Path | None) -> str:
    """Return where what was simulated is kept, in words."""
    return f"what was simulated is kept in {cache}" if cache else "nothing is kept"


def _nominal(name: str, effects: Path | None) -> Scene:
    """Return the scene of a name or file with the effects of a file as part of it."""
    from candata.effects import read_effects
    from candata.scenes import load_scene
    from candata.simulate import with_effects
    from candata_cli.effects_option import note_other_scene

    scene = load_scene(name)
    if effects is None:
        return scene
    effects_file = read_effects(effects)
    note_other_scene(effects_file, effects, scene.digest)
    return with_effects(scene, effects_file.effects)


def _refuse_pairs(
    edit: str | None,
    edit_scene: str | None,
    against: str | None,
    cache_dir: Path | None,
    keep: bool,
    run: Path | None,
    effects: Path | None,
    shared_signatures: bool,
) -> None:
    """Refuse options that mean nothing without, or with, another."""
    from candata.errors import UsageError

    if edit is not None and against is not None:
        raise UsageError("--edit with --against", expected="one of them", fix="test the repair without --against")
    if edit_scene is not None and edit is None:
        raise UsageError("--edit-scene without --edit", expected="--edit DATASET")
    if run is not None and (against is not None or effects is not None):
        raise UsageError("--run with --against or --effects", expected="one of them", fix="leave --run out")
    if cache_dir is not None and not keep:
        raise UsageError("--cache-dir with --no-cache", expected="one of them")
    if shared_signatures and not keep:
        raise UsageError("--shared-signatures with --no-cache", expected="one of them")


def _try_outputs(out: Path, cache_dir: Path | None, keep: bool) -> Path | None:
    """Return the folder of what is kept, None for none, once that and the report's are tried."""
    from candata.user_folders import user_cache

    check_output(out, "folder")
    if cache_dir is not None:
        check_output(cache_dir, "folder", "--cache-dir")
    return (cache_dir or user_cache()) if keep else None


def _write_report(diagnosis: Diagnosis, scene: Scene, context: ReportContext, stage: Callable[[str], None]) -> Path:
    """Return the page of a report after writing its files."""
    from candata.reports import write_diagnosis

    stage("writing the report")
    return write_diagnosis(diagnosis, scene, context.folder, context)


def _verdicts(text: str) -> tuple[str, ...]:
    """Return the verdicts of a comma-separated list, each a known one."""
    from candata.errors import UnknownNameError

    for word in console.words(text):
        if word not in VERDICTS:
            raise UnknownNameError("verdict", word, VERDICTS)
    return console.words(text)


def _check_run(run: Path | None, dataset: Dataset) -> None:
    """Refuse a run that cannot be compared, before the long work begins."""
    if run is None:
        return
    from candata.experiment.learned import check_run
    from candata_cli.torch_options import need_torch

    need_torch()
    check_run(run, dataset)


def _with_model(
    diagnosis: Diagnosis, run: Path, dataset: Dataset, scene: str, stage: Callable[[str], None]
) -> Diagnosis:
    """Return the diagnosis with a trained model beside its repair; its report stands already, should this fail."""
    from dataclasses import replace

    from candata.experiment.learned import learned_model

    learned = learned_model(run, dataset, scene, tuple(diagnosis.named), stage)
    return replace(diagnosis, report=diagnosis.report.model_copy(update={"learned": learned}))


def _edit_data(edit: str, edit_scene: str | None, world: Scene, effects: Path | None) -> tuple[Dataset, Scene]:
    """Return recordings of an edit test and their scene; what does not fit is refused before the long work begins."""
    from candata.gap.verdict.edit_test import readable

    scene = _nominal(edit_scene, effects) if edit_scene else world
    dataset = console.open_named(edit)
    readable(dataset, scene)
    return dataset, scene


def _with_edit_test(
    diagnosis: Diagnosis, dataset: Dataset, scene: Scene, jobs: int, seed: int, stage: Callable[[str], None]
) -> Diagnosis:
    """Return the diagnosis with its edit test, where it names effects; its report stands already, should this fail."""
    from dataclasses import replace

    from candata.gap.verdict.edit_test import edit_test

    if not diagnosis.named:
        console.note("no effect is named, so there is nothing to test on --edit")
        return diagnosis
    size = diagnosis.report.gap
    reference = size.closed if size is not None and size.closed is not None else 1.0
    test = edit_test(dataset, scene, diagnosis.named, reference=reference, jobs=jobs, seed=seed, progress=stage)
    return replace(diagnosis, report=diagnosis.report.model_copy(update={"edit": test}))
