"""Diagnose blind cases: each once, results appended as they come, so that a run that was killed goes on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from candata.datasets import Dataset, open_dataset
from candata.errors import CandataError
from candata.gap.blind.crew import Crew, alone
from candata.gap.diagnosis import diagnose, lasting
from candata.scenes import Scene, load_scene
from candata.schema.bench import CaseResult
from candata.schema.record import Record
from candata.schema.report import Report

RESULTS, CACHE = "results.jsonl", "cache"
Judge = Callable[[Dataset, Scene, int, Path], Report]
R = TypeVar("R", bound=Record)


class Place(NamedTuple):
    """Where a case lies: its folder, what `load_scene` takes for its scene, and the hash of its label."""

    folder: Path
    scene: str
    sealed: str

    @property
    def anywhere(self) -> tuple[str, str, str]:
        """The same in plain words that hold in any process: folder and scene file by their whole paths."""
        return str(self.folder.resolve()), lasting(self.scene), self.sealed


def judged(dataset: Dataset, scene: Scene, seed: int, cache: Path) -> Report:
    """Return candata's own report of a dataset; signatures are kept in `cache`."""
    return diagnose(dataset, scene, jobs=1, seed=seed, cache=cache).report


def run_cases(
    out: Path,
    cases: Sequence[Place],
    *,
    crew: Crew = alone,
    seed: int = 0,
    judge: Judge = judged,
    method: str = "candata",
    told: Callable[[CaseResult], None] = lambda result: None,
) -> list[CaseResult]:
    """Return a result for each case, in their order; those that stand in `results.jsonl` are taken as they are.

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
        `(dataset, scene, seed, cache) -> Report`; for other processes a function of a module.
    method : str
        What the results are filed under.
    told : callable
        Hears of each new result.
    """
    log, cache = out / RESULTS, (out / CACHE).resolve()
    standing = known(out, method)
    # Processes share the work of filling the cache: what a diagnosis costs without it, one alone can tell.
    fresh = not standing and crew is alone and not cache.exists()
    tasks = [(*p.anywhere, seed, method, fresh, judge, str(cache)) for p in cases if p.sealed not in standing]
    processes: set[int] = set()

    def first_only(result: CaseResult) -> CaseResult:
        """Return a result that is cold only where it is the first of its process."""
        known = result.process in processes
        processes.add(result.process)
        return result.model_copy(update={"cold": result.cold and not known})

    for result in spread(log, run_case, tasks, crew, first_only):
        standing[result.sealed] = result
        told(result)
    return [standing[p.sealed] for p in cases]


def known(out: Path, method: str = "candata") -> dict[str, CaseResult]:
    """Return the results that stand in a folder, by the hash of the case's label."""
    return {r.sealed: r for r in finished(out / RESULTS, CaseResult) if r.method == method}


def spread(
    log: Path,
    work: Callable[..., R],
    tasks: Sequence[tuple[Any, ...]],
    crew: Crew,
    last: Callable[[R], R] = lambda record: record,
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
    last : callable
        Completes a record here, in the order of the log.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as file:
        for record in map(last, crew(work, tasks)):
            file.write(record.model_dump_json() + "\n")
            file.flush()
            os.fsync(file.fileno())
            yield record


def run_case(
    folder: str, scene: str, sealed: str, seed: int, method: str, fresh: bool, judge: Judge, cache: str
) -> CaseResult:
    """Return the result of one case.

    A method that fails on a case has not solved it: the failure is the result.
    """
    path = Path(folder)
    world = load_scene(scene)
    start, report, error = time.process_time(), None, None
    try:
        report = judge(open_dataset(path), world, seed, Path(cache))
    except CandataError as problem:
        error = problem.problem
    spent = time.process_time() - start
    return CaseResult(
        case=path.name,
        sealed=sealed,
        method=method,
        cpu_s=spent,
        cold=fresh,
        process=os.getpid(),
        report=report,
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
    return [record.parse(json.loads(line), path) for line in lines[:-1] if line]
