"""Commands that look at a dataset: validate, inspect."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from candata.checks import Finding
    from candata.datasets.summary import Summary

DatasetPath = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the dataset.")]
Version = Annotated[str | None, typer.Option(help="Version: its number or the start of its digest.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command("validate")(validate)
    app.command("inspect")(inspect)


def validate(dataset: DatasetPath, version: Version = None, json: Json = False) -> None:
    """Check schema, hashes, finite values, time and quaternions; exit 1 when something is wrong."""
    from candata.checks import check
    from candata.datasets import open_dataset

    data = open_dataset(dataset, _version(version), partial=True)
    with _progress("checking", len(data.file.parts)) as advance:
        findings = check(data, advance)
    if json:
        _print_findings_json(data.name, data.digest, len(data), findings)
    elif findings:
        _print_findings(findings)
    else:
        typer.echo(f"{len(data)} episodes, no findings")
    if any(finding.level == "error" for finding in findings):
        raise typer.Exit(1)


def inspect(dataset: DatasetPath, version: Version = None, json: Json = False) -> None:
    """Print what is in a dataset: episodes, channels and ranges, contact, phases, lineage."""
    from candata.datasets import open_dataset
    from candata.datasets.summary import summarise

    data = open_dataset(dataset, _version(version))
    with _progress("reading", len(data)) as advance:
        summary = summarise(data, advance)
    if json:
        typer.echo(summary.model_dump_json(indent=1))
    else:
        _print_summary(summary)


def _version(text: str | None) -> int | str | None:
    """Return a short number as a number, anything else as it is."""
    return int(text) if text and text.isdigit() and len(text) < 6 else text


def _progress(label: str, total: int) -> Any:
    """Return a context that gives a function to call after each step; a bar on stderr if it is a terminal."""
    from contextlib import contextmanager

    from rich.console import Console
    from rich.progress import Progress

    @contextmanager
    def bar() -> Any:
        console = Console(stderr=True)
        with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
            task = progress.add_task(label, total=total)
            yield lambda: progress.advance(task)

    return bar()


def _print_findings_json(name: str, digest: str, episodes: int, findings: tuple[Finding, ...]) -> None:
    """Print the findings as one JSON object."""
    import json
    from dataclasses import asdict

    record = {
        "dataset": name,
        "digest": digest,
        "episodes": episodes,
        "findings": list(map(asdict, findings)),
    }
    typer.echo(json.dumps(record, indent=1))


def _print_findings(findings: tuple[Finding, ...]) -> None:
    """Print the findings as a table."""
    rows = [(f.level, f.rule, f.episode, f.channel, f.index, f.message) for f in findings]
    _table(("level", "rule", "episode", "channel", "row", "what"), rows)


def _print_summary(summary: Summary) -> None:
    """Print the summary for people."""
    typer.echo(f"{summary.name}@{summary.digest[:12]}  version {summary.version} of {summary.versions}")
    typer.echo(f"{summary.episodes} episodes, {summary.rows} rows, {summary.duration_s:.1f} s")
    for label in ("sources", "scenes", "objects", "tasks"):
        counts = ", ".join(f"{name} {count}" for name, count in sorted(getattr(summary, label).items()))
        typer.echo(f"{label}: {counts}")
    rows = [
        (c.name, c.unit, " ".join(_shape(s) for s in c.shapes), _number(c.low), _number(c.high),
         f"{c.invalid_share:.1%}", c.episodes)
        for c in summary.channels
    ]  # fmt: skip
    _table(("channel", "unit", "shape", "min", "max", "invalid", "episodes"), rows)
    _print_contact(summary)
    for step in summary.lineage:
        parents = f" from {', '.join(step.parents)}" if step.parents else ""
        tools = ", ".join(f"{name} {version}" for name, version in sorted(step.tools.items()))
        typer.echo(f"lineage: {step.operation}{parents}{f' ({tools})' if tools else ''}")


def _print_contact(summary: Summary) -> None:
    """Print shares of contact and phases, as far as they are known."""
    if summary.contact_share is None:
        typer.echo("contact: not known")
        return
    tips = "".join(f", {name} {share:.1%}" for name, share in summary.fingertip_contact_shares.items())
    typer.echo(f"contact: any {summary.contact_share:.1%}{tips}")
    shares = (summary.phases or {}).items()
    typer.echo("phases: " + ", ".join(f"{name} {share:.1%}" for name, share in shares))


def _shape(shape: tuple[int, ...]) -> str:
    """Return `(T, 5, 3)`."""
    return f"({', '.join(map(str, ('T', *shape)))})"


def _number(value: float | None) -> str:
    """Return four digits, or a dash."""
    return "-" if value is None else f"{value:.4g}"


def _table(header: tuple[str, ...], rows: list[tuple[Any, ...]]) -> None:
    """Print a table to stdout; as wide as needed where stdout is no terminal."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(*header, box=box.SIMPLE_HEAD)
    for row in rows:
        table.add_row(*("-" if value is None else str(value) for value in row))
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, width=max(80, console.measure(table).maximum))
    console.print(table)
