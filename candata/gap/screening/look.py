"""One round of a search: every candidate beside what is held, the nearest ones compared at their sharpest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import inf

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import Candidate, candidate, candidates, elements_of, local_candidates, on_slides
from candata.gap.fit.comparison import (
    BLUNT,
    NEAR,
    RIVALS,
    UNSURE,
    is_elsewhere,
    is_near,
    is_tied,
    null_level,
)
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.folds import null_threshold
from candata.gap.fit.problem import Problem, fit_one
from candata.gap.fit.response import Curve, Plane
from candata.gap.fit.stage import MATTERS, Stage
from candata.gap.measure.floor import perturbed
from candata.gap.measure.score import Compact
from candata.gap.replay.replayer import EffectSet
from candata.gap.replay.starts import Starts
from candata.gap.screening.elements import LOCAL, promises
from candata.gap.screening.episodes import brief
from candata.gap.screening.refinement import PROMISE, joint, polished, refined
from candata.gap.screening.shortlist import Screened, on_all_few, reconsidered, rivals, screened
from candata.gap.screening.signature_screen import respond
from candata.scenes import Scene

Array = NDArray[np.float64]
#: Times what nulls gain within which it is sharpened too: of a faint effect, a fit gains as much by being sharp.
#: Record 43.
LUCKY = 2.0
#: Nominal replays from other starts, which show how much of a loss is luck.
STARTS = 3


def look(problem: Problem, before: Stage | None = None) -> Stage:
    """Return every candidate's held-out evidence alone.

    `before` is an earlier look, whose typical loss holds still.
    """
    base, luck = (before.base, before.luck) if before else typical(problem)
    seen = screened(problem, unheld(problem, ()), base)
    stage = _judged(problem, seen, base, luck)
    left = stage.fits[0].evidence.loss if stage.fits else base
    # Beside another effect one may show that gains nothing alone.
    if seen.on_half_alone and left.mean() > null_level(problem.score):
        stage = replace(stage, rough=on_all_few(problem, seen))
    return stage


def as_simulated(problem: Problem, stage: Stage) -> Sequence[tuple[Candidate, Curve | Plane]]:
    """Return every lively candidate on a few episodes, scalars as far as they were simulated on the recording.

    Between two probes of a signature a curve is a chord, and its error adds up.
    """
    _, index = brief(problem)
    curves = {f.labels[0]: f.response for f in stage.fits if isinstance(f.response, Curve)}
    return [
        (c, replace(curves[c.label], z=curves[c.label].z[:, index]) if c.label in curves else response)
        for c, response in stage.rough
    ]


def look_again(problem: Problem, before: Stage) -> Stage:
    """Return the evidence of a first look with more candidates on every episode: all that could explain much."""
    seen = Screened([], before.dead, before.faint, len(before.rough), list(before.rough))
    return _judged(problem, reconsidered(problem, seen, before.base), before.base, before.luck)


def _judged(problem: Problem, seen: Screened, base: Array, luck: Array) -> Stage:
    """Return the evidence of what a screen leaves, refined."""
    responses = [r for _, r in seen.responses]
    rng = problem.stream("null threshold", (), [c.label for c, _ in seen.responses])
    threshold = null_threshold(responses, problem.score, problem.parts, luck, rng, seen.tried)
    found_fits = refined(problem, _fits(problem, seen.responses, base), base)
    fits = [f for f in found_fits if not f.members[0][0].is_neutral(f.members[0][1])]
    absent = [f.members[0][0] for f in found_fits if f.members[0][0].is_neutral(f.members[0][1])]
    idle = tuple(c.label for c in absent if c.element is None)
    declared = problem.floor_kind != "assumed"
    reachable = null_level(problem.score, 0.1) if declared else 0.0
    return Stage(base, luck, tuple(fits), threshold, seen.dead, idle, seen.faint, reachable, seen.rough)


def unheld(problem: Problem, held: Members) -> list[Candidate]:
    """Return the candidates that may be tried beside the effects held: the same one only on slides, or beside those."""
    scene, known = problem.replayer.scene, {c.label for c, _ in held}
    rails = {c.label for c, _ in held if c.label in {v.label for v in on_slides(candidate(c.name, scene), scene)}}
    taken = {c.name for c, _ in held if c.label not in rails} | problem.ruled_out
    again = [v for c, _ in held for v in on_slides(c, scene) if v.label not in known]
    return [*(c for c in candidates(scene, problem.recs.channels) if c.name not in taken), *again]


def narrowed(problem: Problem, here: Compact, stage: Stage) -> Stage:
    """Return the stage with more variants on one element: the fault may be one joint's, or the next one's.

    Tried are the best fit's effect on each of its elements alone; where it is a fault of one element already, also all
    other effects on that element.
    """
    best = stage.fits[0]
    found = _parts(problem, best, stage)
    known = {f.labels[0] for f in (*stage.fits, *found)}
    unknown = [v for v in _kin(problem, best, stage) if v.label not in known]
    near = rivals(problem, here, unknown, stage.base, best) if unknown else []
    responses = respond(problem, here, near)[0] if near else []
    found += refined(problem, _fits(problem, responses, stage.base), stage.base) if responses else []
    new = {f.labels[0]: f for f in found if not f.members[0][0].is_neutral(f.members[0][1])}
    fits = [*new.values(), *(f for f in stage.fits if f.labels[0] not in new)]
    return replace(stage, fits=tuple(sorted(fits, key=lambda f: -f.gain)))


def _parts(problem: Problem, best: Fit, stage: Stage) -> list[Fit]:
    """Return the fits of one element's numbers of a vector, where these alone keep most of what it gains.

    They begin where the whole vector's fit has them: signatures of that element say less of a place so far out.
    """
    (c, u) = best.members[0]
    variants = local_candidates(c, problem.replayer.scene) if c.size > 1 else []
    points = [(v, u[v.own[c.own]]) for v in variants if v.size < c.size and c.own[v.own].all()]
    if not points:
        return []
    part, index = brief(problem)
    whole, *others = part.residuals([part.setting([m]) for m in (best.members[0], *points)])
    most, *gains = (float((stage.base[index] - part.score.loss(z)).mean()) for z in (whole, *others))
    order = [i for i in np.argsort(gains)[::-1] if gains[i] > PROMISE * most][:RIVALS]
    zs = problem.residuals([problem.setting([points[i]]) for i in order]) if order else []
    planes = [
        (v, Plane(v.low, v.high, at, z, best.plane.slope[v.own[c.own]]))
        for (v, at), z in zip((points[i] for i in order), zs, strict=True)
    ]
    return _fits(problem, planes, stage.base)


def _kin(problem: Problem, best: Fit, stage: Stage) -> list[Candidate]:
    """Return the variants on one element that a best fit makes worth a look."""
    scene, c = problem.replayer.scene, best.members[0][0]
    if c.element is None:
        variants = local_candidates(c, scene)
        promised = promises(problem, c, variants, best.response, stage.base) if variants else []
        return [v for _, v in promised[:LOCAL]]
    variants = [v for w in unheld(problem, ()) if w.label not in stage.dead for v in local_candidates(w, scene)]
    return [v for v in variants if v.name == c.name or v.element == c.element]


def sharpened(problem: Problem, stage: Stage) -> Stage:
    """Return the stage with the best fit and its nearest rivals at their sharpest: only then are they compared."""
    scene = problem.replayer.scene
    best = _simplest(stage.fits[0], stage.fits, scene)
    near = [
        f
        for f in stage.fits
        if is_near(f, best) or best.gain - f.gain < LUCKY * stage.threshold or _may_come_near(problem, stage, f, best)
    ]
    others = [f for f in near if is_elsewhere(f.members[0][0], best.members[0][0], scene)]
    front = [polished(problem, f, stage.base) for f in (best, *others[:RIVALS])]
    front += _wider(problem, stage, front[0])
    if len({f.members[0][0].size > 1 for f in front}) > 1:
        front = [_as_vectors_are(problem, f, stage.base) for f in front]
    labels = {f.labels[0] for f in front}
    front = _settled(problem, sorted(front, key=lambda f: -f.gain))
    return replace(stage, fits=(*front, *(f for f in stage.fits if f.labels[0] not in labels)))


def _wider(problem: Problem, stage: Stage, best: Fit) -> list[Fit]:
    """Return the same effect with more numbers, on elements among them the best's, if sharp it surely explains more.

    Tried where the best leaves what matters, and of the fewest numbers.
    """
    (c, _), scene = best.members[0], problem.replayer.scene
    own, near = set(elements_of(c, scene)), [f for f in stage.fits if is_near(f, best)]
    more = [f for f in near if f.members[0][0].name == c.name and f.members[0][0].size > c.size]
    wider = [f for f in more if own <= set(elements_of(f.members[0][0], scene))]
    if not wider or best.evidence.loss.mean() <= 1 + MATTERS:
        return []
    sharp = polished(problem, min(wider, key=lambda f: f.members[0][0].size), stage.base)
    return [] if is_tied(best, sharp) else [sharp]


def _may_come_near(problem: Problem, stage: Stage, fit: Fit, best: Fit) -> bool:
    """Tell whether a scalar that gains `PROMISE` of the most may come near where nothing was simulated yet.

    Only where the best leaves a gap.
    """
    if not isinstance(fit.response, Curve) or fit.members[0][0].choices or fit.gain < PROMISE * best.gain:
        return False
    if best.evidence.loss.mean() <= null_level(problem.score):
        return False
    least = max(fit.response.least_around(fit.members[0][1], problem.score), 1.0)
    return bool(stage.base.mean() - least > NEAR * best.gain)


def _as_vectors_are(problem: Problem, fit: Fit, base: Array) -> Fit:
    """Return a scalar fitted as vectors are, by slopes, where that gains more: only alike do rivals compare."""
    c = fit.members[0][0]
    found = fit if c.size > 1 or c.choices else joint(problem, fit.members, base)
    return found if found.gain > fit.gain else fit


def _settled(problem: Problem, front: list[Fit]) -> list[Fit]:
    """Return near rivals by their typical losses over starts that are equally possible, the best first.

    One replay of each deals every rival its own luck, and the best of several is the luckiest.
    """
    near = [f for f in front if is_near(f, front[0])]
    if len(near) < 2:
        return front
    worlds = [problem.setting(f.members) for f in near]
    losses = problem.losses_from([problem.begin, *_starts(problem, "starts of rivals", *worlds)], worlds)
    shift = np.median(losses, axis=0) - losses[0]
    pairs = [(f, f.evidence, more) for f, more in zip(near, shift, strict=True)]
    settled = [replace(f, evidence=replace(e, loss=e.loss + more, gain=e.gain - more)) for f, e, more in pairs]
    return sorted((*settled, *(f for f in front if not is_near(f, front[0]))), key=lambda f: -f.gain)


def _starts(problem: Problem, name: str, *worlds: EffectSet) -> list[Starts]:
    """Return other starts that are as possible as the problem's own, of the stream of a name and some worlds."""
    rng = problem.stream(name, *worlds)
    return [perturbed(problem.replayer, problem.begin, problem.noise, rng) for _ in range(STARTS)]


def typical(problem: Problem) -> tuple[Array, Array]:
    """Return the typical loss `(E,)` over starts that are equally possible, and the luck `(J, E)` of each."""
    others = problem.losses_from(_starts(problem, "starts of a look", ()), [()])[:, 0]
    losses = np.concatenate([problem.score.loss(problem.nominal)[None], others])
    base = np.median(losses, axis=0)
    return base, base - losses


def _fits(problem: Problem, responses: Sequence[tuple[Candidate, Curve | Plane]], base: Array) -> list[Fit]:
    """Return single-candidate fits by interpolated responses, best held-out gain first."""
    return sorted((fit_one(problem, c, r, base) for c, r in responses), key=lambda f: -f.gain)


def _simplest(best: Fit, fits: Sequence[Fit], scene: Scene) -> Fit:
    """Return the fit of the same effect that says least: of those tied with the best, one of the fewest numbers.

    Of these it is the one on all elements, where that on one can hardly be told from that on another, or leaves more
    than fits are sharp: which one it is is not known. Else it is the one that acts on the fewest elements where gains
    are the same as far as fits are sharp: the others do nothing here.
    """
    alike = [f for f in fits if f.members[0][0].name == best.members[0][0].name and is_tied(f, best, UNSURE)]
    same = [best, *(f for f in alike if is_tied(f, best))]
    fewest = min(f.members[0][0].size for f in same)
    plain = [f for f in same if f.members[0][0].size == fewest]
    whole = [f for f in plain if f.members[0][0].element is None]
    if whole and any(is_elsewhere(f.members[0][0], g.members[0][0], scene) for f, g in combinations(alike, 2)):
        return whole[0]
    most = max(f.gain for f in plain)
    sharp = [f for f in plain if most - f.gain <= BLUNT * most]
    if whole and whole[0] not in sharp:
        return whole[0]
    return min(sharp, key=lambda f: _breadth(f.members[0][0], scene))


def _breadth(c: Candidate, scene: Scene) -> tuple[float, bool]:
    """Return on how many elements a candidate acts; infinite for all, and for all fingertips, which come after all."""
    some = elements_of(c, scene)
    together = len(some) > 1 and some == scene.file.fingertips
    return inf if c.element is None or together else len(some), c.element is not None
