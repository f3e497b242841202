"""`candata gap bench` and `candata gap score`: the sealed self-check, on cases of our own or made elsewhere."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Annotated

import typer

from candata_cli import console
from candata_cli.bench_cases import KINDS, SCENE, bench_request, listed_words, make
from candata_cli.bench_scores import ScoredRun, diagnose_and_score
from candata_cli.outputs import check_output

NOISES = ("declared", "misdeclared", "undeclared", "mixed")
BASELINES = ("lowest_error", "bic", "one_se", "commonest", "oracle")
BENCH_EXAMPLE = """\b
Examples:
  candata gap bench --out out/bench
  candata gap bench --out out/small --kinds one,null --counts one=40,null=10 --jobs 2
  candata gap bench --out out/mine --scene my/scene.yaml --episodes 12
  candata gap bench --out out/bench --minutes 90
  candata gap bench --out out/bench --baselines oracle,bic --baseline-cases 20
  candata gap bench --out /shared/bench --ray auto
  candata gap bench --out out/small --world random-small --counts null=300,one=200
  candata gap bench --keep out/training --counts one=60,null=60
  candata gap score out/training --out out/today --minutes 60

\b
With --keep the cases lie in a folder of their own, to be diagnosed by any version with candata gap score. The same
command draws the same cases again: they are no sealed draw, and serve to compare searches (candata gap compare), not
to judge one. Without --out nothing is diagnosed yet.

\b
With --world random-small every case brings a random small scene of its own, played by plain MuJoCo: null and one
alone, what matters in that scene; half of the nulls are plain, the others have a trait (a cut log, a joint driven
along, filtered, integrating or delayed motors, a spring, a base that gives). Its cases share no signatures.

\b
On a Ray cluster (pip install "candata[cluster]", the same candata on every machine) cases are made and diagnosed
as tasks of one core each; --out must be a folder that all its machines see at the same path.

\b
Signatures that the cases share are simulated first, each once (a row of the table says their CPU time); of a dozen
cases or more also those that only most of them need. The first case (of many, up to three) is diagnosed apart with
nothing kept: that row is what a first diagnosis costs.

\b
Baselines: lowest_error (smallest training error), bic, one_se (forward and one standard error, no floor),
commonest (the same answer always), oracle (told the cause). Not among them: mujoco.sysid with everything free,
which needs the packages of mujoco[sysid] and a parameter written for each effect.
"""
FOLLOW = "Record the motion that an ambiguous case's report proposes in its world, and diagnose it again."
FRESH = (
    "Fresh episodes of each hidden world on which named effects are tried (default: 20 where candata made the cases in "
    "one scene); 0 tries none."
)
MINUTES = "Begin no case after so many minutes and score what is done; 0 scores what a run left (default: go on)."
KEEP = "Keep the cases, and their labels, in this folder: always the same ones, to compare searches on."
NOISE = (
    f"What diagnoses are told of the sensors' noise: {', '.join(NOISES)}. Misdeclared is half to twice the truth; "
    "mixed takes turns."
)
RAY = f"{console.RAY} --out must be on a folder that all its machines share."
WORLD = "Draw a random small scene for each case, played by plain MuJoCo: random-small (default: one --scene)."
TRAITS = "Traits of random small scenes that take turns, comma separated (default: half plain, half the others)."
SCORE_EXAMPLE = """\b
Examples:
  candata gap score out/training --out out/score
  candata gap score cases --labels sealed.json --out out/score

\b
A case is a folder: a candata dataset with a case.json beside its files,
  {"name": "case-0001", "scene": "scene.yaml or built-in", "episodes": 20, "sealed": "sha256(label + salt)"}
and all labels are one file, {"salt": "64 hex digits", "labels": {"case-0001": "label as JSON text"}}, a label being
  {"case": "case-0001", "kind": "one", "effects": [{"name": "object_mass", "parameters": {"mass_scale": 1.4}}]}
See schemas/case.schema.json, labels.schema.json and label.schema.json for every field.
"""


def register(app: typer.Typer) -> None:
    """Add the group."""
    group = console.group(app, "gap", console.GAP)
    group.command("bench", epilog=BENCH_EXAMPLE)(bench)
    group.command("score", epilog=SCORE_EXAMPLE)(score)


@console.stoppable()
def bench(
    out: Annotated[Path | None, typer.Option(help="Folder of the run; an interrupted one goes on.")] = None,
    keep: Annotated[Path | None, typer.Option(metavar="DIR", help=KEEP)] = None,
    scene: Annotated[
        str | None, typer.Option(help=f"Nominal simulator: a scene.yaml or a built-in scene (default: {SCENE}).")
    ] = None,
    world: Annotated[str | None, typer.Option(help=WORLD)] = None,
    traits: Annotated[str, typer.Option(help=TRAITS)] = "",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the commands, and of what --keep hides.")] = 1,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes of each case (default: 20, in random small scenes 12).")
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option(help="Length of an episode (default: 2.4; a random small scene draws 1.2 to 2.5).")
    ] = None,
    kinds: Annotated[str, typer.Option(help=f"Kinds of cases, comma separated: {', '.join(KINDS)}.")] = ",".join(KINDS),
    counts: Annotated[
        str,
        typer.Option(
            help="Cases of a kind, like one=120,quarter=40; others keep theirs (one 120, null 100, else 40; in random "
            "small scenes null 300, one 200)."
        ),
    ] = "",
    only: Annotated[str, typer.Option(help="Effects to draw from, comma separated (default: all).")] = "",
    noise: Annotated[str, typer.Option(help=NOISE)] = NOISES[0],
    baselines: Annotated[str, typer.Option(help=f"Also score these, comma separated: {', '.join(BASELINES)}.")] = "",
    baseline_cases: Annotated[int, typer.Option(min=1, help="Cases that the baselines are given.")] = 40,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    ray: Annotated[str | None, typer.Option(metavar="ADDRESS", help=RAY)] = None,
    minutes: Annotated[float | None, typer.Option(min=0, help=MINUTES)] = None,
    follow: Annotated[bool, typer.Option(help=FOLLOW)] = True,
    fresh: Annotated[int | None, typer.Option(min=0, metavar="N", help=FRESH)] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the score as JSON.")] = False,
) -> None:
    """Hide causes, diagnose them from the data alone, open the labels, print the score: misses first.

    Kinds: one effect; a quarter of its size; null; pair and triple; outside (in no library); background (everything
    5 % wrong and one effect); solver (another simulator setting); local (one joint or fingertip).
    """
    from candata.gap.blind.cases import CASES
    from candata.gap.blind.labels import LABELS, TRAINING_SALT
    from candata.simulate.cluster import crew_of

    folder = _case_folder(out, keep)
    request = bench_request(world, scene, traits, kinds, counts, only, seed, episodes, duration_s, noise)
    request = replace(request, salt=None if keep is None else TRAINING_SALT)
    baseline_names, stop_time = listed_words(baselines, BASELINES, "baseline"), end_time(minutes)
    with (
        console.stoppable(lambda: _kept_text(folder, out), goes_on=True),
        bench_lock(folder),
        crew_of(jobs, ray, folder) as crew,
    ):
        make(folder, request, crew)
        if out is None:
            _print_kept(folder, json)
            return
        # What an ambiguous report proposes is recorded by candata's own loop: no part of a plain world.
        follow = follow and not world
        cases, labels = folder / CASES, folder / LABELS
        run = ScoredRun(out, cases, labels, crew, seed, None, baseline_names, baseline_cases, stop_time, fresh, follow)
        with nullcontext() if out == folder else bench_lock(out):
            diagnose_and_score(run, json)


def _case_folder(out: Path | None, keep: Path | None) -> Path:
    """Return the folder in which a bench makes its cases, once all folders are tried.

    Raises
    ------
    UsageError
        When there is none, or when one folder is to be both.
    """
    from candata.errors import UsageError

    folder = keep or out
    if folder is None:
        raise UsageError(
            "no folder for the cases",
            expected="--out DIR for a run, --keep DIR for cases that are kept, or both",
            fix="add --out DIR",
        )
    if out is not None and keep is not None and out.resolve() == keep.resolve():
        raise UsageError("--out and --keep are one folder", found=str(out), fix="give each a folder of its own")
    for path, option in ((out, "--out"), (keep, "--keep")):
        if path is not None:
            check_output(path, "folder", option)
    return folder


def _print_kept(folder: Path, json: bool) -> None:
    """Print how many cases are kept in a folder."""
    from candata.gap.blind.cases import CASES, read_cases

    count = len(read_cases(folder / CASES))
    if json:
        console.out_json({"folder": str(folder), "cases": count})
        return
    console.out(f"{count} cases are kept in {folder}")
    console.note(f"diagnose them: candata gap score {folder} --out DIR")


@console.stoppable()
def score(
    cases: Annotated[Path, typer.Argument(help="Folder of cases, or what candata gap bench wrote.")],
    out: Annotated[Path, typer.Option(help="Folder for results and score; an interrupted run goes on.")],
    labels: Annotated[
        Path | None, typer.Option(help="The sealed labels (default: those beside cases that a bench made).")
    ] = None,
    scene: Annotated[str | None, typer.Option(help="Nominal simulator, instead of the one each case names.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of each diagnosis.")] = 0,
    baselines: Annotated[str, typer.Option(help=f"Also score these, comma separated: {', '.join(BASELINES)}.")] = "",
    baseline_cases: Annotated[int, typer.Option(min=1, help="Cases that the baselines are given.")] = 40,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
    ray: Annotated[str | None, typer.Option(metavar="ADDRESS", help=RAY)] = None,
    minutes: Annotated[float | None, typer.Option(min=0, help=MINUTES)] = None,
    fresh: Annotated[int | None, typer.Option(min=0, metavar="N", help=FRESH)] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the score as JSON.")] = False,
) -> None:
    """Diagnose and score cases that were kept, or made elsewhere."""
    check_output(out, "folder")
    from candata.simulate.cluster import crew_of

    cases, labels = _cases_and_labels(cases, labels)
    baseline_names, stop_time = listed_words(baselines, BASELINES, "baseline"), end_time(minutes)
    with (
        console.stoppable(lambda: _kept_text(out, out), goes_on=True),
        bench_lock(out),
        crew_of(jobs, ray, out) as crew,
    ):
        diagnose_and_score(
            ScoredRun(out, cases, labels, crew, seed, scene, baseline_names, baseline_cases, stop_time, fresh), json
        )


def _cases_and_labels(cases: Path, labels: Path | None) -> tuple[Path, Path]:
    """Return the folder of cases and the file of their labels, both found in a bench's folder where that is given.

    Raises
    ------
    UsageError
        When no labels are given, and none are there.
    """
    from candata.errors import UsageError, Where
    from candata.gap.blind.cases import CASES
    from candata.gap.blind.labels import LABELS

    if labels is not None:
        return cases, labels
    if not (cases / LABELS).is_file():
        raise UsageError(
            "no labels for the cases",
            expected=f"--labels FILE, or {LABELS} in the folder",
            where=Where(path=str(cases)),
            fix="add --labels FILE",
        )
    return cases / CASES, cases / LABELS


def bench_lock(out: Path) -> AbstractContextManager[None]:
    """Refuse a folder in which another run is at work: both would write the same results."""
    from candata.datasets.durable import ensure_folder, exclusive_lock

    return exclusive_lock(ensure_folder(out), "another gap bench or gap score works in this folder")


def _kept_text(folder: Path, out: Path | None) -> str:
    """Return what stands of a run, as a clause: cases in `folder`, results in `out`."""
    from candata.gap.blind.cases import CASE, CASES
    from candata.gap.blind.runs import standing_results

    case_count = len(list((folder / CASES).glob(f"[!.]*/{CASE}")))
    cases = f"{case_count} cases" if case_count or out is None else ""
    if out is None:
        return f"{cases} are kept in {folder}"
    results = f"{len(standing_results(out))} results are kept in {out}"
    if not cases or out == folder:
        return f"{cases} and {results}" if cases else results
    return f"{cases} are kept in {folder}, {results}"


def end_time(minutes: float | None) -> float:
    """Return the time [s since the epoch] from which on no case is begun."""
    return inf if minutes is None else time.time() + 60 * minutes
