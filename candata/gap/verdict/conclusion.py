"""What a diagnosis says in the end: the verdict, the named effects and the ranking, from all that was found."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.effects import rail_units
from candata.gap.data.recordings import Recordings, title
from candata.gap.fit.candidates import Candidate
from candata.gap.fit.fits import Fit
from candata.gap.fit.folds import FEWEST
from candata.gap.fit.problem import Problem
from candata.gap.fit.stage import Stage
from candata.gap.fit.world_floor import in_units
from candata.gap.force.remedy import mended
from candata.gap.measure.symptoms import acts_on, locate, slides, symptoms
from candata.gap.replay.replayer import EffectSet
from candata.gap.replay.residuals import residual
from candata.gap.validation.closure import HeldOut, gap, measures, shares, support, trust
from candata.gap.validation.profile import Known, known_numbers
from candata.gap.verdict.example import example
from candata.gap.verdict.exhibits import collinearity, elements, ranges
from candata.gap.verdict.figures import EpisodeLosses, Evidence
from candata.gap.verdict.findings import Diagnosis, Findings, judged_problem, simulator
from candata.gap.verdict.proposal import separating, usual_proposal
from candata.gap.verdict.provenance import data_used, given_note, provenance
from candata.gap.verdict.regime import with_regimes
from candata.gap.verdict.unknown_cause import Described, describe, described, outdoing, unseating
from candata.gap.verdict.verdict import class_of, unnamed_cause, verdict
from candata.scenes import Scene
from candata.scenes.traits import is_toss
from candata.schema.effect import Value
from candata.schema.report import (
    DiagnosisData,
    EpisodeCount,
    Estimate,
    Gap,
    NamedEffect,
    RankedEffect,
    Report,
    Symptom,
    Verdict,
)
from candata.statistics import resamples

Array = NDArray[np.float64]
#: Share of what is possible within which a number counts as at its bound. Chosen.
NEAR_BOUND = 0.01


def concluded(f: Findings) -> Diagnosis:
    """Return the diagnosis drawn from all findings."""
    chosen = f.attribution.chosen
    is_left = chosen is not None or f.attribution.remains
    ids = f.held.recs.ids
    rng = f.problem.streams.of("gap", ids)
    size = gap(f.held.size_before, f.held.size_after, rng, gap_left=is_left, ids=ids if chosen else ())
    word = verdict(f.attribution, size, f.problem.measured)
    heat = locate(f.problem.plan, f.problem.score, f.problem.nominal, f.problem.stream("where", ()))
    where = symptoms(f.problem.plan, heat) if word != "no_gap" else ()
    where = with_regimes(where, f.problem)
    better = _unseated(f, word, size, where)
    word = "unknown_effect" if better else word
    left = where
    if word == "partly_explained":
        after = f.world.score.normal(residual(f.held.recs, f.world.plan, f.held.after))
        rng = f.world.stream("where", f.problem.setting(chosen.members if chosen else ()))
        left = symptoms(f.world.plan, locate(f.world.plan, f.world.score, after, rng))
    typical, unit = typical_size(f.world, f.held, chosen is not None, left[0]) if left else (None, None)
    proposed, motion = separating(judged_problem(f), f.attribution) if word == "ambiguous" else (None, ())
    named: tuple[NamedEffect, ...] = ()
    repaired: EffectSet = ()
    if chosen and word in ("explained", "partly_explained"):
        ends = known_numbers(judged_problem(f), chosen)
        named = _named(f, chosen, ends, trust(size))
        repaired = f.problem.setting(chosen.split(ends.value))
    rest = better or _rest(f, word, repaired, left)
    report = Report(
        verdict=word,
        effects=named,
        ambiguous_class=class_of(f.attribution.tied) if word == "ambiguous" else (),
        unknown=rest.unknown
        if rest
        else unnamed_cause(word, f.attribution, left, acts_on(left, slides(f.scene)), typical, unit),
        ranking=ranked(f.attribution.first, f.problem),
        gap=size,
        where=where,
        next_motion=proposed,
        data=data_used(f.dataset, f.problem, f.episodes, len(f.held.recs)),
        measures=measures(f.held, np.isin(f.scene.file.joints, slides(f.scene))),
        given_effects=f.scene.given_effects,
        provenance=provenance(f.scene),
    )
    losses = EpisodeLosses(
        f.held.recs.ids,
        f.held.size_before,
        f.held.size_after,
        *(np.quantile(f.world.score.size(f.world.score.null), q, axis=0) for q in (0.05, 0.95)),
    )
    shown = example(f.world, f.held, chosen if named else None)
    evidence = Evidence(
        heat,
        shown,
        losses,
        elements(f.world, f.held, bool(named)),
        collinearity(f.attribution.first.fits),
        ranges(named, f.scene),
    )
    stand_in = (*repaired, *rest.stopgap) if rest and rest.stopgap else ()
    stopgap = simulator(f.scene, stand_in) if stand_in else None
    return Diagnosis(report, evidence, simulator(f.scene, repaired), motion, stopgap, named=repaired)


def _unseated(f: Findings, word: Verdict, size: Gap, where: Sequence[Symptom]) -> Described | None:
    """Return a force that explains clearly more than what would be named, or be left tied; None where none does.

    No less is enough where that leaves more than right names do. (For a motor that cogs, two faults of its joint were
    tied that closed 44 %; the force closes 83 %.)
    """
    nearest = f.attribution.first.fits[0].labels[0] if f.attribution.first.fits else None
    if f.attribution.force:
        return described(f.attribution.force, (), where, nearest)
    if word in ("no_gap", "unknown_effect") or nearest is None:
        return None
    problem, chosen, doubt = judged_problem(f), f.attribution.chosen, f.attribution.doubt
    closed = size.closed or 0.0
    force = cache(lambda: mended(problem, ()) if doubt is None or doubt.may_close(closed) else None)
    found = unseating(force, size, where, nearest)
    if found or chosen is None or is_toss(f.scene):
        return found
    return outdoing(problem, force, size, f.problem.setting(chosen.members), where, nearest)


def _rest(f: Findings, word: Verdict, repaired: EffectSet, left: Sequence[Symptom]) -> Described | None:
    """Return what remains unexplained as a force; None where nothing remains, or none stands out."""
    if word not in ("unknown_effect", "partly_explained"):
        return None
    fits = f.attribution.first.fits
    nearest = fits[0].labels[0] if fits and word == "unknown_effect" else None
    if repaired or f.attribution.doubt is None:
        return describe(judged_problem(f) if repaired else f.problem, repaired, left, nearest)
    found = f.attribution.doubt.lone.of_all
    return described(found, (), left, nearest) if found else None


def typical_size(world: Problem, held: HeldOut, repaired: bool, where: Symptom) -> tuple[float, str]:
    """Return the 68 % quantile of the residual's size where a symptom shows, and its unit."""
    readings = held.after if repaired else held.before
    column = [(c, e) for c, e, _ in world.plan.columns].index((where.channel, where.element or ""))
    size = np.abs(residual(held.recs, world.plan, readings)[..., column])
    return float(np.nanquantile(size, 0.68)), world.plan.columns[column][2]


def _named(f: Findings, fit: Fit, ends: Known, trusted: float) -> tuple[NamedEffect, ...]:
    """Return the chosen effects, the largest share first; their support counts as far as the set is `trusted`."""
    alone = _support_alone(f, fit)
    pieces = zip(
        fit.members, _estimates(f, fit, ends), shares(judged_problem(f), fit, f.attribution.rivals), strict=True
    )
    out = []
    for (c, u), estimates, (share, backing) in pieces:
        out.append(
            NamedEffect(
                name=c.name,
                element=c.element,
                share=share,
                at_bound=_is_at_bound(c, u),
                support=round(trusted * (alone if np.isnan(backing) else backing), 3),
                parameters=estimates,
                rivals=tuple(dict.fromkeys(_instead(fit, r) for r in f.attribution.rivals if c.label not in r.labels)),
            )
        )
    return tuple(sorted(out, key=lambda e: -e.share))


def _support_alone(f: Findings, fit: Fit) -> float:
    """Return the share of resampled sets of episodes in which a set explains more than each effect of the first look.

    A set of one effect that was looked at there counts as it was found there, like its rivals.
    """
    first = f.attribution.first
    own = next((g for g in first.fits if g.labels == fit.labels), None)
    own = own or in_units(fit, judged_problem(f), f.problem)
    others = [g for g in first.fits if g.labels != fit.labels]
    return float(support((own, *others), first.base, f.problem.stream("support"))[0])


def _instead(fit: Fit, other: Fit) -> str:
    """Return what another set has in place of a member of this one."""
    return next(name for name in other.labels if name not in fit.labels)


def _estimates(f: Findings, fit: Fit, ends: Known) -> list[dict[str, Estimate]]:
    """Return the parameters of each member with their intervals; an end that is not known is null."""
    out = []
    start = 0
    for c, _ in fit.members:
        own = slice(start, start + c.size)
        start += c.size
        at, low, high = (c.setting(u[own], f.scene).parameters for u in (ends.value, ends.low, ends.high))
        units = rail_units(c.name, f.scene, c.element)
        low, high = {} if ends.no_low[own].any() else low, {} if ends.no_high[own].any() else high
        out.append({n: _estimate(at[n], low.get(n), high.get(n), units.get(n)) for n in at})
    return out


def _estimate(value: Value, low: Value | None, high: Value | None, unit: str | None) -> Estimate:
    """Return a parameter with its interval; a choice has none."""
    if isinstance(low, str) or isinstance(high, str):
        return Estimate(value=value)
    return Estimate(value=value, low=low, high=high, unit=unit)


def _is_at_bound(c: Candidate, u: Array) -> bool:
    """Tell whether a number stopped at a bound that is not the effect's own absence: beyond may be its true value."""
    near = NEAR_BOUND * (c.high - c.low)
    ends = [(np.abs(u - end) < near) & (np.abs(c.neutral - end) >= near) for end in (c.low, c.high)]
    return not c.choices and bool(np.any(ends))


def ranked(first: Stage, problem: Problem) -> tuple[RankedEffect, ...]:
    """Return every candidate alone with its held-out gain and a 90 % interval, best first; dead ones last."""
    backing = support(first.fits, first.base, problem.stream("support"))
    picks = resamples(problem.stream("ranking"), len(first.base), 500)
    out = []
    for fit, s in zip(first.fits, backing, strict=True):
        gain = fit.evidence.gain
        low, high = np.quantile(gain[picks].mean(1), (0.05, 0.95))
        c, u = fit.members[0]
        out.append(
            RankedEffect(
                name=c.name,
                element=c.element,
                support=round(float(s), 3),
                held_out_gain=round(fit.gain, 4),
                gain_low=round(float(low), 4),
                gain_high=round(float(high), 4),
                parameters=c.setting(u, problem.replayer.scene).parameters,
            )
        )
    reasons = [
        *((d, "gains little on the episodes looked at first") for d in first.faint),
        *((d, "best left out") for d in first.idle),
        *((d, "moves nothing in these motions") for d in first.dead),
    ]
    dead = [RankedEffect(name=d, support=0.0, held_out_gain=0.0, reason=reason) for d, reason in reasons]
    return (*out, *dead)


def too_little(dataset: Dataset, scene: Scene, recs: Recordings) -> Diagnosis:
    """Return the verdict that there are too few episodes, or none that moves."""
    few = [f"{len(recs)} episodes; at least {FEWEST} are needed to hold any out"] * (len(recs) < FEWEST)
    proposed, motion = usual_proposal(scene, recs, FEWEST)
    report = Report(
        verdict="too_little_data",
        data=DiagnosisData(
            dataset=title(dataset),
            episodes=EpisodeCount(total=len(recs), folds=0, held_out=0),
            channels=tuple(recs.readings),
            notes=(*few, *given_note(scene), *recs.notes),
        ),
        given_effects=scene.given_effects,
        next_motion=proposed,
        provenance=provenance(scene),
    )
    return Diagnosis(report, Evidence(), simulator(scene, ()), motion)
