"""What is known of each number: its interval, and which ends of it the recordings tell, by losses simulated outwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from candata.gap.compare import standard_error
from candata.gap.search import Fit, Problem
from candata.gap.shortlist import taken
from candata.gap.shrink import NORMAL, every_other, intervals

Array = NDArray[np.float64]
#: Log likelihood [nats] that a rise must cost to count, beside its standard error: half the 90 % quantile of chi squared
#: of one degree of freedom (Wilks 1938). Where joints stick, what they do differs by less than any sensor tells, in
#: every episode alike: such a rise has no standard error to speak of, and costs nothing.
COSTS = NORMAL**2 / 2
#: How many times as far as an interval reaches the loss must have risen for that interval to stand. Chosen.
TWICE = 2.0
#: Points between there and the bound, and points by which the end of a flat stretch is narrowed. Chosen: four steps of
#: equal ratio lead from 1 % of what is possible to all of it by a factor of three each.
STEPS = 3
#: Share of what counts as a rise up to which a value explains as well as the fit. Chosen.
AS_WELL = 0.25


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
        Ends that the recordings do not tell: up to the bound the loss is no higher than at the fit.
    """

    value: Array
    low: Array
    high: Array
    no_low: NDArray[np.bool_]
    no_high: NDArray[np.bool_]


@dataclass(eq=False)
class _Side:
    """One way from the fit of one number: `reach` is how far its interval goes, `room` how far its bound lies.

    `tried` holds, for each distance, the rise of the loss in units of what counts as one.
    """

    number: int
    sign: int
    reach: float
    room: float
    tried: dict[float, float] = field(default_factory=lambda: {0.0: 0.0})

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
        """Distance of the interval's end: where the rise counts, never nearer than resampling says.

        Across a stretch that was flat it is the first place where the loss has risen; else the rise in units of its
        error grows evenly, as that of a parabola does.
        """
        if self.risen is None:
            return max(self.reach, self.room)
        even = self.flat == 0.0
        return max(self.reach, self.risen / self.tried[self.risen] if even else self.risen)

    @property
    def least(self) -> float:
        """The largest distance tried, before any rise, at which the fit is as good."""
        return max(d for d, rise in self.tried.items() if d <= self.flat and rise <= AS_WELL)


def known(problem: Problem, fit: Fit) -> Known:
    """Return what is known of each number of a fit.

    Intervals come from resampling and curvature (`shrink.intervals`). Of each number that is a member's only one, the
    others held where they are, the loss is simulated twice as far out to both sides, and at the bounds. Where it has
    not risen so near, it is simulated on the way to the bound: the end is where it first has, or is not known where it
    never does. Choices and vectors keep their intervals.
    """
    low, high = intervals(problem, fit)
    own = np.concatenate([u for _, u in fit.members])
    least, most = (np.concatenate([getattr(c, end) for c, _ in fit.members]) for end in ("low", "high"))
    lone = np.concatenate([np.full(c.size, c.size == 1 and not c.choices) for c, _ in fit.members])
    pairs = [
        (_Side(i, -1, float(own[i] - low[i]), float(own[i] - least[i])),
         _Side(i, 1, float(high[i] - own[i]), float(most[i] - own[i])))
        for i in np.flatnonzero(lone).tolist()
    ]  # fmt: skip
    sides = [side for pair in pairs for side in pair]
    _look(problem, fit, [(s, (s.near, s.room)) for s in sides])
    unclear = [s for s in sides if s.risen != s.near]
    _look(problem, fit, [(s, _between(s.near, s.room if s.risen is None else s.risen)) for s in unclear])
    one_sided = [(a, b) for a, b in pairs if (a.risen is None) != (b.risen is None)]
    edges = [s for s in sides if s.risen is not None and (s in unclear or any(s in pair for pair in one_sided))]
    _look(problem, fit, [(s, np.linspace(s.flat, s.risen, STEPS + 2)[1:-1]) for s in edges])
    no_low, no_high, value = np.zeros(len(own), bool), np.zeros(len(own), bool), own.copy()
    for below, above in pairs:
        i = below.number
        low[i], high[i] = own[i] - below.end, own[i] + above.end
        if (below, above) in one_sided:
            no_low[i], no_high[i] = below.risen is None, above.risen is None
            side = above if no_low[i] else below
            value[i] += side.sign * side.least
    return Known(value, low, high, no_low, no_high)


def _between(near: float, far: float) -> list[float]:
    """Return distances between two, each as many times the one before; none where the nearer is not less."""
    return np.geomspace(near, far, STEPS + 2)[1:-1].tolist() if 0 < near < far else []


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
        side.tried[d] = min(float(rise.mean()) / max(error, 1e-12), cost / COSTS)
