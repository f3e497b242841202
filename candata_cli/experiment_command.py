"""`candata experiment`: data, models and regimes of a file become one table; what was made is kept, and goes on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.experiment.forecast import CellForecast

EXAMPLES = """\b
Examples:
  candata experiment examples/paper/table1.yaml --scale 0.05 --dry-run
  candata experiment examples/paper/table1.yaml --scale 0.05 --out out/table1
  candata experiment examples/paper/repair.yaml --only seed-0 --only train-10,train-30
"""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(epilog=EXAMPLES)(experiment)


@console.stoppable()
def experiment(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="File of the experiment (YAML).")],
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Its folder; out/NAME by default.")] = None,
    scale: Annotated[float, typer.Option("--scale", help="Factor on episodes and steps, such as 0.05.")] = 1.0,
    jobs: Annotated[int, typer.Option("--jobs", min=1, metavar="J", help="Processes; runs go side by side.")] = 1,
    ray: Annotated[str | None, typer.Option("--ray", metavar="ADDRESS", help=console.RAY)] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="A,B",
            help="Rows of these models, columns, regimes, origins, seed-N, train-N; repeatable.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="List the cells with hours and disk; make nothing.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the table, or the cells, as JSON.")] = False,
) -> None:
    """Make the sets, repairs, runs and evaluations of a file, and one table of them.

    Every cell is kept in the folder by the digest of what it came from. The same command goes on after a stop: sets,
    runs and diagnoses by their own means. A cell that fails is named in the table; the others go on. Seals of stand-in
    worlds are opened once the table is written.
    """
    folder = out or Path("out") / config.stem
    check_output(folder, "folder")
    from candata.experiment.config import read_experiment
    from candata.experiment.plan import plan_cells

    plan = plan_cells(read_experiment(config, scale)).chosen(console.words(",".join(only or ())))
    if dry_run:
        from candata.experiment.forecast import forecast_cells

        with console.stages() as stage:
            rows = forecast_cells(plan, folder, jobs, stage)
        return _tell_forecast(rows, jobs, json)
    from candata.experiment.run import run_experiment
    from candata.reports import write_diagnosis
    from candata.reports.experiment import summary, write_experiment
    from candata.user_folders import user_cache

    with console.stoppable(lambda: _kept_text(folder, len(plan.cells)), goes_on=True), console.stages() as stage:
        table = run_experiment(
            plan, folder, write_diagnosis, scale=scale, jobs=jobs, ray=ray, cache=user_cache(), stage=stage
        )
        stage("writing the page")
        page = write_experiment(table, folder)
    console.out(table.model_dump_json(indent=2) if json else summary(table))
    console.note(f"page: {page}")
    if table.failed:
        console.note(f"{len(table.failed)} cells failed; the same command tries them again")


def _kept_text(folder: Path, count: int) -> str:
    """Return how many cells stand, as a clause."""
    standing = len(list((folder / "cells").glob("*/cell.json")))
    return f"{standing} of {count} cells stand in {folder}; what was begun is kept too"


def _tell_forecast(rows: tuple[CellForecast, ...], jobs: int, json: bool) -> None:
    """Print what the cells will take, runs and evaluations that differ in their seed as one."""
    from candata.experiment.forecast import total_hours

    if json:
        return console.out_json(
            {
                "cells": [row.model_dump(mode="json") for row in rows],
                "hours": total_hours(rows, jobs),
                "gigabytes": sum(row.gigabytes or 0.0 for row in rows),
                "jobs": jobs,
            }
        )
    groups: dict[str, list[CellForecast]] = {}
    for row in rows:
        groups.setdefault(row.name.rpartition("/seed-")[0] or row.name, []).append(row)
    lines = [
        (
            name,
            len(group),
            "stands" if all(row.stands for row in group) else _hours(group),
            f"{sum(row.gigabytes or 0.0 for row in group):.2f}",
        )
        for name, group in groups.items()
    ]
    console.out_table(("cells", "count", "hours", "GB"), lines)
    console.out("")
    gigabytes = sum(row.gigabytes or 0.0 for row in rows)
    console.out(f"{len(rows)} cells, {sum(row.stands for row in rows)} stand")
    console.out(f"about {total_hours(rows, jobs):.2g} h with --jobs {jobs}, and {gigabytes:.2g} GB")
    console.note("a diagnosis counts with the most that it may take")


def _hours(group: list[CellForecast]) -> str:
    """Return the hours of cells; `?` where they are not known."""
    known = [row.hours for row in group if row.hours is not None]
    return f"{sum(known):.3f}" if known else "?"
