"""What is known of each number: its interval, and which of its ends the recordings tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.comparison import standard_error
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem
from candata.gap.screening.episodes import taken
from candata.gap.validation.intervals import NORMAL, RISEN, every_other, intervals

Array = NDArray[np.float64]
#: Standard errors, and log likelihood [nats], by which the loss must rise for that to count: what a parabola has risen
#: by at the ends of its 90 % interval (half of `NORMAL`, as the rise grows by the square of the distance and its error
#: by the distance; Wilks 1938). What stuck joints do differs by less than any sensor tells, alike in every episode:
#: such a rise has next to no standard error, and costs nothing.
ERRORS, COSTS = NORMAL / 2, NORMAL**2 / 2
#: How many times as far as an interval reaches the loss must have risen for that interval to stand. Chosen.
TWICE = 2.0
#: Distances tried at once between two, and how often between the last without a rise and the first with one: an edge is
#: known to a 27th of where it may be. Chosen: a number of two ends costs four worlds, one known from one side twelve.
STEPS, ROUNDS = 2, 3
#: Share of what counts as a rise up to which a value explains as well as the fit. Chosen.
AS_WELL = 0.5


@dataclass(frozen=True)
class Known:
    """What is known of the numbers of a fit, in its coordinates.

    Attributes
    ----------
    value : (d,) float64
        The fit; of a number known from one side, the value nearest the known end that explains as well.
    low, high : (d,) float64
        Ends of the 90 % intervals; where an end is not known, how far was tried.
    no_low, no_high : (d,) bool
        Ends that the recordings do not tell: up to the bound the loss is nowhere higher than at the fit.
    """

    value: Array
    low: Array
    high: Array
    no_low: NDArray[np.bool_]
    no_high: NDArray[np.bool_]


@dataclass(eq=False)
class _Side:
    """One way from the fit of one number.

    Attributes
    ----------
    number : int
        Which number of the fit.
    reach, room : float
        How far its interval goes, and how far from the fit the loss is simulated.
    sign : int
        1 upwards, -1 downwards.
    tried : dict of float to float
        Rise of the loss at each distance, in units of what counts as one.
    """

    number: int
    reach: float
    room: float
    sign: int
    tried: dict[float, float] = field(default_factory=lambda: {0.0: 0.0})

    @property
    def is_open(self) -> bool:
        """Whether the loss has surely risen nowhere."""
        return max(self.tried.values()) < RISEN / ERRORS

    @property
    def near(self) -> float:
        """Distance at which the loss must have risen for the interval to stand."""
        return min(TWICE * self.reach, self.room)

    @property
    def risen(self) -> float | None:
        """The least distance at which the loss has risen; None where it has nowhere."""
        return min((d for d, rise in self.tried.items() if rise >= 1), default=None)

    @property
    def flat(self) -> float:
        """The largest distance before any rise that was tried."""
        return max(d for d in self.tried if self.risen is None or d < self.risen)

    @property
    def end(self) -> float:
        """Distance of the interval's end: across a flat stretch the first place where the loss has risen.

        It is never nearer than the interval says.
        """
        if self.flat == 0.0 and self.risen is not None:
            return self.reach
        return max(self.reach, self.room if self.risen is None else self.risen)

    @property
    def least(self) -> float:
        """The largest distance tried, before any rise, at which the fit is as good."""
        return max(d for d, rise in self.tried.items() if d <= self.flat and rise <= AS_WELL)


def known_numbers(problem: Problem, fit: Fit) -> Known:
    """Return what is known of each number of a fit.

    Intervals come from resampling and curvature (`validation/intervals.py`). Of each number that is the only one of its
    member, the others held where they are, the loss is simulated twice as far out to both sides, at the effect's
    absence on one side and at the bound on the other. Where it has not risen so near, the end is where it first has;
    where it has surely risen nowhere up to the bound, that end is not known. Where it has not risen at the effect's
    absence either, replays of single episodes do not tell the number. Its interval stays as it is, and so do those of
    choices and vectors.
    """
    low, high = intervals(problem, fit)
    own = np.concatenate([u for _, u in fit.members])
    pairs = _pairs(fit, own, low, high)
    sides = [side for pair in pairs for side in pair]
    _look(problem, fit, [(s, (s.near, s.room)) for s in sides])
    pairs = [pair for pair in pairs if pair[0].risen is not None]
    sides = [side for pair in pairs for side in pair]
    unclear = [s for s in sides if s.risen != s.near]
    _look(problem, fit, [(s, _between(s.near, s.room if s.risen is None else s.risen)) for s in unclear])
    edges = [s for toward, away in pairs for s in (toward, away) if s in unclear or away.is_open]
    for _ in range(ROUNDS):
        _look(problem, fit, [(s, _inside(s.flat, s.risen)) for s in edges if s.risen is not None])
    value, no_low, no_high = own.copy(), np.zeros(len(own), bool), np.zeros(len(own), bool)
    for toward, away in pairs:
        i = toward.number
        low[i], high[i] = (own[i] + s.sign * s.end for s in sorted((toward, away), key=lambda s: s.sign))
        if away.is_open:
            (no_low if away.sign < 0 else no_high)[i] = True
            value[i] += toward.sign * toward.least
    return Known(value, low, high, no_low, no_high)


def _pairs(fit: Fit, own: Array, low: Array, high: Array) -> list[tuple[_Side, _Side]]:
    """Return the two sides of each member's only number: towards the effect's absence, and away from it to the bound.

    `own`, `low` and `high (d,)` are the fit and its intervals.
    """
    out, i = [], -1
    for c, u in fit.members:
        i += c.size
        if c.size > 1 or c.choices or c.is_neutral(u):
            continue
        up, bound = (1, c.high[0]) if u[0] > c.neutral[0] else (-1, c.low[0])
        reach = {-1: float(own[i] - low[i]), 1: float(high[i] - own[i])}
        toward, away = abs(float(u[0] - c.neutral[0])), abs(float(bound - u[0]))
        out.append((_Side(i, reach[-up], toward, -up), _Side(i, reach[up], away, up)))
    return out


def _between(near: float, far: float) -> list[float]:
    """Return distances between two, each as many times the one before; none where there is no room."""
    return np.geomspace(near, far, STEPS + 2)[1:-1].tolist() if 0 < near < far else []


def _inside(near: float, far: float) -> list[float]:
    """Return evenly spaced distances between two."""
    return np.linspace(near, far, STEPS + 2)[1:-1].tolist()


def _look(problem: Problem, fit: Fit, wanted: Sequence[tuple[_Side, Sequence[float]]]) -> None:
    """Add to sides how far the loss rises at distances from the fit, all simulated together."""
    places = [(side, d) for side, distances in wanted for d in dict.fromkeys(distances) if d not in side.tried]
    if not places:
        return
    some = every_other(problem.recs.tasks)
    part, own = taken(problem, some), np.concatenate([u for _, u in fit.members])
    worlds = [fit.members]
    for side, d in places:
        u = own.copy()
        u[side.number] += side.sign * d
        worlds.append(fit.split(u))
    here, *losses = (part.score.loss(z) for z in part.residuals([problem.setting(world) for world in worlds]))
    # Of many episodes every other is simulated: all of them tell as much more.
    more = len(problem.recs) / len(some)
    unit = part.score.nats()
    for (side, d), loss in zip(places, losses, strict=True):
        rise = loss - here
        error = standard_error(rise) / np.sqrt(more)
        cost = more * float((rise * unit).sum())
        side.tried[d] = min(float(rise.mean()) / max(ERRORS * error, 1e-12), cost / COSTS)
