"""Scores: robust loss of normalised residuals by episode, over the floor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.robust_loss import rho
from candata.gap.measure.floor import WORLDS, Floor
from candata.gap.replay.residuals import Layout
from candata.gap.run.streams import Streams

Array = NDArray[np.float64]
Compact = NDArray[np.float32]
#: Null sets from whose mean losses a level is taken. Chosen: eight of them lie above the 99.8 % quantile.
NULL_SETS = 4000


@dataclass(frozen=True)
class Score:
    """Turns residuals into normalised, flat, masked arrays and losses.

    Attributes
    ----------
    sigma : (E, K) float32
        Spread of each of the K block means of an episode.
    mask : (E, K) bool
        Those that were recorded.
    null : (R, E, K) float32
        Normalised null residuals.
    floor : (E,) float64
        Mean loss of each episode's nulls, times what nulls lose on the whole that have no say in it.
    null_loss : (R, E) float64
        Loss of each null over its episode's floor, by the others.
    group : (K,) int64
        Which physical quantity each of the K is.
    typical : float
        Mean size of a null over that of the others.
    loss_error : float
        Relative standard error of a mean loss because the sensors' noise is estimated.
    seed : int
        Seed of the null sets.
    """

    sigma: Compact
    mask: NDArray[np.bool_]
    null: Compact
    floor: Array
    null_loss: Array
    group: NDArray[np.int64]
    typical: float = 1.0
    loss_error: float = 0.0
    seed: int = 0

    @cached_property
    def null_means(self) -> Array:
        """Mean losses `(NULL_SETS,)` of sets of one null replay of each episode, in floors.

        They are wider by how far the nulls' own mean is known, from so many worlds, and the sensors' noise.
        """
        rng, count = Streams(self.seed).of("null sets"), self.null_loss.shape[1]
        chosen = rng.integers(len(self.null_loss), size=(NULL_SETS, count))
        means = 1 + np.sqrt(1 + 1 / WORLDS) * (self.null_loss[chosen, np.arange(count)].mean(1) - 1)
        return means * (1 + self.loss_error * rng.standard_normal(NULL_SETS)) if self.loss_error else means

    def normal(self, residual: Array | Compact) -> Compact:
        """Return residuals `(E, B, D)` as `(E, K)` in units of the floor's spread; zero where not recorded."""
        flat = np.nan_to_num(residual.reshape(len(residual), -1)).astype(np.float32)
        return np.where(self.mask, flat / self.sigma, np.float32(0))

    def loss(self, z: Compact) -> Array:
        """Return `(..., E)` the mean Student-t loss of each episode over its floor; z is `(..., E, K)`."""
        count = np.maximum(self.mask.sum(1), 1)
        return rho(z).sum(-1, dtype=np.float64) / count / self.floor

    def nats(self) -> Array:
        """Return `(E,)` the log likelihood that a loss of one costs each episode, were its block means independent."""
        return np.maximum(self.mask.sum(1), 1) * self.floor

    def density(self, z: Compact) -> Array:
        """Return `(E,)` the mean log density of each episode's residuals, up to a constant; z is `(E, K)`.

        Student's t of the spread of this floor: a proper score of what a world foretells (Gneiting & Raftery 2007).
        """
        lost = np.where(self.mask, rho(z) + np.log(np.where(self.mask, self.sigma, 1)), 0)
        return -lost.sum(-1, dtype=np.float64) / np.maximum(self.mask.sum(1), 1)

    def size(self, z: Compact) -> Array:
        """Return `(..., E)` the discrepancy of each episode: mean size of the residuals over that of its nulls.

        In physical units, a ratio for each quantity (joint angles, positions, rotations, forces), then the mean over
        quantities: half the error is half the discrepancy, and a phase in which the nulls hardly err cannot outweigh
        all others. What decides between effects is the robust loss.
        """
        return self._ratio(z, self.null) / self.typical

    def _ratio(self, z: Compact, null: Compact) -> Array:
        """Return `(..., E)` the mean size of residuals over that of some nulls `(R, E, K)`, over quantities."""
        ratios = [self._mean(z, g) / self._mean(null, g).mean(0) for g in range(self.group.max() + 1)]
        return np.nanmean(ratios, axis=0)

    def _mean(self, z: Compact, group: int) -> Array:
        """Return `(..., E)` the mean size of the residuals of one quantity, in its unit; NaN where there is none."""
        unit = self.sigma * (self.mask & (self.group == group))
        count = (unit > 0).sum(1)
        mean = (np.abs(z) * unit).sum(-1, dtype=np.float64) / np.maximum(count, 1)
        return np.where(count > 0, np.maximum(mean, 1e-12), np.nan)

    def take(self, index: NDArray[np.int64]) -> Score:
        """Return the score of some episodes."""
        return replace(
            self,
            sigma=self.sigma[index],
            mask=self.mask[index],
            null=self.null[:, index],
            floor=self.floor[index],
            null_loss=self.null_loss[:, index],
        )


def score(residual: Array, floor: Floor, plan: Layout, loss_error: float = 0.0, seed: int = 0) -> Score:
    """Return the score for recordings whose residual under the nominal replay is `residual (E, B, D)`.

    `loss_error` is that of the noise by which the floor was made; `seed` draws its null sets.

    Only what both the recording and the nulls hold is compared. One is what a recording of the nominal scene is
    expected to be: nulls lie nearer their own spread and mean than another replay does, the nearer the fewer they are.
    So each part of them is measured by the others.
    """
    count = len(residual)
    sigma = floor.sigma.reshape(count, -1)
    null = floor.null.reshape(len(floor.null), count, -1)
    mask = np.isfinite(residual.reshape(count, -1)) & (sigma > 0)
    z = np.where(mask & np.isfinite(null), np.nan_to_num(null) / sigma, 0.0).astype(np.float32)
    first = Score(sigma.astype(np.float32), mask, z, np.ones(count), np.zeros((len(null), count)), _groups(plan))
    level = np.maximum(first.loss(z).mean(0), 1e-9)
    losses, sizes = first.loss(z) / level, first._ratio(z, z)
    for p, spread in enumerate(floor.without.reshape(-1, *sigma.shape)):
        own = np.arange(len(null)) % len(floor.without) == p
        other = replace(first, sigma=spread.astype(np.float32))
        fresh = z * np.where(mask, sigma / np.maximum(spread, 1e-12), 0).astype(np.float32)
        losses[own] = other.loss(fresh[own]) / np.maximum(other.loss(fresh[~own]).mean(0), 1e-9)
        sizes[own] = other._ratio(fresh[own], fresh[~own])
    # What is learnt from fewer is further off, by the ratio of their numbers.
    kept = 1 - 1 / max(len(floor.without), 1)
    more = [1 + kept * (float(np.nanmean(x)) - 1) for x in (losses, sizes)]
    return replace(
        first,
        floor=level * more[0],
        null_loss=losses / losses.mean(),
        typical=more[1],
        loss_error=loss_error,
        seed=seed,
    )


def _groups(plan: Layout) -> NDArray[np.int64]:
    """Return `(K,)` the number of the quantity (channel and unit) of each block mean."""
    kinds = [(channel, unit) for channel, _, unit in plan.columns]
    order = list(dict.fromkeys(kinds))
    return np.tile([order.index(kind) for kind in kinds], plan.phase.shape[1])
