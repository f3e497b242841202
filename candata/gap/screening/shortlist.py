"""Shortlist: which candidates are worth their signatures on every episode, by a look at a few episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import Candidate
from candata.gap.fit.comparison import null_level
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.folds import cross_fit
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve, Plane
from candata.gap.measure.score import Compact
from candata.gap.screening.elements import promising
from candata.gap.screening.episodes import brief, first_look, taken, telling_half
from candata.gap.screening.refinement import PROMISE
from candata.gap.screening.signature_screen import respond

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Responses = list[tuple[Candidate, Curve | Plane]]
#: Share of the best gain on those from which a candidate is looked at in full, by signatures and where each is
#: simulated on the recording. Source: 50 of 52 drawn single causes gained 0.58 of the best at least, by signatures.
ALONE, PLAYED = 0.4, 0.2
#: Fewest and most such candidates, and the most where each is simulated on the recording.
LEAST, MOST, SIMULATED = 3, 8, 4
#: Share of what is left that a candidate, simulated on a few recorded episodes, must close there to be tried on all,
#: and from which a search of all is worth while, or a candidate on all episodes before the cause is called unknown.
#: Chosen: beside a delay of 120 ms that is off by 3 %, a dry friction that is worth all of it closed a tenth.
TRIED, WORTH = 0.05, 0.1
#: Share of what half of these episodes leave that a candidate must close there to be simulated on the others. Chosen:
#: half of `TRIED`. Record 43.
SILENT = 0.025
#: Share of the best gain on half of a few episodes below which a candidate is looked at no further. Chosen: a quarter
#: of `ALONE`.
NEAR_NOTHING = 0.1
#: How many of those that gain such a share where they are fitted come along.
FITTED = 3


@dataclass(frozen=True)
class Screened:
    """What a screen leaves.

    Attributes
    ----------
    responses : list of (Candidate, Curve or Plane)
        On every episode, of those that are worth it.
    dead : tuple of str
        Candidates that this data cannot show.
    faint : tuple of str
        Effects that gained too little on a few episodes to be looked at further.
    tried : int
        How many were looked at in all.
    rough : list of (Candidate, Curve or Plane)
        All of them on a few episodes; empty where none were looked at so.
    on_half_alone : tuple of Candidate
        Those that are missing there, as they gained too little on half of these episodes.
    """

    responses: Responses
    dead: tuple[str, ...]
    faint: tuple[str, ...]
    tried: int
    rough: Responses = field(default_factory=list)
    on_half_alone: tuple[Candidate, ...] = ()


def screened(problem: Problem, found: Sequence[Candidate], base: Array) -> Screened:
    """Return the responses of the candidates that are worth it alone.

    Looked at are the candidates found and promising variants of them on one element.

    Parameters
    ----------
    problem : Problem
    found : sequence of Candidate
    base : (E,) float64
        Typical loss without any, in floors.
    """
    part, index = brief(problem)
    on_half_alone: tuple[Candidate, ...] = ()
    if part is problem:
        responses, dead = _all(problem, found, base)
        return Screened(responses, dead, (), len(responses))
    if problem.simulated:
        going = _closing(part, part.nominal, found, ())
        rough, dead = _all(part, going, base[index])
        tried = len(rough) + len(found) - len(going)
    else:
        first, looked_at = first_look(problem)
        rough, dead = _all(first, found, base[looked_at])
        tried = len(rough)
        if first is not part:
            better = _better_half(first, rough, base[looked_at])
            on_half_alone = tuple(c for c, _ in rough if not any(c is other for other in better))
            rough, _ = respond(part, part.nominal, better)
    has_gap = bool(problem.score.loss(problem.nominal).mean() > null_level(problem.score))
    kept = _best(part, rough, base[index], PLAYED if problem.simulated else ALONE, has_gap)
    responses, _ = respond(problem, problem.nominal, kept)
    known = {*(c.label for c in kept), *dead}
    faint = tuple(c.label for c in found if c.element is None and c.label not in known)
    return Screened(responses, dead, faint, tried, rough, on_half_alone)


def on_all_few(problem: Problem, seen: Screened) -> Responses:
    """Return the responses of all candidates of a screen on the few episodes, also of those seen on half of them."""
    part, _ = brief(problem)
    return respond(part, part.nominal, [*(c for c, _ in seen.rough), *seen.on_half_alone])[0]


def reconsidered(problem: Problem, seen: Screened, base: Array) -> Screened:
    """Return a screen with more of its candidates on every episode: also those that close a share of the few.

    What closes next to nothing of the episodes that it is fitted to does not explain the others either.
    """
    part, index = brief(problem)
    least = WORTH * float((base[index] - 1).mean())
    left_out = {
        c.label
        for c, r in seen.rough
        if (c.element or c.label in seen.faint) and fitted(part, r, base[index])[0] <= least
    }
    kept = [c for c, _ in seen.rough if c.label not in left_out]
    responses, _ = respond(problem, problem.nominal, kept)
    known = {c.label for c in kept}
    return replace(seen, responses=responses, faint=tuple(name for name in seen.faint if name not in known))


def _all(problem: Problem, found: Sequence[Candidate], base: Array) -> tuple[Responses, tuple[str, ...]]:
    """Return the responses of all candidates and of promising variants of them, and the labels of dead ones.

    Where each is simulated on the recording, variants would cost too much: the search by signatures has tried them.
    """
    here = problem.nominal
    responses, dead = respond(problem, here, found)
    if problem.simulated:
        return responses, tuple(dead)
    responses += respond(problem, here, promising(problem, here, responses, base))[0]
    return responses, tuple(dead)


def _closing(problem: Problem, here: Compact, found: Sequence[Candidate], held: Members) -> list[Candidate]:
    """Return the candidates that, simulated on the more telling half of a few episodes, close a share of these.

    Fitted to what they are judged by, as none is held out: what closes next to nothing even so need not be simulated on
    the other half. Choices are all simulated there, as what is held may have to move before they show. Where candidates
    are not simulated, all of them.
    """
    if not problem.simulated:
        return list(found)
    half = telling_half(problem, here)
    part, base = taken(problem, half), problem.score.loss(here)[half]
    responses, _ = respond(part, here[half], [c for c in found if not c.choices], held)
    least = SILENT * float((base - 1).mean())
    closing = {c.label for c, response in responses if fitted(part, response, base)[0] > least}
    return [c for c in found if c.choices or c.label in closing]


def _better_half(problem: Problem, responses: Responses, base: Array) -> list[Candidate]:
    """Return the half of the candidates that gain most on the episodes that they are fitted to, none near nothing."""
    gains = sorted(((fitted(problem, r, base)[0], c) for c, r in responses), key=lambda pair: -pair[0])
    least = NEAR_NOTHING * gains[0][0] if gains else 0.0
    return [c for gain, c in gains[: (len(gains) + 1) // 2] if gain >= least]


def _best(problem: Problem, responses: Responses, base: Array, share: float, has_gap: bool) -> list[Candidate]:
    """Return the candidates that gain a share of the most on a few episodes, held out, or where all are fitted.

    A few episodes hardly fit the numbers of a vector without one of them; without a gap there is nothing that they
    would have to explain. Where each is simulated on the recording, few, and none that closes next to nothing.
    """
    gains = _gains(problem, responses, base)
    if problem.simulated:
        least = max(share * gains[0][0], TRIED * float((base - 1).mean())) if gains else 0.0
        return [c for gain, c in gains[:SIMULATED] if gain > least]
    wanted = sum(gain > share * gains[0][0] for gain, _ in gains)
    found = [c for _, c in gains[: int(np.clip(wanted, LEAST, MOST))]]
    if not has_gap:
        return found
    closing = sorted(((fitted(problem, r, base)[0], c) for c, r in responses), key=lambda pair: -pair[0])[:FITTED]
    return found + [c for gain, c in closing if c not in found and gain > share * closing[0][0]]


def fitted(problem: Problem, response: Curve | Plane, base: Array) -> tuple[float, Array]:
    """Return what a candidate gains on the episodes that it is fitted to, and its coordinates `(d,)` there."""
    at = response.fitter(problem.score)(np.arange(len(base)))
    return float((base - problem.score.loss(response.read(at))).mean()), at


def _gains(problem: Problem, responses: Responses, base: Array) -> list[tuple[float, Candidate]]:
    """Return what each candidate gains on a few episodes, each held out once, the largest first.

    Fitted to the episodes that it is judged by, a candidate of many numbers would gain by their number. Where it was
    simulated, it gains what it does there at least: without one of six episodes slopes may lead anywhere.
    """
    found = [(float(cross_fit(r, problem.score, problem.parts, base).gain.mean()), c) for c, r in responses]
    if problem.simulated:
        here = [float((base - problem.score.loss(r.z)).mean()) if isinstance(r, Plane) else 0.0 for _, r in responses]
        found = [(max(gain, there), c) for (gain, c), there in zip(found, here, strict=True)]
    return sorted(found, key=lambda pair: -pair[0])


def rivals(problem: Problem, here: Compact, found: Sequence[Candidate], base: Array, best: Fit) -> list[Candidate]:
    """Return the candidates that come near the best fit so far, on a few episodes.

    Like is compared with like: of the best too counts what its signatures promise, where that is less than it gains.
    """
    part, index = brief(problem)
    label, own = best.labels[0], best.members[0][0]
    responses, _ = respond(part, here[index], [own, *found])
    gains = _gains(part, responses, base[index])
    promised = [float(best.evidence.gain[index].mean()), *(gain for gain, c in gains if c.label == label)]
    return [c for gain, c in gains if c.label != label and gain > PROMISE * max(min(promised), 0.0)]


def gains_share(
    problem: Problem, here: Compact, found: Sequence[Candidate], held: Members, now: Compact | None = None
) -> bool:
    """Tell whether a candidate closes a share of what the effects held leave, `here (E, K)`, on a few episodes.

    Where `now (E, K)` is given, a share of that.
    """
    part, index = brief(problem)
    base = part.score.loss((here if now is None else now)[index])
    responses, _ = respond(part, here[index], _closing(part, here[index], found, held), held)
    return bool(responses) and _gains(part, responses, base)[0][0] > WORTH * float((base - 1).mean())
