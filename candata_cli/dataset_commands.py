"""Commands that look at a dataset: validate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console

if TYPE_CHECKING:
    from candata.checks import Finding

DatasetPath = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the dataset.")]
Version = Annotated[str | None, typer.Option(help="Version: its number or the start of its digest.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command("validate")(validate)


def validate(dataset: DatasetPath, version: Version = None, json: Json = False) -> None:
    """Check schema, hashes, finite values, time and quaternions; exit 1 when something is wrong."""
    from dataclasses import asdict

    from candata.checks import check
    from candata.datasets import open_dataset

    data = open_dataset(dataset, console.number(version), partial=True)
    with console.progress("checking parts", len(data.file.parts)) as advance:
        findings = check(data, lambda: advance(1))
    if json:
        record = {"dataset": data.name, "digest": data.digest, "episodes": len(data)}
        console.out_json(record | {"findings": [asdict(finding) for finding in findings]})
    elif findings:
        _print_findings(findings)
    else:
        console.out(f"{len(data)} episodes, no findings")
    if any(finding.level == "error" for finding in findings):
        raise typer.Exit(1)


def _print_findings(findings: tuple[Finding, ...]) -> None:
    """Print the findings as a table."""
    rows = [(f.level, f.rule, _known(f.episode), _known(f.channel), _known(f.index), f.message) for f in findings]
    console.out_table(("level", "rule", "episode", "channel", "row", "what"), rows)


def _known(value: object) -> object:
    """Return the value, or a dash."""
    return "-" if value is None else value
