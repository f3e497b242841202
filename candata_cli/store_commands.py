"""Commands that keep a dataset in order: compact, gc, migrate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from candata.errors import UsageError
from candata_cli import console

DatasetPath = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the dataset.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]

_UNITS_S = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86_400.0}


def register(app: typer.Typer) -> None:
    """Add the commands to the application."""
    app.command("compact", epilog="Example: candata compact recordings && candata gc recordings --keep 1")(compact)
    app.command("gc", epilog="Example: candata gc recordings --keep 3 --dry-run")(gc)
    app.command("migrate", epilog="Example: candata migrate recordings --out recordings-new")(migrate)


def compact(dataset: DatasetPath, json: Json = False) -> None:
    """Merge small parts into parts of 256 episodes; content, ids and digest stay the same.

    Publishes a new version. What earlier versions hold stays until gc. Safe while others append, and when it is
    killed: run it again.
    """
    from candata.datasets import compact_dataset, open_dataset

    total = len(open_dataset(dataset))
    with console.progress("episodes looked at", total) as advance:
        told_count = 0

        def progress(done_count: int, _total: int) -> None:
            nonlocal told_count
            advance(done_count - told_count)
            told_count = done_count

        result = compact_dataset(dataset, progress=progress)
        advance(total - told_count)
    version = result.version
    if json:
        console.out_json(
            {
                "version": version.number,
                "digest": version.digest,
                "parts_before": result.before,
                "parts_after": result.after,
                "left_out": result.left_out,
            }
        )
    elif result.before == result.after:
        console.out(f"nothing to do: version {version.number} has {_count(result.after, 'part')}")
    else:
        left_text = f", {_count(result.left_out, 'excluded episode')} left out" if result.left_out else ""
        console.out(f"version {version.number}: {result.before} parts are {result.after} now{left_text}")


def gc(
    dataset: DatasetPath,
    grace: Annotated[str, typer.Option(help="Age below which nothing goes: 30s, 10m, 12h, 7d.")] = "7d",
    keep: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Keep the newest N versions and all tagged ones; else all.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would go; remove nothing.")] = False,
    json: Json = False,
) -> None:
    """Remove parts, leftovers, catalogs, clouds and caches that no version or tag reaches.

    Nothing younger than the grace period goes: a job may be about to publish it. Versions stay unless --keep is
    given; one that was the newest within the grace period stays too.
    """
    from dataclasses import asdict

    from candata.datasets import collect_garbage

    result = collect_garbage(dataset, grace_s=seconds(grace), keep=keep, dry_run=dry_run)
    for text in result.notes:
        console.note(text)
    if json:
        lists = {
            "removed": [asdict(entry) for entry in result.removed],
            "waiting": [asdict(entry) for entry in result.waiting],
        }
        console.out_json({"dry_run": dry_run, "bytes": result.bytes, **lists, "notes": list(result.notes)})
        return
    if result.removed:
        console.out_table(
            ("what", "path", "bytes"), [(entry.kind, entry.path, entry.bytes) for entry in result.removed]
        )
    console.out(
        f"{'would free' if dry_run else 'freed'} {result.bytes} bytes in {_count(len(result.removed), 'thing')}"
    )
    if result.waiting:
        console.out(f"{_count(len(result.waiting), 'thing')} more out of reach, but changed within the last {grace}")


def migrate(
    dataset: DatasetPath,
    out: Annotated[Path, typer.Option("--out", metavar="NEW", help="Folder of the new dataset.")],
    json: Json = False,
) -> None:
    """Bring a dataset of an older format into a new folder in the present one; the old one stays as it is."""
    from candata.datasets.migrate import migrate_dataset

    result = migrate_dataset(dataset, out)
    if json:
        console.out_json({"from": result.old, "to": result.new, "out": str(out) if result.done else None})
    elif result.done:
        console.out(f"{out}: format {result.new}, from format {result.old}")
    else:
        console.out(f"nothing to do: {dataset} has the present format, {result.new}")


def seconds(text: str) -> float:
    """Return a duration such as `7d`, `12h`, `10m` or `30s` [s].

    Raises
    ------
    UsageError
        When the text is no duration.
    """
    number, unit = text[:-1], text[-1:]
    if unit not in _UNITS_S or not number.replace(".", "", 1).isdigit():
        raise UsageError("not a duration", expected="a number and s, m, h or d, such as 7d", found=repr(text))
    return float(number) * _UNITS_S[unit]


def _count(number: int, noun: str) -> str:
    """Return `1 part`, `2 parts`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
