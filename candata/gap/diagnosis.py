"""The diagnosis: floor, where, which, how far, and a verdict - from a dataset of recordings and a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.errors import DataError
from candata.gap.data.recordings import Recordings, title
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem, SoFar
from candata.gap.fit.world_floor import in_world
from candata.gap.measure.repeats import deviation_of_others
from candata.gap.preparation import Posed, Progress, posed
from candata.gap.replay.budget import Budget, BudgetSpent
from candata.gap.replay.replayer import ReplayedSteps, Replayer
from candata.gap.replay.residuals import residual
from candata.gap.run.pace import FORCE, REST, Forecast
from candata.gap.search.attribution import Attribution, attribute
from candata.gap.search.outlook import say_outlook
from candata.gap.validation.closure import HeldOut, gap, held_out
from candata.gap.validation.null_test import leaves_gap, with_names_tested
from candata.gap.verdict.calibration import reference_fit, with_calibration
from candata.gap.verdict.conclusion import concluded, too_little
from candata.gap.verdict.edit_test import FEW_REPLICAS, replayed
from candata.gap.verdict.findings import Diagnosis, Findings
from candata.gap.verdict.interruption import unfinished
from candata.gap.verdict.verdict import verdict
from candata.scenes import Scene
from candata.scenes.traits import is_toss
from candata.simulate import with_effects

Array = NDArray[np.float64]


def diagnose(
    dataset: Dataset,
    scene: Scene,
    *,
    jobs: int = 1,
    seed: int = 0,
    cache: Path | None = None,
    only: tuple[str, ...] = (),
    against: Dataset | None = None,
    budget: float | None = None,
    calibrate: bool = True,
    shared_signatures: bool = False,
    progress: Progress = lambda stage: None,
    ends: Callable[[float], None] = lambda ends_s: None,
) -> Diagnosis:
    """Return where recordings and simulator differ, which effect causes it, and how far the gap shrinks.

    Parameters
    ----------
    dataset : Dataset
        Recordings of the real world (or of a stand-in) on the scene's joints.
    scene : Scene
        The nominal simulator; `candata.simulate.with_effects` makes effects part of it.
    jobs : int
        Threads that step simulations; the result does not depend on it.
    seed : int
        Seed of folds, null replays and resamples.
    cache : Path, optional
        Folder in which what effects do is kept for the next diagnosis of the same recordings; nothing is kept by
        default. The result does not depend on it.
    only : tuple of str
        Effects to search among; all that can act and show by default.
    against : Dataset, optional
        Recordings from before a change, or of another machine: what the simulator leaves open in them is no news, and
        the diagnosis is of what changed since.
    budget : float, optional
        CPU seconds, of all threads, after which it ends with the best answer so far: the verdict `out_of_budget`.
    calibrate : bool
        Whether a joint fit of all quantities is made where the verdict leaves much unexplained; no verdict depends on
        it.
    shared_signatures : bool
        Whether signatures are taken that `candata gap signatures` has put into `cache` for other recordings of the same
        commands, where there are some. They begin where those recordings did, which the report notes: the ranking of
        what comes nearest, and ties, may differ from what these recordings alone say.
    progress : callable
        Called with the name of each stage.
    ends : callable
        Called with the latest time [s, of `time.monotonic`] by which the search ends, each time that it is known
        better. It moves later only where more is to be done than was planned, which `progress` then says.

    Raises
    ------
    UnknownNameError, UsageError
        When `only` names an effect that is not there, or that cannot act or show here; when the budget is no time.
    DataError
        When the dataset is empty or does not fit the scene, or when commands, poses or forces are not what the schema
        says they are.
    """
    limit = None if budget is None else Budget(budget)
    sofar, forecast, replayed_steps = SoFar(), Forecast(ends), ReplayedSteps()

    def tell(step: str) -> None:
        sofar.step = step
        progress(step)

    def replayer() -> Replayer:
        made = replayed_steps.watched(Replayer(scene, jobs, forecast.count))
        return limit.watched(made) if limit else made

    try:
        if against is not None and not scene.given_effects:
            tell("fitting the scene to the reference")
            scene = _near(against, replayer(), seed)
        some = posed(
            dataset,
            replayer(),
            seed,
            cache,
            only,
            tell,
            share=None if shared_signatures else False,
            forecast=forecast,
            sofar=sofar,
            against=against,
        )
        diagnosis = _searched(dataset, scene, some, calibrate)
    except BudgetSpent as spent:
        diagnosis = unfinished(dataset, scene, sofar, spent.budget)
    if sofar.recs is not None:
        episodes, rows = sofar.recs.commands.shape[:2]
        diagnosis = replace(diagnosis, replays=replayed_steps.steps / (episodes * rows))
    return diagnosis if against is None else _since(diagnosis, title(against))


def _since(diagnosis: Diagnosis, reference: str) -> Diagnosis:
    """Return the diagnosis with its report naming the reference."""
    data = diagnosis.report.data.model_copy(update={"against": reference})
    return replace(diagnosis, report=diagnosis.report.model_copy(update={"data": data}))


def near_reference(reference: Dataset, scene: Scene, *, jobs: int = 1, seed: int = 0) -> Scene:
    """Return the scene with the effects that bring it nearest to reference recordings.

    `diagnose` does so itself; what it returned for one diagnosis serves others against the same reference. Parameters
    are those of `diagnose`.
    """
    return _near(reference, Replayer(scene, jobs), seed)


def _near(reference: Dataset, replayer: Replayer, seed: int) -> Scene:
    """Return the scene of a replayer with the effects that bring it nearest to reference recordings."""
    try:
        problem = posed(reference, replayer, seed, None).problem
    except DataError:  # what contradicts the scene in both data sets is no news
        return replayer.scene
    return replayer.scene if problem is None else with_effects(replayer.scene, reference_fit(problem))


def _searched(dataset: Dataset, scene: Scene, some: Posed, calibrate: bool) -> Diagnosis:
    """Return the diagnosis of the problem that a dataset poses."""
    everything, untouched, problem = some
    if problem is None:
        return too_little(dataset, scene, everything)
    say_outlook(problem)
    found = with_names_tested(problem, attribute(problem))
    # What no effect explains is described as a force in the end.
    described = found.remains and not is_toss(scene)
    problem.pace.say("measuring on held-out episodes", REST, after=FORCE.most + REST.most if described else 0.0)
    world = replace(problem, score=found.score)
    held = held_out(world, found.chosen)
    if len(untouched):
        world, held = _untouched(world, everything.take(untouched), found.chosen)
    if found.chosen and not leaves_gap(problem, ()) and _fails(problem, found, held):
        # What does not pass says nothing where there is no gap: nulls of a chaotic world hold as much.
        found = replace(found, chosen=None, tied=(), rivals=(), score=problem.score, remains=False)
        world, held = problem, held_out(problem, None)
    findings = Findings(dataset, scene, problem, found, world, held, len(everything))
    diagnosis = concluded(findings)

    def measured(fit: Fit) -> HeldOut:
        if len(untouched):
            return _untouched(problem, everything.take(untouched), fit)[1]
        return held_out(in_world(problem, fit.members), fit)

    return with_calibration(findings, diagnosis, measured) if calibrate else diagnosis


def _fails(problem: Problem, found: Attribution, held: HeldOut) -> bool:
    """Tell whether what was chosen does not pass on held-out episodes."""
    size = gap(held.size_before, held.size_after, problem.streams.of("gap", held.recs.ids), gap_left=True)
    return verdict(found, size, problem.measured) == "unknown_effect"


def _untouched(problem: Problem, recs: Recordings, fit: Fit | None) -> tuple[Problem, HeldOut]:
    """Return the problem and the evidence on episodes that took no part in the search."""
    world = problem.setting(fit.members) if fit else ()
    if problem.recs.slow and not recs.slow:
        recs = replace(recs, slow=deviation_of_others(problem.recs, len(recs)))
    r = replayed(problem.replayer, recs, world, problem.streams, FEW_REPLICAS, problem.noise)
    point = np.concatenate([u for _, u in fit.members]) if fit else np.zeros(0)
    points = np.repeat(point[None], len(recs), axis=0)
    raw = residual(recs, r.plan, r.before)
    new = replace(problem, recs=recs, begin=r.begin, plan=r.plan, score=r.score, before=r.before, raw=raw)
    return new, HeldOut(recs, r.before, r.after, r.size_before, r.size_after, points)
