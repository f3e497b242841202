"""Ambiguous cases followed up: the motion that the report proposes is recorded in the hidden world, and all is
diagnosed again. Whether that names the cause is what the proposal is worth.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from candata.datasets import Dataset, append, create_dataset, open_dataset
from candata.gap.blind.cases import hidden_world
from candata.gap.blind.runs import CACHE, Answer, Place, finished, run_case, spread
from candata.gap.diagnosis import diagnose
from candata.gap.verdict.proposal import PLAYED
from candata.scenes import Scene, load_scene
from candata.schema.bench import CaseResult, Label
from candata.schema.manifest import Lineage
from candata.simulate.crew import Crew, alone
from candata.simulate.episodes import EpisodeJob

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
    tasks = []
    for p in cases:
        if p.sealed in asked - set(standing):
            both = str((out / FOLDER / p.folder.name).resolve())
            label = labels[p.folder.name].model_dump_json()
            judge = partial(second_answer, label=label, folder=both, sealed=p.sealed)
            tasks.append((*p.anywhere, seed, METHOD, judge, str((out / CACHE).resolve())))
    for found in spread(out / FOLLOWED, run_case, tasks, crew):
        standing[found.sealed] = found
        told(1)
    return {p.folder.name: standing[p.sealed] for p in cases if p.sealed in asked}


def proposes(result: CaseResult) -> bool:
    """Tell whether a case was ambiguous and its report holds a motion that can be played."""
    report = result.report
    return bool(report and report.ambiguous_class and report.next_motion and report.next_motion.file)


def second_answer(
    case: Dataset, scene: Scene, seed: int, cache: Path | None, *, label: str, folder: str, sealed: str
) -> Answer:
    """Return the answer to a case with the proposed motion recorded beside its own, in `folder`; a judge of cases.

    The first diagnosis is done again, as its motion was not kept; should it be ambiguous no more, that is the result.
    """
    truth = Label.model_validate_json(label)
    found = diagnose(case, scene, jobs=1, seed=seed, cache=cache, calibrate=False, shared_signatures=True)
    if not found.report.ambiguous_class or not found.motion:
        return Answer(found.report)
    turns = [found.motion[i % len(found.motion)] for i in range(PLAYED)]
    plans = [
        EpisodeJob(
            f"next-{i:04d}",
            len(case) + i,
            motion.name,
            seed,
            truth.effects,
            hidden=True,
            noise_seed=truth.seed,
            motion=motion,
        )
        for i, motion in enumerate(turns)
    ]
    both = Path(folder)
    shutil.rmtree(both, ignore_errors=True)
    create_dataset(both, both.name)
    append(
        both,
        [*case, *hidden_world(load_scene(scene.name), truth, plans)],
        Lineage(operation="blind case", sealed=sealed),
    )
    return Answer(diagnose(open_dataset(both), scene, jobs=1, seed=seed, cache=cache, calibrate=False).report)
