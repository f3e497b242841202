"""Which: screen candidates by responses, refine the best by rollouts, choose on held-out episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.candidates import Candidate, candidates, local_candidates
from candata.gap.floor import floor, perturbed
from candata.gap.folds import cross_fit, null_threshold
from candata.gap.local import LOCAL, promises
from candata.gap.refine import joint, polished, refined
from candata.gap.response import Curve, Plane
from candata.gap.score import Compact, Score, score
from candata.gap.screen import respond
from candata.gap.search import Fit, Members, Problem, fit_one
from candata.gap.shortlist import rivals, screened
from candata.gap.sparse import sparse

Array = NDArray[np.float64]
#: Largest number of effects in a set, beside those that were measured without a fit.
LARGEST_SET = 3
#: How many times its threshold and standard error a gain must be where the loss lies within the nulls' range.
PLAIN = 3.0
#: Held-out gain [floors] below which an effect is not worth a name, significant or not.
MATTERS = 0.02
#: Share of the gain so far below which another effect is not worth naming, significant or not.
EXTRA = 0.05
#: Share of the best gain above which another effect's fit is sharpened too before the two are compared, and how many.
NEAR, RIVALS = 0.85, 2
#: Null replays of each episode around an accepted set.
NULLS_AGAIN = 4
#: Nominal replays from other starts, which show how much of a loss is luck.
STARTS = 3


@dataclass(frozen=True)
class Stage:
    """One round of the search: every candidate on top of what is held.

    Attributes
    ----------
    base : (E,) float64
        Typical loss without another effect, in floors.
    fits : tuple of Fit
        Every lively candidate, best held-out gain first.
    threshold : float
        Held-out gain that null sets reach one time in a hundred.
    dead : tuple of str
        Candidates that this data cannot show.
    idle : tuple of str
        Candidates whose best value is their absence.
    faint : tuple of str
        Candidates that gained too little on a few episodes to be looked at further.
    reachable : float
        Mean loss that one true world in ten stays below, in floors; 0 where the floor is assumed and may be high.
    """

    base: Array
    fits: tuple[Fit, ...]
    threshold: float
    dead: tuple[str, ...]
    idle: tuple[str, ...]
    faint: tuple[str, ...]
    reachable: float

    def passing(self) -> Fit | None:
        """Return the best fit if it beats the nulls, one standard error of its own gain, and what matters at all.

        A loss below what a true world reaches is luck, and counts for nothing; so does the gain of one episode alone.
        """
        if not self.fits:
            return None
        best = self.fits[0]
        each = best.evidence.gain
        gain = min(best.gain, float(self.base.mean()) - self.reachable)
        others = float(np.delete(each, np.argmax(each)).mean())
        sure = gain > max(self.threshold, standard_error(each), MATTERS) and others > self.threshold / 2
        return best if sure else None

    def is_plain(self, best: Fit) -> bool:
        """Tell whether a gain is large enough to count although the loss itself lies within the nulls' range.

        Either it is sure, or it removes most of the loss, which no floor of the right height allows.
        """
        sure = best.gain > PLAIN * standard_error(best.evidence.gain)
        return best.gain > PLAIN * self.threshold and (sure or best.gain > float(self.base.mean()) / 2)


@dataclass(frozen=True)
class Attribution:
    """What the search found.

    Attributes
    ----------
    first : Stage
        Every candidate alone.
    chosen : Fit or None
        The set that passes, or None.
    tied : tuple of Fit
        Single fits that the held-out episodes cannot tell from the best; the best first.
    score : Score
        In units of the floor of the chosen world.
    remains : bool
        Whether the held-out loss of the chosen set (or of the nominal scene) lies above the nulls.
    """

    first: Stage
    chosen: Fit | None
    tied: tuple[Fit, ...]
    score: Score
    remains: bool


def attribute(problem: Problem) -> Attribution:
    """Return the effects that explain the gap, by forward selection on held-out episodes.

    What is left after it is tried by a joint sparse fit: a rig may be a little wrong everywhere.
    """
    nominal = problem.nominal
    first = _stage(problem, nominal, ())
    remains = bool(problem.score.loss(nominal).mean() > null_level(problem.score, problem.rng))
    if remains and first.faint and first.passing() is None:
        # Before the cause is called unknown, everything is looked at on every episode.
        first = _stage(problem, nominal, (), full=True)
    best = first.passing()
    if best is None or not (remains or first.is_plain(best)):
        return Attribution(first, None, (), problem.score, remains)
    first = _narrowed(problem, nominal, first)
    first = _sharpened(problem, first)
    best = first.fits[0]
    tied = tied_with(best, first.fits)
    chosen, world, remains = _forward(problem, best, grow=len(tied) == 1)
    chosen, world, remains = _with_measured(world, chosen, remains)
    if remains and len(tied) == 1:
        chosen, world, remains = _jointly(world, chosen)
    return Attribution(first, chosen, tuple(tied), world.score, remains)


def _stage(problem: Problem, here: Compact, held: Members, full: bool = False) -> Stage:
    """Return every candidate's held-out evidence on top of the effects held, `full`: with no shortlist of them."""
    channels = list(problem.recs.readings)
    taken = {c.name for c, _ in held}
    found = [c for c in candidates(problem.replayer.scene, channels) if c.name not in taken | problem.ruled_out]
    base, luck = _base(problem, here, held)
    seen = screened(problem, here, found, held, base, full)
    responses = [r for _, r in seen.responses]
    threshold = null_threshold(responses, problem.score, problem.parts, luck, problem.rng, seen.tried)
    found_fits = refined(problem, _fits(problem, seen.responses, base), base, held)
    fits = [f for f in found_fits if not f.members[0][0].is_neutral(f.members[0][1])]
    absent = [f.members[0][0] for f in found_fits if f.members[0][0].is_neutral(f.members[0][1])]
    idle = tuple(c.label for c in absent if c.element is None)
    declared = problem.floor_kind != "assumed"
    reachable = null_level(problem.score, problem.rng, 0.1) if declared else 0.0
    return Stage(base, tuple(fits), threshold, seen.dead, idle, seen.faint, reachable)


def _narrowed(problem: Problem, here: Compact, stage: Stage) -> Stage:
    """Return the stage with the best fit's effect tried on each of its elements alone: the fault may be one joint's."""
    known = {f.labels[0] for f in stage.fits}
    best, c = stage.fits[0], stage.fits[0].members[0][0]
    variants = local_candidates(c, problem.replayer.scene)
    promised = promises(problem, c, variants, best.response, stage.base)[:LOCAL] if variants else []
    unknown = [v for _, v in promised if v.label not in known]
    near = rivals(problem, here, unknown, stage.base, best.evidence.gain) if unknown else []
    responses = respond(problem, here, near)[0] if near else []
    found = refined(problem, _fits(problem, responses, stage.base), stage.base, ()) if responses else []
    fits = [f for f in found if not f.members[0][0].is_neutral(f.members[0][1])]
    return replace(stage, fits=tuple(sorted((*stage.fits, *fits), key=lambda f: -f.gain)))


def _sharpened(problem: Problem, stage: Stage) -> Stage:
    """Return the stage with the best fit and its nearest rivals at their sharpest: only then are they compared."""
    best = _simplest(stage.fits[0], stage.fits)
    name = best.members[0][0].name
    others = [f for f in stage.fits if f.members[0][0].name != name and f.gain > NEAR * best.gain]
    front = [polished(problem, f, stage.base) for f in (best, *others[:RIVALS])]
    labels = {f.labels[0] for f in front}
    front.sort(key=lambda f: -f.gain)
    return replace(stage, fits=(*front, *(f for f in stage.fits if f.labels[0] not in labels)))


def _base(problem: Problem, here: Compact, held: Members) -> tuple[Array, Array]:
    """Return the typical loss `(E,)` over starts that are equally possible, and the luck `(J, E)` of each."""
    others = [perturbed(problem.replayer, problem.begin, problem.noise, problem.rng) for _ in range(STARTS)]
    world = problem.setting(held)
    losses = [problem.score.loss(here)]
    losses += [problem.score.loss(problem.residuals([world], begin)[0]) for begin in others]
    base = np.median(losses, axis=0)
    return base, base - np.stack(losses)


def _fits(problem: Problem, responses: Sequence[tuple[Candidate, Curve | Plane]], base: Array) -> list[Fit]:
    """Return single-candidate fits by interpolated responses, best held-out gain first."""
    return sorted((fit_one(problem, c, r, base) for c, r in responses), key=lambda f: -f.gain)


def tied_with(best: Fit, fits: Sequence[Fit]) -> list[Fit]:
    """Return the fits whose held-out loss is within one standard error of the best one's (Breiman et al. 1984).

    The error is that of the paired difference over episodes. The same effect on fewer or more elements is no rival.
    """
    rivals = [f for f in fits if f.members[0][0].name != best.members[0][0].name]
    return [best, *(f for f in rivals if _is_tied(f, best))]


def _is_tied(fit: Fit, best: Fit) -> bool:
    """Tell whether a fit is no worse than the best by more than one standard error."""
    worse = fit.evidence.loss - best.evidence.loss
    return bool(worse.mean() <= standard_error(worse))


def _simplest(best: Fit, fits: Sequence[Fit]) -> Fit:
    """Return the fit of the same effect that says least among those tied with the best: fewest numbers, one element."""
    same = [f for f in fits if f.members[0][0].name == best.members[0][0].name and _is_tied(f, best)]
    return min([best, *same], key=lambda f: (f.members[0][0].size, f.members[0][0].element is None))


def _forward(problem: Problem, best: Fit, grow: bool) -> tuple[Fit, Problem, bool]:
    """Return the best set that contains `best`, the problem in units of its floor, and whether a gap remains.

    Grows while the held-out loss lies above the nulls of the world found so far and another effect passes.
    """
    while True:
        world, best = _rescored(problem, best)
        remains = bool(best.evidence.loss.mean() > null_level(world.score, world.rng))
        if not remains or not grow or is_full(best.members, problem.measured):
            return best, world, remains
        here = world.residuals([world.setting(best.members)])[0]
        added = _stage(world, here, best.members).passing()
        if added is None:
            return best, world, remains
        grown = joint(world, (*best.members, added.members[0]), world.score.loss(world.nominal))
        if not _worth_adding(best.evidence.loss - grown.evidence.loss, best.gain):
            return best, world, remains
        problem, best = world, grown


def is_full(members: Members, measured: Members) -> bool:
    """Tell whether a set holds as many effects as are searched for; one that was measured directly takes no place."""
    known = {c.name for c, _ in measured}
    return sum(c.name not in known for c, _ in members) >= LARGEST_SET


def _with_measured(problem: Problem, best: Fit, remains: bool) -> tuple[Fit, Problem, bool]:
    """Return the set joined by what was measured directly: it needs no gain to be believed."""
    new = tuple((c, u) for c, u in problem.measured if c.name not in {m.name for m, _ in best.members})
    if not new:
        return best, problem, remains
    world, found = _rescored(problem, joint(problem, (*best.members, *new), problem.score.loss(problem.nominal)))
    return found, world, bool(found.evidence.loss.mean() > null_level(world.score, world.rng))


def _jointly(problem: Problem, best: Fit) -> tuple[Fit, Problem, bool]:
    """Return the joint fit over all effects where it closes clearly more than `best`, which is returned otherwise."""
    base = problem.score.loss(problem.nominal)
    found = sparse(problem, best, base)
    if found is None or not _worth_adding(best.evidence.loss - found.evidence.loss, best.gain):
        return best, problem, True
    world, found = _rescored(problem, found)
    return found, world, bool(found.evidence.loss.mean() > null_level(world.score, world.rng))


def _worth_adding(extra: Array, so_far: float) -> bool:
    """Tell whether the gain `extra (E,)` of one more effect is sure, worth a name, and not one episode's doing."""
    least = max(standard_error(extra), EXTRA * so_far)
    return bool(extra.mean() > least and np.delete(extra, np.argmax(extra)).mean() > EXTRA * so_far / 2)


def _rescored(problem: Problem, best: Fit) -> tuple[Problem, Fit]:
    """Return problem and fit in units of the floor of the fitted world."""
    world = problem.setting(best.members)
    spread = floor(problem.replayer, problem.recs, problem.begin, problem.plan, problem.rng, NULLS_AGAIN, world)
    new = replace(problem, score=score(problem.raw, spread, problem.plan))
    factor = np.where(new.score.mask, problem.score.sigma / new.score.sigma, 0).astype(np.float32)
    response = best.response.rescaled(factor)
    evidence = cross_fit(response, new.score, new.parts, new.score.loss(new.nominal))
    return new, replace(best, response=response, evidence=evidence)


def standard_error(values: Array) -> float:
    """Return the standard error of the mean of independent episodes."""
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def null_level(score: Score, rng: np.random.Generator, quantile: float = 0.99, sets: int = 1000) -> float:
    """Return the quantile of the mean loss of null sets, in floors."""
    count = score.null_loss.shape[1]
    chosen = rng.integers(len(score.null_loss), size=(sets, count))
    return float(np.quantile(score.null_loss[chosen, np.arange(count)].mean(1), quantile))
