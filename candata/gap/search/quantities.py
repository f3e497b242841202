"""Quantities: effects of a problem as one vector of numbers, what it leaves, at what cost, and steps down."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from candata.gap.data.robust_loss import rho, weights
from candata.gap.fit.candidates import Candidate, typical_size
from candata.gap.fit.fits import Members, acting_members
from candata.gap.fit.folds import FOLDS
from candata.gap.fit.problem import Problem
from candata.gap.measure.score import Compact
from candata.gap.screening.set_slopes import divided
from candata.statistics import MAD_TO_SD

Array = NDArray[np.float64]


class AllowanceSpent(Exception):
    """The allowed replays are spent."""


@dataclass
class Allowance:
    """Replays of all episodes that are still to be had, and how many of them are reserved for a later step."""

    replays: float
    reserved: float = 0.0

    def spend(self, replays: float) -> None:
        """Take replays off.

        Raises
        ------
        AllowanceSpent
            When fewer are left that are not reserved.
        """
        if replays > self.replays - self.reserved:
            raise AllowanceSpent
        self.replays -= replays


@dataclass
class Quantities:
    """Effects of a problem as one vector of coordinates `u (d,)`, each in units of its plausible size.

    Attributes
    ----------
    problem : Problem
    kinds : tuple of Candidate
    allowance : Allowance
    whole : int
        Episodes of the whole problem, by which replays are counted.
    """

    problem: Problem
    kinds: tuple[Candidate, ...]
    allowance: Allowance
    whole: int

    def __post_init__(self) -> None:
        """Set sizes and bounds of the coordinates."""
        scene = self.problem.replayer.scene
        self.size = np.concatenate([typical_size(c, scene) for c in self.kinds])
        self.neutral, low, high = (
            np.concatenate([getattr(c, side) for c in self.kinds]) for side in ("neutral", "low", "high")
        )
        self.low, self.high = low / self.size, high / self.size
        self.owners = np.repeat([c.label for c in self.kinds], [c.size for c in self.kinds])

    def members(self, u: Array) -> Members:
        """Return the members at coordinates."""
        pairs = tuple((c, c.neutral) for c in self.kinds)
        return divided(pairs, np.clip(u * self.size, self.low * self.size, self.high * self.size))

    def residuals(self, places: Sequence[Array]) -> list[Compact]:
        """Return normalised residuals `(E, K)` at each place, all simulated together."""
        self.allowance.spend(len(places) * len(self.problem.recs) / self.whole)
        return self.problem.residuals([self.problem.setting(acting_members(self.members(u))) for u in places])

    def slopes(self, u: Array, z: Compact, width: float) -> Compact:
        """Return `(d, E, K)` how residuals change with each coordinate, by differences towards the wider side."""
        steps = np.where(self.high - u >= np.minimum(width, u - self.low), width, -width)
        moved = self.residuals([u + step * unit for step, unit in zip(steps, np.eye(len(u)), strict=True)])
        return np.stack([(there - z) / np.float32(step) for there, step in zip(moved, steps, strict=True)])

    def loss(self, z: Compact, scale: float) -> Array:
        """Return the robust loss `(E,)` of residuals of a spread."""
        return self.problem.score.loss(z / np.float32(scale))

    def prior(self, z: Compact) -> float:
        """Return what a plausible size off a neutral value costs: one independent residual (maximum a posteriori).

        So what the data do not tell stays as the scene says. Residuals of one episode that err together count as one:
        their mean is known by (1 - r) / (1 + r) as many, r being the correlation of neighbours.

        Source: G. V. Bayley and J. M. Hammersley, "The 'Effective' Number of Independent Observations in an
        Autocorrelated Time Series", JRSS Supplement 8 (1946).
        """
        blocks = z.reshape(len(z), -1, len(self.problem.plan.columns)).astype(float)
        r = float((blocks[:, 1:] * blocks[:, :-1]).sum() / max((blocks[:, 1:] ** 2).sum(), 1e-12))
        most = blocks.shape[1]
        return robust_spread(z) * float(np.sqrt(np.clip((1 + r) / max(1 - r, 1e-9), 1.0, most)))


def robust_spread(z: Compact) -> float:
    """Return the robust spread of residuals, at least that of noise: what counts as an outlier depends on it."""
    return max(1.0, MAD_TO_SD * float(np.median(np.abs(z[z != 0])))) if (z != 0).any() else 1.0


def mean_size(z: Compact) -> float:
    """Return the mean size of residuals."""
    return float(np.abs(z).mean())


#: Most Gauss-Newton steps of a fit, shares of a step that are simulated, and share of the loss that a step must take
#: off for another to follow. Chosen.
STEPS, SHARES, HELPS = 12, (1.0, 0.5, 0.2, 0.05), 0.01
#: Room, in plausible sizes, that a number at its bound has beyond it: a bounded fit needs some. Chosen.
EDGE = 1e-6


@dataclass(frozen=True)
class Place:
    """Coordinates `at (d,)`, residuals `z (E, K)` and their `slope (d, E, K)` there.

    `scale` is the spread of the residuals, and `prior` how much of them a plausible size off a neutral value costs.
    """

    at: Array
    z: Compact
    slope: Compact
    scale: float
    prior: float


def descended(quantities: Quantities, at: Array, z: Compact, width: float, steps: int) -> tuple[Array, Compact]:
    """Return coordinates and residuals `(E, K)` after Gauss-Newton steps within bounds, while they help.

    Of each step some shares are simulated together, and the best is taken. It ends where no share helps, or replays do.
    """
    neutral = quantities.neutral / quantities.size
    with suppress(AllowanceSpent):
        for _ in range(steps):
            place = Place(at, z, quantities.slopes(at, z, width), robust_spread(z), quantities.prior(z))
            way = refitted(quantities, place, np.arange(len(z))) - at
            tried = [(at + share * way) for share in SHARES]
            places = [(at, z), *zip(tried, quantities.residuals(tried), strict=True)]

            def cost(pair: tuple[Array, Compact], place: Place = place) -> float:
                off = place.prior / place.scale * (pair[0] - neutral)
                return float(rho(pair[1] / np.float32(place.scale)).sum(dtype=np.float64) + 0.5 * (off**2).sum())

            before = cost(places[0])
            at, z = min(places, key=cost)
            if cost((at, z)) > (1 - HELPS) * before:
                break
    return at, z


def settled(quantities: Quantities, at: Array, z: Compact, width: float) -> tuple[Array, Compact]:
    """Return coordinates and residuals fitted on; what is needed to judge a fit stays of the allowance."""
    quantities.allowance.reserved = 2.0 * (len(at) + len(quantities.kinds) + len(SHARES) * FOLDS + 2)
    at, z = descended(quantities, at, z, width, STEPS)
    quantities.allowance.reserved = 0.0
    return at, z


def refitted(
    quantities: Quantities, place: Place, train: NDArray[np.int64], fixed: NDArray[np.bool_] | None = None
) -> Array:
    """Return the coordinates `(d,)` that fit some episodes best by the slopes of a place, within bounds.

    Coordinates that are `fixed` stand at their neutral values.
    """
    neutral = quantities.neutral / quantities.size
    free = np.ones(len(place.at), bool) if fixed is None else ~fixed
    u = np.where(free, place.at, neutral)
    if not free.any():
        return u
    here = place.z[train] + np.tensordot((u - place.at).astype(np.float32), place.slope[:, train], 1)
    weight = np.sqrt(weights(here / np.float32(place.scale))).ravel().astype(float)
    matrix = (place.slope[free][:, train].reshape(int(free.sum()), -1) * weight).T
    matrix = np.concatenate([matrix, place.prior * np.eye(matrix.shape[1])])
    target = np.concatenate([-here.ravel() * weight, place.prior * (neutral - u)[free]])
    room = (quantities.low - u - EDGE)[free], (quantities.high - u + EDGE)[free]
    u[free] += lsq_linear(matrix, target, room).x
    return np.clip(u, quantities.low, quantities.high)
