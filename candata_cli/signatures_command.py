"""`candata gap signatures`: what effects do under recorded commands, simulated before anything is diagnosed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from candata_cli import console
from candata_cli.outputs import check_output

_EXAMPLE = """\b
Examples:
  candata gap signatures day1 --scene scene.yaml --jobs 8
  candata gap signatures day1 --scene scene.yaml --ray auto --cache-dir /shared/cache
  candata diagnose day2 --scene scene.yaml --out out/day2 --cache-dir /shared/cache --shared-signatures

\b
It pays where the same commands are recorded again and again (about ten diagnoses of them; one diagnosis simulates
only what it needs). On a Ray cluster, dataset, scene and --cache-dir must lie in folders that all its machines see.
"""


def register(app: typer.Typer) -> None:
    """Add the command to the group `gap`."""
    console.group(app, "gap", console.GAP).command("signatures", epilog=_EXAMPLE)(signatures)


@console.stoppable()
def signatures(
    dataset: Annotated[str, typer.Argument(help="Recordings of the commands: a dataset's folder or registered name.")],
    scene: Annotated[str, typer.Option(help="Nominal simulator: a scene.yaml or a built-in scene.")],
    version: Annotated[str | None, typer.Option(help="Version of the dataset (default: the newest).")] = None,
    cache_dir: Annotated[
        Path | None, typer.Option(help="Folder of what is kept (default: the user's cache, where diagnose looks).")
    ] = None,
    only: Annotated[str, typer.Option(help="Effects to simulate, comma separated (default: all that can act).")] = "",
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the diagnoses: decides which of more than 64 episodes are searched.")
    ] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = os.cpu_count() or 1,
    ray: Annotated[str | None, typer.Option(metavar="ADDRESS", help=console.RAY)] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the counts as JSON.")] = False,
) -> None:
    """Simulate what every effect does under these commands, so that later diagnoses need not (--shared-signatures).

    Another recording shares them when its commands are the same and it starts within 2 cm and 0.1 rad; not
    those of tracker biases and joint offsets, which follow from where each recording starts. An interrupted run goes on
    where it was. Without it a diagnosis simulates effects on its own recording; the last digits, and ties, may differ.
    """
    from candata.gap.blind.signature_library import keep_signature, planned, source
    from candata.simulate.cluster import crew_of
    from candata.user_folders import user_cache

    folder = cache_dir or user_cache()
    check_output(folder, "folder", "--cache-dir")
    data = console.open_named(dataset, version)
    signature_source = source(data.path, scene, folder, seed, data.digest)._replace(only=console.words(only))
    kept_text = f"signatures that were simulated whole are kept in {folder}"
    with console.stoppable(kept_text, goes_on=True), crew_of(jobs, ray, folder) as crew:
        console.note("replaying the nominal scene, measuring the floor")
        plan = planned(signature_source)
        with console.progress("simulating effects", len(plan.tasks)) as advance:
            cpu_s = 0.0
            for signature in crew(keep_signature, plan.tasks):
                cpu_s += signature.cpu_s
                advance(1)
    result = {"signatures": plan.total, "new": len(plan.tasks), "cpu_s": round(cpu_s, 1), "folder": str(folder)}
    if json:
        console.out_json(result)
    elif plan.total:
        console.out(f"{plan.total} signatures kept, {len(plan.tasks)} of them new ({cpu_s:.0f} CPU s): {folder}")
    else:
        console.out("nothing to keep: tosses are simulated anew for each recording")
