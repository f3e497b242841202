"""What a diagnosis says whose budget is spent: what is known by then, and what was not looked at."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np

from candata.datasets import Dataset
from candata.gap.data.recordings import title
from candata.gap.fit.comparison import null_level
from candata.gap.fit.problem import Problem, SoFar, fit_one
from candata.gap.fit.stage import Stage
from candata.gap.measure.floor import REPLICAS, WORLDS
from candata.gap.measure.symptoms import acts_on, locate, slides, symptoms
from candata.gap.replay.budget import Budget
from candata.gap.replay.replayer import needs_simulation
from candata.gap.run.pace import REST
from candata.gap.screening.episodes import first_look
from candata.gap.screening.look import unheld
from candata.gap.screening.signature_screen import respond, screening
from candata.gap.search.outlook import first_cause
from candata.gap.validation.closure import HeldOut, gap, held_out, measures
from candata.gap.verdict.conclusion import ranked, typical_size
from candata.gap.verdict.exhibits import collinearity, elements
from candata.gap.verdict.figures import EpisodeLosses, Evidence
from candata.gap.verdict.findings import Diagnosis, simulator
from candata.gap.verdict.provenance import data_used, given_note, provenance
from candata.gap.verdict.regime import with_regimes
from candata.scenes import Scene
from candata.schema.report import DiagnosisData, EpisodeCount, RankedEffect, Report, Symptom, UnknownCause

#: Said of an effect that was not looked at.
NOT_LOOKED_AT = "not looked at: the budget was spent"


def unfinished(dataset: Dataset, scene: Scene, sofar: SoFar, budget: Budget) -> Diagnosis:
    """Return what is known where a budget was spent: the gap, where it shows, and the effects that were looked at.

    None of them is named: what was found was not asked for on null recordings, nor compared with all of its rivals.
    Nothing is simulated.

    Parameters
    ----------
    dataset : Dataset
    scene : Scene
    sofar : SoFar
        What the search has come to know.
    budget : Budget
        The one that was spent.
    """
    problem = sofar.problem
    if problem is None:
        return _nothing_compared(dataset, scene, sofar, budget)
    first, others = (sofar.first, ()) if sofar.first else _looked_at(problem)
    held, score = held_out(problem, None), problem.score
    size = gap(held.size_before, held.size_after, problem.stream("gap"), gap_left=False)
    is_gap = bool(score.loss(problem.nominal).mean() > null_level(score))
    heat = locate(problem.plan, score, problem.nominal, problem.stream("where", ()))
    where = with_regimes(symptoms(problem.plan, heat), problem) if is_gap else ()
    used, recs = data_used(dataset, problem, len(problem.recs), len(problem.recs)), sofar.recs or problem.recs
    needed = _needed(problem, budget)
    spent = f"{_spent(sofar, budget)}; {needed}"
    report = Report(
        verdict="out_of_budget",
        unknown=_unknown(problem, f"{_words(problem, sofar, first, others, is_gap)}; {needed}", held, where),
        ranking=(*ranked(first, problem), *_unseen(others)),
        gap=size,
        where=where,
        data=used.model_copy(
            update={"episodes": used.episodes.model_copy(update={"total": len(recs)}), "notes": (spent, *used.notes)}
        ),
        measures=measures(held, np.isin(scene.file.joints, slides(scene))),
        given_effects=scene.given_effects,
        provenance=provenance(scene),
    )
    losses = EpisodeLosses(
        held.recs.ids,
        held.size_before,
        held.size_after,
        *(np.quantile(score.size(score.null), q, axis=0) for q in (0.05, 0.95)),
    )
    evidence = Evidence(
        heat, losses=losses, elements=elements(problem, held, False), collinearity=collinearity(first.fits)
    )
    return Diagnosis(report, evidence, simulator(scene, ()))


def _nothing_compared(dataset: Dataset, scene: Scene, sofar: SoFar, budget: Budget) -> Diagnosis:
    """Return the verdict where not even the floor was measured."""
    recs = sofar.recs
    report = Report(
        verdict="out_of_budget",
        unknown=UnknownCause(words=f"Nothing was compared: the budget was spent at the step {_doing(sofar)!r}"),
        data=DiagnosisData(
            dataset=title(dataset),
            episodes=EpisodeCount(total=len(recs) if recs else len(dataset), folds=0, held_out=0),
            channels=tuple(recs.readings) if recs else (),
            notes=(
                f"{_spent(sofar, budget)}: give several times as much",
                *given_note(scene),
                *(recs.notes if recs else ()),
            ),
        ),
        given_effects=scene.given_effects,
        provenance=provenance(scene),
    )
    return Diagnosis(report, Evidence(), simulator(scene, ()))


def _looked_at(problem: Problem) -> tuple[Stage, tuple[str, ...]]:
    """Return the evidence of the candidates whose signatures were whole by then, and the labels of the others.

    It is that of a few episodes, each held out once.
    """
    part, index = first_look(problem)
    asked = unheld(problem, ())
    settings = {c.label: [part.setting([(c, u)]) for u in screening(c, part)] for c in asked}
    known = [c for c in asked if all(part.library.knows(s) or not needs_simulation(s) for s in settings[c.label])]
    if problem.plays_all:  # what was simulated of tosses is kept once all of it is
        known = []
    base = part.score.loss(part.nominal)
    responses, dead = respond(part, problem.nominal[index], known) if known else ([], [])
    fits = [fit_one(part, c, response, base) for c, response in responses]
    lively = sorted((f for f in fits if not f.members[0][0].is_neutral(f.members[0][1])), key=lambda f: -f.gain)
    told = {c.label for c in known}
    stage = Stage(base, np.zeros((1, len(base))), tuple(lively), inf, tuple(dead), (), (), 0.0)
    return stage, tuple(c.label for c in asked if c.label not in told)


def _unseen(labels: Sequence[str]) -> tuple[RankedEffect, ...]:
    """Return the ranking of candidates that were not looked at."""
    return tuple(RankedEffect(name=label, support=0.0, held_out_gain=0.0, reason=NOT_LOOKED_AT) for label in labels)


def _unknown(problem: Problem, words: str, held: HeldOut, where: Sequence[Symptom]) -> UnknownCause:
    """Return what is not known yet, in words, and where it shows."""
    size, unit = typical_size(problem, held, False, where[0]) if where else (None, None)
    return UnknownCause(
        acts_on=acts_on(where, slides(problem.replayer.scene)),  # type: ignore[arg-type]
        element=where[0].element if where else None,
        size=size,
        unit=unit,
        depends_on=tuple(dict.fromkeys(s.phase for s in where if s.phase))[:3],
        words=words,
    )


def _words(problem: Problem, sofar: SoFar, first: Stage, others: Sequence[str], is_gap: bool) -> str:
    """Return what is not known yet: whether what comes nearest so far is the cause."""
    best = sofar.best or next(iter(first.fits), None)
    if not is_gap:
        text = "Whether any effect shows, as the recordings differ by no more than null recordings do"
    elif best is None or best.gain <= 0:
        text = "What causes the gap"
    else:
        all_left = float((best.evidence.gain + best.evidence.loss).mean()) - 1
        episodes = "held-out episodes" if sofar.first else f"the {len(first.base)} episodes looked at first"
        gain = f"{best.gain:.2g} of {all_left:.2g} floors on {episodes}"
        text = f"Whether {' and '.join(best.labels)}, nearest so far ({gain}), is the cause"
    seen = len(others) + len(first.fits) + len(first.dead) + len(first.idle) + len(first.faint)
    effects = f"{len(others)} of {seen} effects, " if others else ""
    return f"{text}: not looked at were {effects}all of its rivals, further causes and null recordings"


def _spent(sofar: SoFar, budget: Budget) -> str:
    """Return that a budget was spent, and where."""
    return f"the budget of {budget.seconds:g} CPU s was spent at the step {_doing(sofar)!r}"


def _needed(problem: Problem, budget: Budget) -> str:
    """Return what budget a whole search takes, by the pace so far and what is planned."""
    forecast = problem.pace.forecast
    replay_s = budget.spent / max(forecast.done, 1.0)
    least = replay_s * (1 + REPLICAS + WORLDS + first_cause(problem).least + REST.least)
    most = budget.spent + replay_s * forecast.left
    return f"a whole search takes about {max(least, budget.spent):.0f} to {max(least, most):.0f} CPU s"


def _doing(sofar: SoFar) -> str:
    """Return what was being done, without the time that it was said to take."""
    return sofar.step.partition(" (")[0].partition(":")[0]
