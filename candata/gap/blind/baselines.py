"""Other ways to name a cause, scored by the same code: what a diagnosis has to be better than.

`lowest_error` names the one effect with the smallest training error. `bic` adds effects while the Bayesian information
criterion falls. `one_se` adds effects by cross-validation and takes the smallest set within one standard error of the
best, without a floor. `commonest` always names what is hidden most often. `oracle` is told the causes and fits their
numbers: what is left to it no search can close.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset, open_dataset
from candata.gap.blind.bed import Bed, make_bed
from candata.gap.blind.nominal_scene import NominalScene
from candata.gap.blind.outcomes import text_of
from candata.gap.blind.runs import Place, finished, spread
from candata.gap.blind.signatures import Signature, least_squares, signatures
from candata.gap.data.robust_loss import rho
from candata.gap.fit.candidates import Candidate, candidate, probes
from candata.gap.fit.folds import folds, rest
from candata.gap.measure.score import Compact
from candata.gap.replay.replayer import EffectSet
from candata.scenes import Scene
from candata.schema.bench import CaseResult, CaseResults, Label
from candata.schema.report import DiagnosisData, EpisodeCount, Estimate, Gap, NamedEffect, Report, UnknownCause
from candata.simulate.crew import Crew, alone

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Members = list[tuple[Candidate, Array]]
BASELINES = ("lowest_error", "bic", "one_se", "commonest", "oracle")
LOG = "baselines.jsonl"
#: Episodes used, every other one to fit and to measure; largest set; rounds of the oracle's fit.
EPISODES, LARGEST, ROUNDS = 20, 3, 4
#: Step of the oracle's differences, as a share of a coordinate's range.
STEP = 0.01


def lowest_error(bed: Bed, nominal: Compact, found: Sequence[Signature], rng: np.random.Generator) -> Members:
    """Return the one effect that fits the training episodes best."""
    everything = np.arange(len(nominal))
    fits = [(s, s.fit(nominal, bed.score, everything)) for s in found]
    best, u = min(fits, key=lambda pair: float(bed.score.loss(nominal + pair[0].read(pair[1])).mean()))
    return [(best.candidate, u)]


def bic(bed: Bed, nominal: Compact, found: Sequence[Signature], rng: np.random.Generator) -> Members:
    """Return the effects that are added while `2 sum(rho) + d log(n)` falls, n being all block means.

    Source: Schwarz 1978, with the Student-t loss as the negative log-likelihood.
    """
    here, members, everything = nominal, Members(), np.arange(len(nominal))
    cost = np.log(max(int(bed.score.mask.sum()), 2))
    so_far = 2 * float(rho(here).sum(dtype=float))
    while len(members) < LARGEST:
        rest_of = [s for s in found if s.candidate.label not in {c.label for c, _ in members}]
        options = [(s, s.fit(here, bed.score, everything)) for s in rest_of]
        costs = [2 * float(rho(here + s.read(u)).sum(dtype=float)) + s.candidate.size * cost for s, u in options]
        at = int(np.argmin(costs))
        if costs[at] >= so_far:
            return members
        (best, u), so_far = options[at], costs[at]
        members.append((best.candidate, u))
        here = here + best.read(u)
    return members


def one_se(bed: Bed, nominal: Compact, found: Sequence[Signature], rng: np.random.Generator) -> Members:
    """Return the smallest set of a forward path that is within one standard error of the best, by 4-fold errors.

    Source: Breiman et al. 1984.
    """
    parts = folds(bed.recs.tasks, rng)
    held, here = nominal.copy(), nominal
    losses, members = [bed.score.loss(nominal)], Members()
    for _ in range(LARGEST):
        rest_of = [s for s in found if s.candidate.label not in {c.label for c, _ in members}]
        options = [_held_out(bed, held, s, parts) for s in rest_of]
        at = int(np.argmin([bed.score.loss(z).mean() for z in options]))
        held, best = options[at], rest_of[at]
        u = best.fit(here, bed.score, np.arange(len(here)))
        here = here + best.read(u)
        members.append((best.candidate, u))
        losses.append(bed.score.loss(held))
    best_size = int(np.argmin([loss.mean() for loss in losses]))
    worse = [loss - losses[best_size] for loss in losses]
    error = [w.std(ddof=1) / np.sqrt(len(w)) for w in worse]
    return members[: next(k for k, (w, e) in enumerate(zip(worse, error, strict=True)) if w.mean() <= e)]


def _held_out(bed: Bed, held: Compact, s: Signature, parts: list[Index]) -> Compact:
    """Return the residuals `(E, K)` with one effect added, each fold fitted on the others."""
    out = held.copy()
    for f, test in enumerate(parts):
        out[test] += s.read(s.fit(held, bed.score, rest(parts, f)))[test]
    return out


SEARCHES: dict[str, Callable[[Bed, Compact, Sequence[Signature], np.random.Generator], Members]] = {
    "lowest_error": lowest_error,
    "bic": bic,
    "one_se": one_se,
}


def oracle(bed: Bed, label: Label) -> Members:
    """Return the true causes, their numbers fitted by robust Gauss-Newton on rollouts from the best probe of each."""
    members = [_best_probe(bed, candidate(e.name, bed.scene, e.element)) for e in label.effects]
    for _ in range(ROUNDS):
        members = _stepped(bed, members)
    return members


def _best_probe(bed: Bed, c: Candidate) -> tuple[Candidate, Array]:
    """Return a candidate at the probe with the smallest loss, the others absent."""
    points = probes(c, bed.scene)
    losses = [bed.score.loss(z).mean() for z in bed.residuals([(c.setting(u, bed.scene),) for u in points])]
    return c, points[int(np.argmin(losses))]


def _stepped(bed: Bed, members: Members) -> Members:
    """Return the members after one damped Gauss-Newton step over all numbers that are no choice."""
    places = [(m, i) for m, (c, _) in enumerate(members) if not c.choices for i in range(c.size)]
    if not places:
        return members
    spans = np.array([STEP * (members[m][0].high[i] - members[m][0].low[i]) for m, i in places])
    signs = np.array(
        [-1.0 if members[m][1][i] + s > members[m][0].high[i] else 1.0 for (m, i), s in zip(places, spans, strict=True)]
    )
    moved = [_shifted(members, places, step) for step in np.diag(spans * signs)]
    base, *zs = bed.residuals([_world(bed.scene, some) for some in (members, *moved)])
    slope = np.stack([(z - base) / np.float32(s) for z, s in zip(zs, spans * signs, strict=True)])
    step = least_squares(base, slope)
    trials = [members, *(_shifted(members, places, part * step) for part in (1.0, 0.5, 0.2))]
    losses = [bed.score.loss(z).mean() for z in bed.residuals([_world(bed.scene, some) for some in trials])]
    return trials[int(np.argmin(losses))]


def _shifted(members: Members, places: Sequence[tuple[int, int]], step: Array) -> Members:
    """Return the members with a step added to the numbers at `places`, within their bounds."""
    out = [(c, u.copy()) for c, u in members]
    for (m, i), s in zip(places, step.tolist(), strict=True):
        out[m][1][i] += s
    return [(c, np.clip(u, c.low, c.high)) for c, u in out]


def _world(scene: Scene, members: Iterable[tuple[Candidate, Array]]) -> EffectSet:
    """Return the effects of a set."""
    return tuple(c.setting(u, scene) for c, u in members)


def report_of(dataset: Dataset, bed: Bed, members: Members) -> Report:
    """Return a report that names a set, measured on the episodes of a bed; support is stated as sure."""
    world = _world(bed.scene, members)
    before, after, *without = bed.residuals([(), world, *(tuple(e for e in world if e is not left) for left in world)])
    sizes = [float(bed.score.size(z).mean()) for z in (before, after)]
    losses = [float(bed.score.loss(z).mean()) for z in (before, after, *without)]
    whole = losses[0] - losses[1]
    named = [
        NamedEffect(
            name=e.name,
            element=e.element,
            share=(loss - losses[1]) / whole if whole > 0 else 0.0,
            support=1.0,
            parameters={name: Estimate(value=value) for name, value in e.parameters.items()},
        )
        for e, loss in zip(world, losses[2:], strict=True)
    ]
    closed = (sizes[0] - sizes[1]) / max(sizes[0] - 1, 1e-9) if members else None
    return Report(
        verdict="explained" if named else "no_gap",
        effects=tuple(sorted(named, key=lambda e: -e.share)),
        gap=Gap(before=sizes[0], after=sizes[1], closed=closed),
        data=_data(dataset, len(bed.recs)),
    )


def _data(dataset: Dataset, episodes: int) -> DiagnosisData:
    """Return what a baseline looked at."""
    return DiagnosisData(dataset=dataset.name, episodes=EpisodeCount(total=len(dataset), folds=0, held_out=episodes))


def baseline_reports(
    dataset: Dataset, scene: Scene, label: Label, methods: Sequence[str], seed: int, common: str
) -> dict[str, tuple[Report, float]]:
    """Return the report of each baseline, and the CPU seconds it took.

    Parameters
    ----------
    dataset : Dataset
        A case's recordings.
    scene : Scene
        The nominal scene.
    label : Label
        The truth, which only the oracle reads.
    methods : sequence of str
        Of `BASELINES`.
    seed : int
        Seed of null replays and folds.
    common : str
        The effect that is hidden most often.
    """
    start = time.process_time()
    whole = make_bed(dataset, scene, np.random.default_rng(seed), EPISODES)
    fitted, measured = (whole.take(np.arange(first, len(whole.recs), 2)) for first in (0, 1))
    shared = time.process_time() - start
    out: dict[str, tuple[Report, float]] = {}
    nominal, found = signatures(fitted) if set(methods) & set(SEARCHES) else (None, [])
    searched = time.process_time() - start
    for method in methods:
        begun, before = time.process_time(), searched if method in SEARCHES else shared
        if method in SEARCHES and nominal is not None:
            members = SEARCHES[method](fitted, nominal, found, np.random.default_rng(seed))
        elif method == "commonest":
            members = [(c := candidate(common, scene), probes(c, scene)[0])]
        else:
            members = oracle(fitted, label)
        told = method == "oracle" and label.outside is not None
        report = _told(dataset, label) if told else report_of(dataset, measured, members)
        out[method] = report, before + time.process_time() - begun
    return out


def _told(dataset: Dataset, label: Label) -> Report:
    """Return the report of who was told that the cause is in no library, and where it acts."""
    place = label.outside.acts_on if label.outside else None
    return Report(
        verdict="unknown_effect",
        unknown=UnknownCause(acts_on=place, words="told so"),
        data=_data(dataset, len(dataset)),
    )


def baseline_case(
    folder: str, scene: NominalScene, sealed: str, label: str, methods: tuple[str, ...], seed: int, common: str
) -> CaseResults:
    """Return what each baseline says of a case in a folder; runs in any process."""
    path = Path(folder)
    found = baseline_reports(open_dataset(path), scene.load(), Label.model_validate_json(label), methods, seed, common)
    return CaseResults(
        sealed=sealed,
        results=tuple(
            CaseResult(case=path.name, sealed=sealed, method=method, cpu_s=cpu_s, cold=False, report=report)
            for method, (report, cpu_s) in found.items()
        ),
    )


def run_baselines(
    out: Path,
    cases: Sequence[Place],
    labels: dict[str, Label],
    methods: Sequence[str],
    *,
    crew: Crew = alone,
    seed: int = 0,
    told: Callable[[int], None] = lambda count: None,
) -> dict[str, list[CaseResult]]:
    """Return the results of each baseline on some cases; those that stand in `baselines.jsonl` are taken as they are.

    Parameters
    ----------
    out : Path
        Folder of the results.
    cases : sequence of Place
        The cases they are given.
    labels : dict of str to Label
        The truth of every case, opened.
    methods : sequence of str
        Of `BASELINES`.
    crew : Crew
        Who does the work.
    seed : int
        Seed of null replays and folds.
    told : callable
        Called with 1 for each case just done.
    """
    hidden = Counter(text_of(e.name, None) for one in labels.values() for e in one.effects)
    common = hidden.most_common(1)[0][0] if hidden else "object_mass"
    standing = {(one.sealed, r.method): r for one in finished(out / LOG, CaseResults) for r in one.results}
    tasks = []
    for p in cases:
        todo = tuple(m for m in methods if (p.sealed, m) not in standing)
        if todo:
            label = labels[p.folder.name].model_dump_json()
            tasks.append((*p.anywhere, label, todo, seed, common))
    for found in spread(out / LOG, baseline_case, tasks, crew):
        standing |= {(found.sealed, r.method): r for r in found.results}
        told(1)
    return {m: [standing[p.sealed, m] for p in cases] for m in methods}
