"""`candata gap bench` and `candata gap score`: the sealed self-check, on cases of our own or made elsewhere."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from candata_cli import console
from candata_cli.bench_cases import KINDS, SCENE, bench_request, listed_words, make
from candata_cli.outputs import check_output

if TYPE_CHECKING:
    from candata.gap.blind.outcomes import Outcome
    from candata.gap.blind.running import Place
    from candata.schema.bench import BenchFile, CaseResult, FilledSignature
    from candata.simulate.crew import Crew

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
#: Results whose pace tells the time left.
LATEST_RESULTS = 21
FOLLOW = "Record the motion that an ambiguous case's report proposes in its world, and diagnose it again."
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
    seed: Annotated[int, typer.Option(min=0, help="Seed of the commands; what is hidden is secret.")] = 1,
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
    json: Annotated[bool, typer.Option("--json", help="Print the score as JSON.")] = False,
) -> None:
    """Hide causes, diagnose them from the data alone, open the labels, print the score: misses first.

    Kinds: one effect; a quarter of its size; null; pair and triple; outside (in no library); background (everything
    5 % wrong and one effect); solver (another simulator setting); local (one joint or fingertip).
    """
    from candata.gap.blind.cases import CASES, LABELS, TRAINING_SALT
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
        run = _Run(out, cases, labels, crew, seed, None, baseline_names, baseline_cases, stop_time, follow)
        with nullcontext() if out == folder else bench_lock(out):
            _diagnose_and_score(run, json)


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
        _diagnose_and_score(
            _Run(out, cases, labels, crew, seed, scene, baseline_names, baseline_cases, stop_time), json
        )


def _cases_and_labels(cases: Path, labels: Path | None) -> tuple[Path, Path]:
    """Return the folder of cases and the file of their labels, both found in a bench's folder where that is given.

    Raises
    ------
    UsageError
        When no labels are given, and none are there.
    """
    from candata.errors import UsageError, Where
    from candata.gap.blind.cases import CASES, LABELS

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


@dataclass(frozen=True)
class _Run:
    """What is diagnosed and scored, and how."""

    out: Path
    cases: Path
    labels: Path
    crew: Crew
    seed: int
    scene: str | None
    baselines: tuple[str, ...]
    baseline_cases: int
    until: float
    follow: bool = False


def _diagnose_and_score(run: _Run, json: bool) -> None:
    """Diagnose what is not yet, open the labels, write and print the score."""
    from candata.gap.blind.cases import open_labels, read_cases, read_labels, scene_of
    from candata.gap.blind.opening import opened
    from candata.gap.blind.running import Place, run_cases
    from candata.gap.blind.running import known as standing_results
    from candata.gap.blind.scoring import score_run
    from candata.gap.blind.shares import measure_shares
    from candata.reports.bench import bench_text, write_bench

    cases = read_cases(run.cases)
    places = [
        Place(path, run.scene or scene_of(path, case), case.sealed, case.noise_declared) for path, case in cases.items()
    ]
    present_results = standing_results(run.out)
    places_left = [p for p in places if p.sealed not in present_results]
    cache_fill = _filled_cache(run, places_left)
    with _countdown(len(places_left)) as tell:
        results = run_cases(run.out, places, crew=run.crew, seed=run.seed, told=tell, until=run.until)
    labels = open_labels(cases, read_labels(run.labels))
    done_places = [p for p in places if p.sealed in {r.sealed for r in results}]
    if len(done_places) < len(places):
        console.note(
            f"{len(done_places)} of {len(places)} cases in the time given; the same command goes on with the others"
        )
    case_count = sum(bool(labels[p.folder.name].effects) for p in done_places)
    with console.progress("weighing true causes", case_count) as advance:
        shares = measure_shares(run.out, done_places, labels, crew=run.crew, told=advance)
    outcomes = opened(places, results, labels, shares)
    follow_ups = _followed_outcomes(run, done_places, outcomes) if run.follow else []
    scenes = {p.scene for p in places}
    title = places[0].scene if len(scenes) == 1 else f"{len(scenes)} scenes"
    bench_score = score_run(outcomes, scene=title, cases=len(places), filled=cache_fill, followed=follow_ups)
    if run.baselines:
        bench_score = bench_score.model_copy(update={"baselines": _baseline_scores(run, done_places, outcomes)})
    page = write_bench(bench_score, run.out)
    console.out(bench_score.model_dump_json(indent=2) if json else bench_text(bench_score))
    console.note(f"score: {run.out / 'bench.json'}, {page}")


def _filled_cache(run: _Run, places: Sequence[Place]) -> list[FilledSignature]:
    """Return what has been simulated into the cache that the cases share, after simulating what they will need."""
    from candata.gap.blind.filling import FILLED, keep_signature, shared_tasks
    from candata.gap.blind.running import CACHE, finished, spread
    from candata.schema.bench import FilledSignature

    tasks = shared_tasks(places, run.out / CACHE, run.seed)
    if tasks:
        with console.progress("simulating effects for all cases", len(tasks)) as advance:
            for _ in spread(run.out / FILLED, keep_signature, tasks, run.crew, run.until):
                advance(1)
    return finished(run.out / FILLED, FilledSignature)


def _followed_outcomes(run: _Run, places: list[Place], outcomes: list[Outcome]) -> list[Outcome]:
    """Return the ambiguous cases diagnosed again, with what their reports proposed recorded in their worlds."""
    from candata.gap.blind.following import follow_up, proposes

    proposing = [o for o in outcomes if proposes(o.result)]
    if not proposing:
        return []
    labels = {o.label.case: o.label for o in outcomes}
    with console.progress("recording what was proposed", len(proposing)) as advance:
        results = follow_up(
            run.out, places, [o.result for o in proposing], labels, crew=run.crew, seed=run.seed, told=advance
        )
    return [replace(o, result=results[o.label.case]) for o in proposing]


def _baseline_scores(run: _Run, places: list[Place], outcomes: list[Outcome]) -> tuple[BenchFile, ...]:
    """Return the score of the diagnosis and of each baseline on the first cases."""
    from candata.gap.blind.baselines import run_baselines
    from candata.gap.blind.scoring import score_run

    first_outcomes, count = outcomes[: run.baseline_cases], len(places[: run.baseline_cases])
    labels = {o.label.case: o.label for o in outcomes}
    with console.progress("baselines", count) as advance:
        baseline_results = run_baselines(
            run.out, places[:count], labels, run.baselines, crew=run.crew, seed=run.seed, told=advance
        )
    scores = [score_run(first_outcomes, scene=places[0].scene, cases=count)]
    for method, results in baseline_results.items():
        method_outcomes = [replace(o, result=r) for o, r in zip(first_outcomes, results, strict=True)]
        scores.append(score_run(method_outcomes, scene=places[0].scene, cases=count, method=method))
    return tuple(scores)


def _kept_text(folder: Path, out: Path | None) -> str:
    """Return what stands of a run, as a clause: cases in `folder`, results in `out`."""
    from candata.gap.blind.cases import CASE, CASES
    from candata.gap.blind.running import known as standing_results

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


@contextmanager
def _countdown(total: int) -> Iterator[Callable[[CaseResult], None]]:
    """Yield what hears of each new result and says on stderr how many are done and the time left.

    The pace is that of the latest results: the first fill the cache and take longer.
    """
    stamps, done_count = deque([time.monotonic()], maxlen=LATEST_RESULTS), 0

    def tell(result: CaseResult) -> None:
        nonlocal done_count
        done_count += 1
        stamps.append(time.monotonic())
        pace_s = (stamps[-1] - stamps[0]) / (len(stamps) - 1)
        left_text = console.duration(pace_s * (total - done_count))
        console.note(f"{done_count} of {total}: {result.case}, {result.cpu_s:.1f} CPU s; about {left_text} left")

    yield tell
