"""Diagnose blind cases: each once, results appended as they come, so that a run that was killed goes on."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from math import inf
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from candata.datasets import Dataset, open_dataset
from candata.errors import CandataError
from candata.gap.blind.nominal_scene import NominalScene
from candata.gap.diagnosis import diagnose
from candata.scenes import Scene
from candata.schema.bench import CaseResult
from candata.schema.json_text import parse_json
from candata.schema.record import Record
from candata.schema.report import Report
from candata.simulate.crew import Crew, alone

RESULTS, CACHE = "results.jsonl", "cache"
#: Cases diagnosed with nothing kept, to tell what a first one costs: one, and of many one in so many, up to so many.
COLD_EACH, COLD = 40, 3
R = TypeVar("R", bound=Record)


class Answer(NamedTuple):
    """What a method says of a case, and what it simulated for it, in replays of all of its episodes."""

    report: Report
    replays: float | None = None


Judge = Callable[[Dataset, Scene, int, Path | None], Answer]


class Place(NamedTuple):
    """Where a case lies: its folder, what `load_scene` takes, the hash of its label; whether its noise is declared."""

    folder: Path
    scene: str
    sealed: str
    noise_declared: bool = True

    @property
    def nominal(self) -> NominalScene:
        """The simulator in which it is diagnosed."""
        return NominalScene(self.scene, self.noise_declared)

    @property
    def anywhere(self) -> tuple[str, NominalScene, str]:
        """The same in plain words that hold in any process: folder and scene file by their whole paths."""
        return str(self.folder.resolve()), self.nominal.anywhere, self.sealed


def judged(dataset: Dataset, scene: Scene, seed: int, cache: Path | None) -> Answer:
    """Return candata's own answer to a dataset; signatures are kept in `cache`, or not at all."""
    found = diagnose(dataset, scene, jobs=1, seed=seed, cache=cache, calibrate=False, shared_signatures=True)
    return Answer(found.report, found.replays)


def run_cases(
    out: Path,
    cases: Sequence[Place],
    *,
    crew: Crew = alone,
    seed: int = 0,
    judge: Judge = judged,
    method: str = "candata",
    told: Callable[[CaseResult], None] = lambda result: None,
    until: float = inf,
) -> list[CaseResult]:
    """Return the results of the cases, in their order; those that stand in `results.jsonl` are taken as they are.

    Parameters
    ----------
    out : Path
        Folder of the results.
    cases : sequence of Place
        Where each case lies.
    crew : Crew
        Who does the work.
    seed : int
        Seed of each diagnosis.
    judge : callable
        `(dataset, scene, seed, cache) -> Answer`; for other processes a function of a module. The first case, of many
        the first few, is diagnosed with no cache: what it costs is what a diagnosis costs that finds nothing kept. The
        same holds for a case that shares its scene with no other.
    method : str
        What the results are filed under.
    told : callable
        Hears of each new result.
    until : float
        Time [s since the epoch] from which on no case is begun: those have no result.
    """
    log, cache = out / RESULTS, (out / CACHE).resolve()
    standing = standing_results(out, method)
    sharing = Counter(p.nominal for p in cases)
    cold = {p.sealed for p in cases[: min(max(len(cases) // COLD_EACH, 1), COLD)]}
    cold |= {p.sealed for p in cases if sharing[p.nominal] == 1}
    tasks = [
        (*p.anywhere, seed, method, judge, None if p.sealed in cold else str(cache))
        for p in cases
        if p.sealed not in standing
    ]
    for result in spread(log, run_case, tasks, crew, until):
        standing[result.sealed] = result
        told(result)
    return [standing[p.sealed] for p in cases if p.sealed in standing]


def standing_results(out: Path, method: str = "candata") -> dict[str, CaseResult]:
    """Return the results that stand in a folder, by the hash of the case's label."""
    return {r.sealed: r for r in finished(out / RESULTS, CaseResult) if r.method == method}


def spread(
    log: Path,
    work: Callable[..., R],
    tasks: Sequence[tuple[Any, ...]],
    crew: Crew,
    until: float = inf,
) -> Iterator[R]:
    """Yield a record for each task as it comes, each written to the log first: what is yielded outlives a kill.

    Parameters
    ----------
    log : Path
        File of JSON lines.
    work : callable
        Makes a record of a task; for other processes a function of a module.
    tasks : sequence of tuple
        Arguments of `work`.
    crew : Crew
        Who does the work.
    until : float
        Time [s since the epoch] from which on no task is begun.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as file:
        for record in crew(in_time, [(until, work, *task) for task in tasks]):
            if record is None:
                continue
            file.write(record.model_dump_json() + "\n")
            file.flush()
            os.fsync(file.fileno())
            yield record


def in_time(until: float, work: Callable[..., R], *task: Any) -> R | None:
    """Return what `work` makes of a task; None, and nothing is done, where the time is over. Runs in any process."""
    return work(*task) if time.time() < until else None


def run_case(
    folder: str, scene: NominalScene, sealed: str, seed: int, method: str, judge: Judge, cache: str | None
) -> CaseResult:
    """Return the result of one case; without a cache it is a cold one.

    A method that fails on a case has not solved it: the failure is the result.
    """
    path = Path(folder)
    world = scene.load()
    start, answer, error = time.process_time(), None, None
    try:
        answer = judge(open_dataset(path), world, seed, Path(cache) if cache else None)
    except CandataError as problem:
        error = problem.problem
    spent = time.process_time() - start
    return CaseResult(
        case=path.name,
        sealed=sealed,
        method=method,
        cpu_s=spent,
        cold=cache is None,
        process=os.getpid(),
        replays=answer.replays if answer else None,
        report=answer.report if answer else None,
        error=error,
    )


def finished(path: Path, record: type[R]) -> list[R]:
    """Return the records of a file of JSON lines; a last line that a kill cut short is no record."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")
    if lines[-1]:
        with path.open("r+", encoding="utf-8") as file:
            file.truncate(len("\n".join(lines[:-1]).encode()) + (1 if len(lines) > 1 else 0))
    return [record.parse(parse_json(line), path) for line in lines[:-1] if line]
