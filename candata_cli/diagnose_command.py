"""`candata diagnose`: where recordings and simulator differ, which effect causes it, how far the gap shrinks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable

    from candata.datasets import Dataset
    from candata.gap import Diagnosis
    from candata.scenes import Scene

VERDICTS = ("no_gap", "explained", "partly_explained", "ambiguous", "unknown_effect", "too_little_data")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog="Example: candata diagnose real --scene scene.yaml --out out/diagnosis")(diagnose)


def diagnose(
    dataset: Annotated[str, typer.Argument(help="Dataset of recordings: its folder or registered name.")],
    scene: Annotated[str, typer.Option(help="Nominal simulator: a scene.yaml or a built-in scene.")],
    out: Annotated[Path, typer.Option(help="Folder for report.json, report.html and effects.yaml.")],
    version: Annotated[str | None, typer.Option(help="Version of the dataset (default: the newest).")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Threads; the result does not depend on it.")] = os.cpu_count() or 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of folds, null replays and resamples.")] = 0,
    fail_on: Annotated[
        str, typer.Option(help=f"Exit 1 on these verdicts, comma separated: {', '.join(VERDICTS)}.")
    ] = "",
    edit: Annotated[
        str | None, typer.Option(help="Recordings of another object or task: is the shrinkage kept, nothing refitted?")
    ] = None,
    edit_scene: Annotated[str | None, typer.Option(help="Nominal simulator of --edit (default: --scene).")] = None,
    only: Annotated[
        str, typer.Option(help="Effects to search among, comma separated (default: all that can act).")
    ] = "",
    budget: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Stop without a verdict after so many CPU seconds.")
    ] = None,
    keep: Annotated[
        bool,
        typer.Option("--cache/--no-cache", help="Keep what was simulated for the next diagnosis of these recordings."),
    ] = True,
    cache_dir: Annotated[
        Path | None,
        typer.Option(help="Where that is kept (default: the user's cache); see candata gap signatures."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Say where recordings and simulator differ, which effect causes it, and how far it shrinks."""
    from candata.datasets.durable import user_cache
    from candata.errors import UsageError
    from candata.gap import diagnose as run
    from candata.reports import summary, write_diagnosis
    from candata.scenes import load_scene
    from candata_cli import console

    refused, names = _verdicts(fail_on), console.words(only)
    if out.is_file():
        raise UsageError(f"--out {out} is a file", expected="a folder", found="a file", fix="name another folder")
    if edit_scene is not None and edit is None:
        raise UsageError("--edit-scene without --edit", expected="--edit DATASET")
    if cache_dir is not None and not keep:
        raise UsageError("--cache-dir with --no-cache", expected="one of them")
    world = load_scene(scene)
    other = None if edit is None else (console.opened(edit), load_scene(edit_scene) if edit_scene else world)
    if other is not None:
        _check_edit(*other)
    with console.stages() as stage:
        data, cache = console.opened(dataset, version), (cache_dir or user_cache()) if keep else None
        found = run(data, world, jobs=jobs, seed=seed, cache=cache, only=names, budget=budget, progress=stage)
        stage("writing the report")
        page = write_diagnosis(found, world, out)
        if other is not None:
            found = _edited(found, *other, jobs, seed, stage)
            page = write_diagnosis(found, world, out)
    console.out(found.report.model_dump_json(indent=2) if json else summary(found.report))
    console.note(f"report: {page}")
    if found.report.verdict in refused:
        raise typer.Exit(1)


def _verdicts(text: str) -> tuple[str, ...]:
    """Return the verdicts of a comma-separated list, each a known one."""
    from candata.errors import UnknownNameError
    from candata_cli import console

    for word in console.words(text):
        if word not in VERDICTS:
            raise UnknownNameError("verdict", word, VERDICTS)
    return console.words(text)


def _check_edit(dataset: Dataset, scene: Scene) -> None:
    """Refuse recordings that do not fit their scene before the long work begins."""
    from candata.gap.edit import readable

    readable(dataset, scene)


def _edited(
    found: Diagnosis, dataset: Dataset, scene: Scene, jobs: int, seed: int, stage: Callable[[str], None]
) -> Diagnosis:
    """Return the diagnosis with its edit test, where it names effects; its report stands already, should this fail."""
    from dataclasses import replace

    from candata.gap.edit import edit_test
    from candata_cli import console

    if not found.effects.effects:
        console.note("no effect is named, so there is nothing to test on --edit")
        return found
    size = found.report.gap
    reference = size.closed if size is not None and size.closed is not None else 1.0
    some = found.effects.effects
    test = edit_test(dataset, scene, some, reference=reference, jobs=jobs, seed=seed, progress=stage)
    return replace(found, report=found.report.model_copy(update={"edit": test}))
