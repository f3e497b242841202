"""`candata doctor`: what is installed and attached, and whether a folder can be trusted with recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from candata_cli import _environment, console

if TYPE_CHECKING:
    from candata.datasets.probe import Probe

_EXAMPLE = "Example: candata doctor /mnt/share/recordings"


def register(app: typer.Typer) -> None:
    """Add the command to the application."""
    app.command("doctor", epilog=_EXAMPLE)(doctor)


def doctor(
    path: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="Folder or share to try, such as that of a dataset.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Leave out the kill test (some 15 s).")] = False,
    kills: Annotated[int, typer.Option(min=1, metavar="N", help="Writers to kill in the kill test.")] = 12,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Print versions, extras, devices and sizes; with FOLDER, try what a dataset there needs. Exits 1 on a failure.

    In the folder it tries free space, writing, renames, exclusive creation, fsync and the clock. Then it kills
    writers again and again and counts whether anything they had acknowledged is lost. What it writes it removes.
    """
    probes = _probes(path, 0 if quick else kills)
    packages = _environment.needs()
    report: dict[str, Any] = {
        "versions": _environment.versions(packages),
        "extras": [
            {"name": e.name, "missing": list(e.missing), "hint": e.hint if e.missing else None}
            for e in _environment.extras(packages)
        ],
        "devices": {"serial_ports": _environment.serial_ports(), "gpus": _environment.gpus()},
        "machine": _environment.machine(),
        "folder": None if probes is None else [probe.__dict__ for probe in probes],
    }
    absent_packages = [name for name in packages.get(None, ()) if report["versions"][name] is None]
    report["ok"] = not absent_packages and all(probe.ok is not False for probe in probes or ())
    if json:
        console.out_json(report)
    else:
        _print(report, probes)
    if not report["ok"]:
        raise typer.Exit(1)


def _probes(path: Path | None, kills: int) -> tuple[Probe, ...] | None:
    """Return what the folder promises; None without a folder."""
    if path is None:
        return None
    from candata.datasets.probe import probe_folder

    with console.stages() as stage:
        return probe_folder(path, kills=kills, progress=lambda name: stage(f"trying {name}"))


def _print(report: dict[str, Any], probes: tuple[Probe, ...] | None) -> None:
    """Print the report for people."""
    rows = [(name, details or "missing") for name, details in report["versions"].items()]
    console.out_table(("what", "version"), rows)
    for extra in report["extras"]:
        lacks = f"lacks {', '.join(extra['missing'])}: {extra['hint']}" if extra["missing"] else "complete"
        console.out(f"extra {extra['name']}: {lacks}")
    if not report["extras"]:
        console.out("extras: unknown, as candata is neither installed nor a checkout")
    for label, key, package in (("serial ports", "serial_ports", "pyserial"), ("GPUs", "gpus", "torch")):
        details = report["devices"][key]
        console.out(f"{label}: " + (f"unknown without {package}" if details is None else ", ".join(details) or "none"))
    machine = {key: "unknown" if value is None else value for key, value in report["machine"].items()}
    console.out(
        f"machine: {machine['processors']} processors, {machine['memory_gb']} GB memory ({machine['memory_free_gb']} "
        f"free), {machine['disk_gb']} GB disk ({machine['disk_free_gb']} free)"
    )
    if probes is not None:
        words = {True: "ok", False: "FAILED", None: "not tried"}
        console.out_table(("folder", "result", "found"), [(p.name, words[p.ok], p.found) for p in probes])
        for probe in probes:
            if probe.ok is False and probe.fix:
                console.out(f"do: {probe.name}: {probe.fix}")
