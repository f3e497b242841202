"""`candata gap compare`: two versions on the same blind cases, paired."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console

if TYPE_CHECKING:
    from candata.schema.bench import PairedComparison

EXAMPLE = """\b
Example:
  candata gap bench --keep out/training
  candata gap score out/training --out out/old
  candata gap score out/training --out out/new
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
    """Compare two runs on the same cases, A and B: who is right, by kind of case, what each costs, what changed.

    p is McNemar's exact p of the cases in which one alone is right. Scores of support are 0 at best.
    """
    from candata.gap.blind.comparison import compare_runs

    comparison = compare_runs(first_run, second_run)
    if json:
        console.out(comparison.model_dump_json(indent=2))
        return
    console.out(comparison.summary)
    console.out(f"A: {first_run}\nB: {second_run}\n")
    console.out_table(("kind", "cases", "both right", "only A", "only B", "p"), _kind_rows(comparison))
    if comparison.measures:
        console.out("")
        console.out_table(("measure", "cases", "A", "B", "change", "90 % interval"), _measure_rows(comparison))
    _print_changed(comparison)


def _kind_rows(comparison: PairedComparison) -> list[tuple[object, ...]]:
    """Return the rows of the table of kinds, all cases last."""
    rows = (*comparison.kinds, comparison)
    return [(k.kind, k.cases, k.both_right, k.first_only, k.second_only, f"{k.p:.2g}") for k in rows]


def _measure_rows(comparison: PairedComparison) -> list[tuple[str, ...]]:
    """Return the rows of the table of measures: medians with a ratio, means with a difference."""
    rows: list[tuple[str, ...]] = []
    for m in comparison.measures:
        change, ends = (f"{m.change:.2f} x", "{:.2f}") if m.is_ratio else (f"{m.change:+.3f}", "{:+.3f}")
        digits = ".1f" if m.is_ratio else ".3f"
        name, interval = f"{m.measure}, {m.statistic}", f"{ends.format(m.low)} to {ends.format(m.high)}"
        rows.append((name, str(m.cases), f"{m.first:{digits}}", f"{m.second:{digits}}", change, interval))
    return rows


def _print_changed(comparison: PairedComparison) -> None:
    """Print the cases in which one run alone is right, and how many others differ in what is said."""
    turned = [c for c in comparison.changed if c.first_right != c.second_right]
    for c in turned:
        console.out(f"\n{c.case} ({c.kind})\n  A: {c.first}\n  B: {c.second}")
    others = len(comparison.changed) - len(turned)
    if others:
        console.out(f"\nother cases of which the two say different things, both right or both wrong: {others} (--json)")
