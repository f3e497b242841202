"""Commands that look at a dataset: inspect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console

if TYPE_CHECKING:
    from candata.datasets.summary import Summary

DatasetPath = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the dataset.")]
Version = Annotated[str | None, typer.Option(help="Version: its number or the start of its digest.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command("inspect")(inspect)


def inspect(dataset: DatasetPath, version: Version = None, json: Json = False) -> None:
    """Print what is in a dataset: episodes, channels and ranges, contact, phases, lineage."""
    from candata.datasets import open_dataset
    from candata.datasets.summary import summarise

    data = open_dataset(dataset, console.version(version))
    with console.progress("reading episodes", len(data)) as advance:
        summary = summarise(data, lambda: advance(1))
    if json:
        console.out_json(summary.model_dump(mode="json"))
    else:
        _print_summary(summary)


def _print_summary(summary: Summary) -> None:
    """Print the summary for people."""
    console.out(f"{summary.name}@{summary.digest[:12]}  version {summary.version} of {summary.versions}")
    console.out(f"{summary.episodes} episodes, {summary.rows} rows, {summary.duration_s:.1f} s")
    for label in ("sources", "scenes", "objects", "tasks"):
        counts = sorted(getattr(summary, label).items())
        console.out(f"{label}: {', '.join(f'{name} {count}' for name, count in counts) or 'not stated'}")
    rows = [
        (c.name, c.unit, " ".join(_shape(s) for s in c.shapes), _number(c.low), _number(c.high),
         f"{c.invalid_share:.1%}", c.episodes)
        for c in summary.channels
    ]  # fmt: skip
    console.out_table(("channel", "unit", "shape", "min", "max", "invalid", "episodes"), rows)
    _print_contact(summary)
    for step in summary.lineage:
        parents = f" from {', '.join(step.parents)}" if step.parents else ""
        tools = ", ".join(f"{name} {version}" for name, version in sorted(step.tools.items()))
        console.out(f"lineage: {step.operation}{parents}{f' ({tools})' if tools else ''}")


def _print_contact(summary: Summary) -> None:
    """Print shares of contact and phases, as far as they are known."""
    if summary.contact_share is None:
        console.out("contact: not known")
        return
    tips = "".join(f", {name} {share:.1%}" for name, share in summary.fingertip_contact_shares.items())
    console.out(f"contact: any {summary.contact_share:.1%}{tips}")
    shares = (summary.phases or {}).items()
    console.out("phases: " + ", ".join(f"{name} {share:.1%}" for name, share in shares))


def _shape(shape: tuple[int, ...]) -> str:
    """Return `(T, 5, 3)`."""
    return f"({', '.join(map(str, ('T', *shape)))})"


def _number(value: float | None) -> str:
    """Return four digits, or a dash."""
    return "-" if value is None else f"{value:.4g}"
