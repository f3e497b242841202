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
    first: Annotated[Path, typer.Argument(help="Folder of one run's results.")],
    second: Annotated[Path, typer.Argument(help="Folder of another run's results, on the same cases.")],
    json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Compare two runs on the same cases: how often each alone is right, McNemar's exact p, CPU time, what changed."""
    from candata.gap.blind.comparing import compare_runs

    found = compare_runs(first, second)
    if json:
        console.out(found.model_dump_json(indent=2))
        return
    console.out_table(
        ("cases", "both right", "first only", "second only", "neither", "p", "CPU s first", "CPU s second"),
        [
            (
                found.cases,
                found.both_right,
                found.first_only,
                found.second_only,
                found.neither,
                f"{found.p:.3g}",
                f"{found.first_cpu_s:.1f}",
                f"{found.second_cpu_s:.1f}",
            )
        ],
    )
    if found.changed:
        console.out("")
        console.out_table(("case", "first", "second"), [(c.case, c.first, c.second) for c in found.changed])
