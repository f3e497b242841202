"""`candata gap compare`: two versions on the same blind cases, paired."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from candata_cli import console

EXAMPLE = """\b
Example:
  candata gap score cases --labels sealed.json --out out/old
  candata gap score cases --labels sealed.json --out out/new
  candata gap compare out/old out/new
"""


def register(app: typer.Typer) -> None:
    """Add the command to its group."""
    console.group(app, "gap", console.GAP).command("compare", epilog=EXAMPLE)(compare)


def compare(
    first_run: Annotated[Path, typer.Argument(help="Folder of one run's results.")],
    second_run: Annotated[Path, typer.Argument(help="Folder of another run's results, on the same cases.")],
    json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Compare two runs on the same cases: how often each alone is right, McNemar's exact p, CPU time, what changed."""
    from candata.gap.blind.comparing import compare_runs

    comparison = compare_runs(first_run, second_run)
    if json:
        console.out(comparison.model_dump_json(indent=2))
        return
    console.out_table(
        ("cases", "both right", "first only", "second only", "neither", "p", "CPU s first", "CPU s second"),
        [
            (
                comparison.cases,
                comparison.both_right,
                comparison.first_only,
                comparison.second_only,
                comparison.neither,
                f"{comparison.p:.3g}",
                f"{comparison.first_cpu_s:.1f}",
                f"{comparison.second_cpu_s:.1f}",
            )
        ],
    )
    if comparison.changed:
        console.out("")
        console.out_table(("case", "first", "second"), [(c.case, c.first, c.second) for c in comparison.changed])
