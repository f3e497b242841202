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
        told = 0

        def progress(done: int, _total: int) -> None:
            nonlocal told
            advance(done - told)
            told = done

        found = compact_dataset(dataset, progress=progress)
        advance(total - told)
    version = found.version
    if json:
        console.out_json(
            {"version": version.number, "digest": version.digest, "parts_before": found.before,
             "parts_after": found.after, "left_out": found.left_out}
        )  # fmt: skip
    elif found.before == found.after:
        console.out(f"nothing to do: version {version.number} has {_count(found.after, 'part')}")
    else:
        left = f", {_count(found.left_out, 'excluded episode')} left out" if found.left_out else ""
        console.out(f"version {version.number}: {found.before} parts are {found.after} now{left}")


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

    found = collect_garbage(dataset, grace_s=seconds(grace), keep=keep, dry_run=dry_run)
    for text in found.notes:
        console.note(text)
    if json:
        lists = {"removed": [asdict(one) for one in found.removed], "waiting": [asdict(one) for one in found.waiting]}
        console.out_json({"dry_run": dry_run, "bytes": found.bytes, **lists, "notes": list(found.notes)})
        return
    if found.removed:
        console.out_table(("what", "path", "bytes"), [(one.kind, one.path, one.bytes) for one in found.removed])
    console.out(f"{'would free' if dry_run else 'freed'} {found.bytes} bytes in {_count(len(found.removed), 'thing')}")
    if found.waiting:
        console.out(f"{_count(len(found.waiting), 'thing')} more out of reach, but changed within the last {grace}")


def migrate(
    dataset: DatasetPath,
    out: Annotated[Path, typer.Option("--out", metavar="NEW", help="Folder of the new dataset.")],
    json: Json = False,
) -> None:
    """Bring a dataset of an older format into a new folder in the present one; the old one stays as it is."""
    from candata.datasets.migrate import migrate_dataset

    found = migrate_dataset(dataset, out)
    if json:
        console.out_json({"from": found.old, "to": found.new, "out": str(out) if found.done else None})
    elif found.done:
        console.out(f"{out}: format {found.new}, from format {found.old}")
    else:
        console.out(f"nothing to do: {dataset} has the present format, {found.new}")


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
