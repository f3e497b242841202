"""Calibration: a better simulator where the search leaves much unexplained, by a joint fit that claims no names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from candata.effects import effect
from candata.gap.fit.candidates import Candidate, candidates, typical_size
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem
from candata.gap.replay.budget import BudgetSpent
from candata.gap.replay.replayer import EffectSet
from candata.gap.run.pace import Span
from candata.gap.search.attribution import Attribution
from candata.gap.search.joint_fit import ROUGH, JointFit, joint_fit
from candata.gap.validation.closure import HeldOut, gap
from candata.gap.validation.null_test import SURE_GAP, leaves_gap
from candata.gap.verdict.findings import Diagnosis, Findings, simulator
from candata.gap.verdict.verdict import PARTLY
from candata.scenes.traits import is_toss
from candata.schema.report import Calibration, Gap, Verdict

#: Verdicts beside which a calibration is made.
VERDICTS: tuple[Verdict, ...] = ("unknown_effect", "partly_explained")
#: Most replays of all episodes that a calibration takes, and most as a share of those that the diagnosis asked for
#: before. Chosen: a pendulum of six wrong quantities takes 250; of a diagnosis that asked for few, with a share of 0.5
#: it took 43 % of the CPU time, with 0.33 40 %: some replays are asked for twice, and fitting takes time too.
MOST_REPLAYS, SHARE = 300.0, 0.25
#: Said where the budget of the diagnosis ends before the calibration does.
NO_BUDGET = "no calibration was made: the budget was spent"
Measure = Callable[[Fit], HeldOut]


def with_calibration(findings: Findings, diagnosis: Diagnosis, measure: Measure) -> Diagnosis:
    """Return the diagnosis with a calibration, where its verdict leaves much unexplained and one closes more.

    A calibration must close at least `PARTLY` of the gap on held-out episodes, and more than the named effects do.

    Parameters
    ----------
    findings : Findings
    diagnosis : Diagnosis
        Drawn from the findings.
    measure : callable
        Gives the evidence of a fit on the episodes on which the diagnosis measured its own gap.
    """
    if diagnosis.report.verdict not in VERDICTS or is_toss(findings.scene):
        return diagnosis
    problem = findings.problem
    replays = min(MOST_REPLAYS, SHARE * problem.sofar.episodes_replayed / len(problem.recs))
    problem.pace.say("fitting all quantities together", Span(0, replays), after=1.0)
    try:
        fitted = _fitted(problem, findings.attribution, replays)
        if fitted is None:
            return diagnosis
        held = measure(fitted.fit)
    except BudgetSpent:
        data = diagnosis.report.data
        noted = data.model_copy(update={"notes": (*data.notes, NO_BUDGET)})
        return replace(diagnosis, report=diagnosis.report.model_copy(update={"data": noted}))
    size = gap(held.size_before, held.size_after, problem.streams.of("gap", held.recs.ids), gap_left=True)
    return _added(problem, diagnosis, fitted, size) if _helps(size, diagnosis) else diagnosis


def _fitted(problem: Problem, found: Attribution, replays: float) -> JointFit | None:
    """Return the joint fit of what was named and of every other effect, those first that gain most alone.

    An effect on the pace of time is a property of the recording's clock, and no repair of a simulator.
    """
    named = found.chosen.members if found.chosen else ()
    everywhere = candidates(problem.replayer.scene, problem.recs.channels)
    gains = {f.labels[0]: f.gain for f in found.first.fits}
    still = {*found.first.dead, *(c.label for c, _ in named)} | problem.ruled_out
    names = {c.name for c, _ in named}
    kinds = [c for c in everywhere if c.label not in still and c.name not in names and effect(c.name).pace is None]
    return joint_fit(problem, sorted(kinds, key=lambda c: -gains.get(c.label, 0.0)), named, replays)


def reference_fit(problem: Problem) -> EffectSet:
    """Return the effects of the joint fit to reference recordings; none where they leave no gap, or nothing helps.

    What changed is then judged in a world near the reference: the misfit that is taken off is small, and with it what
    the change does to the misfit.
    """
    if is_toss(problem.replayer.scene) or not leaves_gap(problem, (), SURE_GAP):
        return ()
    everywhere = candidates(problem.replayer.scene, problem.recs.channels)
    kinds = [c for c in everywhere if not c.choices and effect(c.name).pace is None and c.name not in problem.ruled_out]
    fitted = joint_fit(problem, _by_first_step(problem, kinds), (), MOST_REPLAYS)
    return problem.setting(fitted.fit.members) if fitted else ()


def _by_first_step(problem: Problem, kinds: Sequence[Candidate]) -> list[Candidate]:
    """Return quantities, those first along whose first step the residuals lie most; one replay each."""
    scene, at = problem.replayer.scene, problem.nominal
    steps = [np.clip(c.neutral + ROUGH * typical_size(c, scene), c.low, c.high) for c in kinds]
    moved = problem.residuals([problem.setting(((c, u),)) for c, u in zip(kinds, steps, strict=True)])
    gains = [float((at * (at - z)).sum() ** 2 / max(((at - z) ** 2).sum(), 1e-9)) for z in moved]
    order = sorted(range(len(kinds)), key=lambda i: -gains[i])
    return [kinds[i] for i in order]


def _helps(size: Gap, diagnosis: Diagnosis) -> bool:
    """Tell whether a calibration closes enough, and more than the named effects do."""
    named = diagnosis.report.gap.closed if diagnosis.report.effects and diagnosis.report.gap else None
    closed = size.closed or 0.0
    return closed >= PARTLY and (size.low or 0.0) > 0 and closed > (named or 0.0)


def _added(problem: Problem, diagnosis: Diagnosis, fitted: JointFit, size: Gap) -> Diagnosis:
    """Return the diagnosis with the calibration in its report and as a file."""
    settings = problem.setting(fitted.fit.members)
    numbers = sum(c.size for c, _ in fitted.fit.members)
    record = Calibration(effects=settings, gap=size, numbers=numbers, combinations=fitted.combinations)
    report = diagnosis.report.model_copy(update={"calibration": record})
    return replace(diagnosis, report=report, calibration=simulator(problem.replayer.scene, settings))
