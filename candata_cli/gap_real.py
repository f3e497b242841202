"""`candata gap real`: labelled real recordings as a bench of what changed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from candata_cli import console
from candata_cli.gap_commands import bench_lock, end_time
from candata_cli.outputs import check_output

EXAMPLE = """\b
Example: candata gap real servo --out out/servo

\b
The folder holds labels.yaml, a dataset, a scene, and a table with a row for each episode (without one, the labels that
the episodes keep count):
  dataset: runs
  scene: scene.yaml
  settings: settings.csv          columns: episode, gain, mass_kg
  causes:
    gain: {effects: [servo_gain], size: {effect: servo_gain, parameter: kp_scale}}
    mass_kg: {effects: [link_mass]}
It may also name a file of effects that the scene holds already (effects: effects.yaml). A label without effects
(colour: {effects: []}) changes nothing that can be measured: settings that differ in it alone are nulls.
"""


def register(app: typer.Typer) -> None:
    """Add the command to its group."""
    console.group(app, "gap", console.GAP).command("real", epilog=EXAMPLE)(real)


@console.stoppable()
def real(
    folder: Annotated[Path, typer.Argument(help="Folder of a labelled set: labels.yaml and what it names.")],
    out: Annotated[Path, typer.Option(help="Folder for results and score; an interrupted run goes on.")],
    dataset: Annotated[
        str | None, typer.Option(help="Recordings: a folder or registered name (default: the one of labels.yaml).")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of each diagnosis.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    minutes: Annotated[float | None, typer.Option(min=0, help="Begin no pair after so long.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the score as JSON.")] = False,
) -> None:
    """Diagnose what changed between all pairs of settings, and score the answers by the labels: misses first."""
    check_output(out, "folder")
    from candata.gap.blind.labelled_set import pairs_of, read_labelled
    from candata.gap.blind.setting_pairs import run_pairs, score_pairs
    from candata.reports.bench import bench_text, write_bench
    from candata.simulate.crew import local

    labelled = read_labelled(folder, dataset)
    kept_text = f"the pairs diagnosed so far are kept in {out}"
    with console.stoppable(kept_text, goes_on=True), bench_lock(out):
        with console.progress("diagnosing pairs", len(pairs_of(labelled))) as advance:
            results = run_pairs(labelled, out, local(jobs), seed, end_time(minutes), advance)
        bench = score_pairs(labelled, results)
        page = write_bench(bench, out)
    console.out(bench.model_dump_json(indent=2) if json else bench_text(bench))
    console.note(f"score: {out / 'bench.json'}, {page}")
