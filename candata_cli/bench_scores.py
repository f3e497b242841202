"""What `candata gap bench` and `candata gap score` do once cases are made: diagnose, open labels, measure, print."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from candata_cli import console

if TYPE_CHECKING:
    from candata.gap.blind.outcomes import Outcome
    from candata.gap.blind.runs import Place
    from candata.schema.bench import BenchFile, CaseResult, FilledSignature, LabelsFile
    from candata.simulate.crew import Crew

#: Fresh episodes of each hidden world by default: as many as a case has.
FRESH_EPISODES = 20
#: Results whose pace tells the time left.
LATEST_RESULTS = 21


@dataclass(frozen=True)
class ScoredRun:
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
    fresh: int | None
    follow: bool = False


def diagnose_and_score(run: ScoredRun, json: bool) -> None:
    """Diagnose what is not yet, open the labels, write and print the score."""
    from candata.gap.blind.answers import opened_outcomes
    from candata.gap.blind.cases import read_cases, scene_of
    from candata.gap.blind.labels import open_labels, read_labels
    from candata.gap.blind.runs import Place, run_cases, standing_results
    from candata.gap.blind.scores import score_run
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
    sealed_labels = read_labels(run.labels)
    labels = open_labels(cases, sealed_labels)
    done_places = [p for p in places if p.sealed in {r.sealed for r in results}]
    if len(done_places) < len(places):
        console.note(
            f"{len(done_places)} of {len(places)} cases in the time given; the same command goes on with the others"
        )
    case_count = sum(bool(labels[p.folder.name].effects) for p in done_places)
    with console.progress("weighing true causes", case_count) as advance:
        shares = measure_shares(run.out, done_places, labels, crew=run.crew, told=advance)
    outcomes = _with_fresh_gaps(run, places, opened_outcomes(places, results, labels, shares), sealed_labels)
    follow_ups = _followed_outcomes(run, done_places, outcomes) if run.follow else []
    scenes = {p.scene for p in places}
    title = places[0].scene if len(scenes) == 1 else f"{len(scenes)} scenes"
    bench_score = score_run(outcomes, scene=title, cases=len(places), filled=cache_fill, followed=follow_ups)
    if run.baselines:
        bench_score = bench_score.model_copy(update={"baselines": _baseline_scores(run, done_places, outcomes)})
    page = write_bench(bench_score, run.out)
    console.out(bench_score.model_dump_json(indent=2) if json else bench_text(bench_score))
    console.note(f"score: {run.out / 'bench.json'}, {page}")


def _filled_cache(run: ScoredRun, places: Sequence[Place]) -> list[FilledSignature]:
    """Return what has been simulated into the cache that the cases share, after simulating what they will need."""
    from candata.gap.blind.runs import CACHE, finished, spread
    from candata.gap.blind.signature_library import FILLED, keep_signature, shared_tasks
    from candata.schema.bench import FilledSignature

    tasks = shared_tasks(places, run.out / CACHE, run.seed)
    if tasks:
        with console.progress("simulating effects for all cases", len(tasks)) as advance:
            for _ in spread(run.out / FILLED, keep_signature, tasks, run.crew, run.until):
                advance(1)
    return finished(run.out / FILLED, FilledSignature)


def _with_fresh_gaps(run: ScoredRun, places: list[Place], outcomes: list[Outcome], labels: LabelsFile) -> list[Outcome]:
    """Return the outcomes with how far named effects close the gap on fresh episodes of their hidden worlds.

    Raises
    ------
    UsageError
        When they are asked for, and candata cannot record more of these worlds.
    """
    from candata.errors import UsageError
    from candata.gap.blind.fresh_gaps import is_recordable, measure_fresh_gaps

    if run.fresh and not is_recordable(labels):
        raise UsageError(
            "no fresh episodes can be recorded of these cases",
            expected="cases that candata gap bench made in one scene",
            found=f"--fresh {run.fresh}",
            fix="leave --fresh out",
        )
    episodes = FRESH_EPISODES if run.fresh is None else run.fresh
    if not episodes or not is_recordable(labels):
        return outcomes
    with console.progress("recording fresh episodes", sum(bool(o.effects) for o in outcomes)) as advance:
        fresh = measure_fresh_gaps(
            run.out, places, outcomes, labels, episodes, crew=run.crew, told=advance, until=run.until
        )
    return [replace(o, fresh=fresh.get(o.label.case)) for o in outcomes]


def _followed_outcomes(run: ScoredRun, places: list[Place], outcomes: list[Outcome]) -> list[Outcome]:
    """Return the ambiguous cases diagnosed again, with what their reports proposed recorded in their worlds."""
    from candata.gap.blind.follow_up import follow_up, proposes

    proposing = [o for o in outcomes if proposes(o.result)]
    if not proposing:
        return []
    labels = {o.label.case: o.label for o in outcomes}
    with console.progress("recording what was proposed", len(proposing)) as advance:
        results = follow_up(
            run.out, places, [o.result for o in proposing], labels, crew=run.crew, seed=run.seed, told=advance
        )
    return [replace(o, result=results[o.label.case]) for o in proposing]


def _baseline_scores(run: ScoredRun, places: list[Place], outcomes: list[Outcome]) -> tuple[BenchFile, ...]:
    """Return the score of the diagnosis and of each baseline on the first cases."""
    from candata.gap.blind.answers import opened_outcomes
    from candata.gap.blind.baselines import run_baselines
    from candata.gap.blind.scores import score_run

    first_outcomes, count = outcomes[: run.baseline_cases], len(places[: run.baseline_cases])
    labels = {o.label.case: o.label for o in outcomes}
    with console.progress("baselines", count) as advance:
        baseline_results = run_baselines(
            run.out, places[:count], labels, run.baselines, crew=run.crew, seed=run.seed, told=advance
        )
    scores = [score_run(first_outcomes, scene=places[0].scene, cases=count)]
    shares = {o.label.case: o.shares for o in first_outcomes if o.shares}
    for method, results in baseline_results.items():
        method_outcomes = opened_outcomes(places[:count], results, labels, shares)
        scores.append(score_run(method_outcomes, scene=places[0].scene, cases=count, method=method))
    return tuple(scores)


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
