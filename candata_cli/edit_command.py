"""`candata gap edit-test`: whether named effects shrink the gap with another object or task too."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from candata_cli import console

_EXAMPLE = "Example: candata gap edit-test other --effects out/report/effects.yaml --scene other/scene.yaml"


def register(app: typer.Typer) -> None:
    """Add the command to the group `gap`."""
    group = console.group(app, "gap", console.GAP)
    group.command("edit-test", epilog=_EXAMPLE)(edit_test)


def edit_test(
    dataset: Annotated[str, typer.Argument(help="Recordings of another object or task.")],
    effects: Annotated[Path, typer.Option("--effects", metavar="FILE", help="What the diagnosis named: effects.yaml.")],
    scene: Annotated[
        str | None, typer.Option(help="Nominal simulator of these recordings; else that of --effects.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Threads; the result does not depend on it.")] = os.cpu_count() or 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of null replays and resamples.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Say whether named effects shrink the gap of other recordings too; exits 1 when not.

    Kept means: the 90 % interval of the share that closes lies above zero, and the share is at least 0.8 of what
    closed in the diagnosis (report.json beside --effects; without one, of the whole gap).
    """
    from candata.effects import read_effects, scene_of
    from candata.gap.verdict.edit_test import edit_test as run
    from candata.reports.words import edit_words
    from candata.scenes import load_scene

    effects_file = read_effects(effects)
    world = load_scene(scene or scene_of(effects_file, effects))
    with console.stages() as stage:
        result = run(
            console.open_named(dataset),
            world,
            effects_file.effects,
            reference=_closed_share(effects.parent / "report.json"),
            jobs=jobs,
            seed=seed,
            progress=stage,
        )
    console.out(result.model_dump_json(indent=2) if json else edit_words(result))
    if result.kept is False:
        raise typer.Exit(1)


def _closed_share(path: Path) -> float:
    """Return the share that closed in the diagnosis, 1 where there is no report."""
    from candata.schema.json_text import read_json
    from candata.schema.report import Report

    if not path.is_file():
        return 1.0
    gap = Report.parse(read_json(path), path).gap
    return gap.closed if gap is not None and gap.closed is not None else 1.0
