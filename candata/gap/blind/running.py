"""Diagnose blind cases: each once, results appended as they come, so that a run that was killed goes on."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import TypeVar

from candata.datasets import Dataset, open_dataset
from candata.errors import CandataError
from candata.gap.diagnosis import diagnose
from candata.scenes import Scene, load_scene
from candata.schema.bench import CaseResult
from candata.schema.record import Record
from candata.schema.report import Report
from candata.simulate.pool import spawned

RESULTS = "results.jsonl"
Judge = Callable[[Dataset, Scene, int], Report]
R = TypeVar("R", bound=Record)


def judged(dataset: Dataset, scene: Scene, seed: int) -> Report:
    """Return candata's own report of a dataset."""
    return diagnose(dataset, scene, jobs=1, seed=seed).report


def run_cases(
    out: Path,
    cases: Sequence[tuple[Path, str]],
    *,
    jobs: int = 1,
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
    cases : sequence of (Path, str)
        Folder of each case, and what `load_scene` takes for its scene.
    jobs : int
        Processes; with one the work is done here.
    seed : int
        Seed of each diagnosis.
    judge : callable
        `(dataset, scene, seed) -> Report`; with several processes a function of a module.
    method : str
        What the results are filed under.
    told : callable
        Hears of each new result.
    """
    log = out / RESULTS
    standing = {r.case: r for r in read_lines(log, CaseResult) if r.method == method}
    tasks = [(str(f), scene, seed, method, not standing, judge) for f, scene in cases if f.name not in standing]
    out.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as file:
        for result in _spread(tasks, jobs):
            file.write(result.model_dump_json() + "\n")
            file.flush()
            os.fsync(file.fileno())
            standing[result.case] = result
            told(result)
    return [standing[folder.name] for folder, _ in cases]


def _spread(tasks: list[tuple[str, str, int, str, bool, Judge]], jobs: int) -> Iterator[CaseResult]:
    """Yield results as they come, from here or from worker processes."""
    seen: set[int] = set()
    if jobs == 1 or len(tasks) < 2:
        for task in tasks:
            yield _cold(*run_case(*task), seen)
        return
    with spawned(min(jobs, len(tasks))) as pool:
        for done in as_completed([pool.submit(run_case, *task) for task in tasks]):
            yield _cold(*done.result(), seen)


def _cold(result: CaseResult, process: int, seen: set[int]) -> CaseResult:
    """Return a result that is cold only where it is the first of its process."""
    first = process not in seen
    seen.add(process)
    return result.model_copy(update={"cold": result.cold and first})


def run_case(folder: str, scene: str, seed: int, method: str, fresh: bool, judge: Judge) -> tuple[CaseResult, int]:
    """Return the result of one case, and which process made it.

    A method that fails on a case has not solved it: the failure is the result.
    """
    path = Path(folder)
    world = load_scene(scene)
    start, report, error = time.process_time(), None, None
    try:
        report = judge(open_dataset(path), world, seed)
    except CandataError as problem:
        error = problem.problem
    spent = time.process_time() - start
    result = CaseResult(case=path.name, method=method, cpu_s=spent, cold=fresh, report=report, error=error)
    return result, os.getpid()


def read_lines(path: Path, record: type[R]) -> list[R]:
    """Return the records of a file of JSON lines; a last line that a kill cut short is no record."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")
    if lines[-1]:
        with path.open("r+", encoding="utf-8") as file:
            file.truncate(len("\n".join(lines[:-1]).encode()) + (1 if len(lines) > 1 else 0))
    return [record.parse(json.loads(line), path) for line in lines[:-1] if line]
