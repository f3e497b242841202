"""The joint fit: every quantity that the recordings move, fitted at once, whatever a name of its own would be worth.

A datasheet is wrong in many quantities at once, and a search that adds one effect after another stops where no single
one helps. Nonlinear least squares within bounds (Gauss-Newton) begins at several places instead. A replay forgets its
errors within 1 / (gain x rate), half a second at 100 Hz, as the observer pulls it to its recording: like the restarts
of multiple shooting (Bock & Plitt 1984), this keeps an error of phase from locking the fit. Held-out episodes decide
which quantities stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from candata.gap.data.robust_loss import weights
from candata.gap.fit.candidates import Candidate
from candata.gap.fit.comparison import standard_error
from candata.gap.fit.fits import Fit, Members, acting_members
from candata.gap.fit.folds import CrossFit, rest
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Plane
from candata.gap.measure.score import Compact
from candata.gap.screening.episodes import few, taken
from candata.gap.search.quantities import (
    SHARES,
    STEPS,
    Allowance,
    AllowanceSpent,
    Place,
    Quantities,
    descended,
    mean_size,
    refitted,
    robust_spread,
    settled,
)

Array = NDArray[np.float64]
#: Most numbers that are fitted at once, and replays that each needs: one for every slope, in some ten steps. Chosen.
MOST_NUMBERS, REPLAYS_EACH = 16, 12.0
#: Shares of the allowed replays that may be spent on where to begin, and on the fits from there, and that are left for
#: the quantities that stay. Chosen.
BEGINNING, FIRST_FITS, LAST = 0.1, 0.4, 0.35
#: Most places at which the fit may begin beside what was named, how far they lie from the neutral values in plausible
#: sizes, and from how many of them it begins. Chosen.
PLACES, REACH, BEGUN = 48, 1.5, 3
#: Shares of a plausible size over which slopes are differenced, rough and sharp. Chosen: the wider, the less is seen of
#: single contacts and of friction that holds or lets go.
ROUGH, SHARP = 0.1, 0.01
#: Standard errors over held-out episodes by which a quantity must gain to stay. Source: the one-standard-error rule of
#: Breiman, Friedman, Olshen & Stone, "Classification and Regression Trees" (1984), section 3.4.3.
SURE = 1.0
#: Plausible sizes off its neutral value below which a quantity is no repair. Chosen.
NEGLIGIBLE = 0.01
#: Share of the whole gain that a quantity must be worth to stay. Chosen: a thousandth is no repair.
WORTH = 0.001


@dataclass(frozen=True)
class JointFit:
    """A joint fit.

    Attributes
    ----------
    fit : Fit
        Members, the plane around them, and losses of held-out episodes.
    combinations : int
        How many combinations of the numbers are known to less than a plausible size: singular values of the slopes, in
        units of noise and of plausible sizes, above one.
    """

    fit: Fit
    combinations: int


@dataclass(frozen=True)
class _Fold:
    """Episodes that are held out, the others, and the place that these are fitted best."""

    test: NDArray[np.int64]
    train: NDArray[np.int64]
    place: Place


def joint_fit(problem: Problem, kinds: Sequence[Candidate], named: Members, replays: float) -> JointFit | None:
    """Return the joint fit of all quantities that gain on held-out episodes; None where none does.

    Parameters
    ----------
    problem : Problem
    kinds : sequence of Candidate
        Quantities that may be wrong, the likeliest first; choices do not count.
    named : Members
        What a search found: one of the places at which the fit begins.
    replays : float
        Replays of all episodes to spend at most; None is returned where they end before a fit was judged.
    """
    chosen = tuple(c for c, _ in named if not c.choices)
    others = (c for c in kinds if c.label not in {n.label for n in chosen})
    kinds = _first_numbers((*chosen, *others), min(MOST_NUMBERS, int(replays / REPLAYS_EACH)))
    if not kinds:
        return None
    allowance = Allowance(replays, (1 - FIRST_FITS) * replays)
    everything = Quantities(problem, kinds, allowance, len(problem.recs))
    telling = few(problem.recs.tasks, problem.score.loss(problem.nominal))
    brief = replace(everything, problem=taken(problem, telling))
    try:
        at, z = min(_first_fits(brief, named), key=lambda pair: mean_size(pair[1]))
        allowance.reserved = LAST * replays
        at, _ = descended(brief, at, z, SHARP, STEPS)
        allowance.reserved = 0.0
        return _thinned(everything, at, everything.residuals([at])[0])
    except AllowanceSpent:
        return None


def _first_numbers(kinds: Sequence[Candidate], most: int) -> tuple[Candidate, ...]:
    """Return the first quantities, of at most so many numbers together."""
    kept: list[Candidate] = []
    for c in kinds:
        if not c.choices and sum(k.size for k in kept) + c.size <= most:
            kept.append(c)
    return tuple(kept)


def _first_fits(brief: Quantities, named: Members) -> list[tuple[Array, Compact]]:
    """Return where fits from several places end, each with an equal share of the replays that are not reserved."""
    allowance = brief.allowance
    count = int(BEGINNING * allowance.replays * brief.whole / len(brief.problem.recs))
    begins = _begins(brief, named, min(PLACES, count))
    reserved, ends = allowance.reserved, []
    for i, (u, z) in enumerate(begins):
        later = len(begins) - i - 1
        allowance.reserved = reserved + (allowance.replays - reserved) * later / (later + 1)
        ends.append(descended(brief, u, z, ROUGH, STEPS))
    return ends


def _begins(brief: Quantities, named: Members, count: int) -> list[tuple[Array, Compact]]:
    """Return the places from which to fit and their residuals: what was named, and the best of a Latin hypercube."""
    neutral = brief.neutral / brief.size
    at = {c.label: u for c, u in named}
    known = np.concatenate([at.get(c.label, c.neutral) for c in brief.kinds]) / brief.size
    rng = brief.problem.stream("places of a joint fit", [c.label for c in brief.kinds])
    cube = qmc.LatinHypercube(len(neutral), rng=rng).random(count)
    low, high = np.maximum(neutral - REACH, brief.low), np.minimum(neutral + REACH, brief.high)
    places = [known, *(low + cube * (high - low))]
    zs = brief.residuals(places)
    order = sorted(range(len(places)), key=lambda i: mean_size(zs[i]))[:BEGUN]
    return [(places[i], zs[i]) for i in dict.fromkeys([*order, 0])]


def _thinned(quantities: Quantities, at: Array, z: Compact) -> JointFit | None:
    """Return the fit without the quantities that do not gain on held-out episodes, the others fitted again.

    Where the replays end first, the last fit that was judged is returned, idle quantities and all.
    """
    judged: tuple[Quantities, Place, list[_Fold]] | None = None
    try:
        while True:
            place = Place(at, z, quantities.slopes(at, z, SHARP), robust_spread(z), quantities.prior(z))
            folds = _folds(quantities, place)
            judged = quantities, place, folds
            idle = _idle(quantities, place, folds)
            if not idle.any():
                return _concluded(quantities, _last_step(quantities, place), folds)
            if idle.all():
                return None
            at = refitted(quantities, place, np.arange(len(z)), idle)[~idle]
            quantities = replace(
                quantities, kinds=tuple(c for c in quantities.kinds if c.label in set(quantities.owners[~idle]))
            )
            (z,) = quantities.residuals([at])
            at, z = settled(quantities, at, z, SHARP)
    except AllowanceSpent:
        fitted = _concluded(*judged) if judged else None
        return fitted if fitted and fitted.fit.gain > 0 else None


def _folds(quantities: Quantities, place: Place) -> list[_Fold]:
    """Return the fit without each fold: the share of the way that slopes promise which is best for its other episodes.

    Slopes lead astray where a joint sticks or a contact comes and goes, so that simulations decide how far they are
    followed.
    """
    parts = quantities.problem.parts
    trains = [rest(parts, f) for f in range(len(parts))]
    ends = [refitted(quantities, place, train) for train in trains]
    steps = [place.at + share * (end - place.at) for end in ends for share in SHARES]
    zs = iter(quantities.residuals(steps))
    found = []
    for test, train, end in zip(parts, trains, ends, strict=True):
        tried = [(place.at, place.z), *((place.at + share * (end - place.at), next(zs)) for share in SHARES)]
        u, z = min(tried, key=lambda pair: quantities.loss(pair[1], place.scale)[train].mean())
        found.append(_Fold(test, train, replace(place, at=u, z=z)))
    return found


def _last_step(quantities: Quantities, place: Place) -> Place:
    """Return the place where slopes lead once more; the same one where that is no better."""
    if quantities.allowance.replays < 1:
        return place
    moved = refitted(quantities, place, np.arange(len(place.z)))
    (z,) = quantities.residuals([moved])
    return replace(place, at=moved, z=z) if mean_size(z) < mean_size(place.z) else place


def _idle(quantities: Quantities, place: Place, folds: Sequence[_Fold]) -> NDArray[np.bool_]:
    """Return `(d,)` the numbers of quantities without which, the others following, held-out episodes lose nothing sure.

    Those that move least are tried first; each stands at its neutral value from then on.
    """
    losses = quantities.loss(_unseen(folds), place.scale)
    gain = float((quantities.loss(quantities.problem.nominal, place.scale) - losses).mean())
    idle = np.zeros(len(place.at), bool)
    distance = np.abs(place.at - quantities.neutral / quantities.size)
    moved = distance * np.abs(place.slope).mean((1, 2))
    for c in sorted(quantities.kinds, key=lambda c: float(moved[quantities.owners == c.label].sum())):
        own = quantities.owners == c.label
        trial = idle | own
        if distance[own].max() < NEGLIGIBLE:
            idle = trial
            continue
        rise = quantities.loss(_without(quantities, folds, trial), place.scale) - losses
        if rise.mean() <= max(WORTH * gain, SURE * standard_error(rise)):
            idle = trial
    return idle


def _unseen(folds: Sequence[_Fold]) -> Compact:
    """Return the residuals `(E, K)` of every episode by the fit without its fold."""
    z = np.zeros_like(folds[0].place.z)
    for fold in folds:
        z[fold.test] = fold.place.z[fold.test]
    return z


def _without(quantities: Quantities, folds: Sequence[_Fold], fixed: NDArray[np.bool_]) -> Compact:
    """Return the residuals `(E, K)` of held-out episodes with some coordinates at their neutral values."""
    quantities.allowance.spend(1.0)
    z = np.zeros_like(folds[0].place.z)
    for fold in folds:
        u = refitted(quantities, fold.place, fold.train, fixed)
        part = taken(quantities.problem, fold.test)
        (z[fold.test],) = part.residuals([part.setting(acting_members(quantities.members(u)))])
    return z


def _concluded(quantities: Quantities, place: Place, folds: Sequence[_Fold]) -> JointFit:
    """Return a joint fit with its evidence, in the coordinates of its candidates."""
    problem, size = quantities.problem, quantities.size
    base, loss = problem.score.loss(problem.nominal), problem.score.loss(_unseen(folds))
    slope = (place.slope / size[:, None, None]).astype(np.float32)
    plane = Plane(quantities.low * size, quantities.high * size, place.at * size, place.z, slope)
    evidence = CrossFit(base - loss, loss, np.stack([fold.place.at for fold in folds]) * size)
    weighted = place.slope.reshape(len(size), -1) * np.sqrt(weights(place.z / np.float32(place.scale))).ravel()
    values = np.linalg.svd(weighted.astype(float), compute_uv=False)
    return JointFit(Fit(quantities.members(place.at), plane, evidence), int((values > place.prior).sum()))
