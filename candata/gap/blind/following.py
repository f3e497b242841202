"""Ambiguous cases followed up: the motion that the report proposes is recorded in the hidden world, and all is
diagnosed again. Whether that names the cause is what the proposal is worth.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from candata.datasets import append, create_dataset, open_dataset
from candata.gap.blind.cases import hidden_world
from candata.gap.blind.crew import Crew, alone
from candata.gap.blind.running import CACHE, Place, finished, spread
from candata.gap.diagnosis import diagnose
from candata.gap.proposal import PLAYED
from candata.scenes import load_scene
from candata.schema.bench import CaseResult, Label
from candata.schema.manifest import Lineage
from candata.simulate.episodes import Job

FOLLOWED, FOLDER, METHOD = "followed.jsonl", "followed", "followed up"


def follow_up(
    out: Path,
    cases: Sequence[Place],
    results: Sequence[CaseResult],
    labels: dict[str, Label],
    *,
    crew: Crew = alone,
    seed: int = 0,
    told: Callable[[int], None] = lambda count: None,
) -> dict[str, CaseResult]:
    """Return what a second diagnosis said of each case whose first one proposed a motion, by the case's name.

    Parameters
    ----------
    out : Path
        Folder of the run; what stands in `followed.jsonl` is taken as it is.
    cases : sequence of Place
        Where each case lies.
    results : sequence of CaseResult
        What the first diagnoses said.
    labels : dict of str to Label
        The truth of each case: the world in which the motion is recorded.
    crew : Crew
        Who does the work.
    seed : int
        Seed of each diagnosis.
    told : callable
        Called with 1 for each case just done.
    """
    asked = {r.sealed for r in results if proposes(r)}
    standing = {r.sealed: r for r in finished(out / FOLLOWED, CaseResult)}
    cache = str((out / CACHE).resolve())
    tasks = [
        (*p.anywhere, seed, labels[p.folder.name].model_dump_json(), str((out / FOLDER).resolve()), cache)
        for p in cases
        if p.sealed in asked - set(standing)
    ]
    for found in spread(out / FOLLOWED, follow_case, tasks, crew):
        standing[found.sealed] = found
        told(1)
    return {p.folder.name: standing[p.sealed] for p in cases if p.sealed in asked}


def proposes(result: CaseResult) -> bool:
    """Tell whether a case was ambiguous and its report holds a motion that can be played."""
    report = result.report
    return bool(report and report.ambiguous_class and report.next_motion and report.next_motion.file)


def follow_case(folder: str, scene_name: str, sealed: str, seed: int, label: str, out: str, cache: str) -> CaseResult:
    """Return the result of a case with the proposed motion recorded beside its own; runs in any process.

    The first diagnosis is done again, as its motion was not kept; should it be ambiguous no more, that is the result.
    """
    path, scene, truth = Path(folder), load_scene(scene_name), Label.model_validate_json(label)
    start, case = time.process_time(), open_dataset(path)
    found = diagnose(case, scene, jobs=1, seed=seed, cache=Path(cache))
    if found.motion:
        (motion,) = found.motion
        plans = [
            Job(f"next-{i:04d}", len(case) + i, motion.name, seed, truth.effects, hidden=True,
                noise_seed=truth.seed, motion=motion)
            for i in range(PLAYED)
        ]  # fmt: skip
        both = Path(out) / path.name
        shutil.rmtree(both, ignore_errors=True)
        create_dataset(both, path.name)
        append(both, [*case, *hidden_world(scene, truth, plans)], Lineage(operation="blind case", sealed=sealed))
        found = diagnose(open_dataset(both), scene, jobs=1, seed=seed, cache=Path(cache))
    spent = time.process_time() - start
    return CaseResult(
        case=path.name,
        sealed=sealed,
        method=METHOD,
        cpu_s=spent,
        cold=False,
        process=os.getpid(),
        report=found.report,
    )
