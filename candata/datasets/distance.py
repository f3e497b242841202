"""Distance between the samples of two groups of episodes, for any deal of the episodes to the groups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Numbers kept of an episode's samples; fewer samples are kept as they are.
ATOMS = 32
#: Edges at which distributions are compared, at quantiles of all samples.
EDGES = 257
#: Random deals of the episodes to the two groups.
DEALS = 400
#: Least and most bars drawn of a distribution, and samples that make one.
FEWEST_BARS, BARS, SAMPLES_A_BAR = 8, 32, 5


@dataclass(frozen=True)
class GroupSpread:
    """Samples, episodes that had any, median and the middle 90 %."""

    samples: int
    episodes: int
    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Bars:
    """Edges `(B + 1,)` of bars and the share of each group's samples in them, `(B,)`; the tails are left out."""

    edges: Array
    this: Array
    against: Array


@dataclass(frozen=True)
class Pool:
    """Samples of one statistic of two groups of episodes.

    Attributes
    ----------
    edges : (G,) float64
        Values at which distributions are compared.
    cumulative : (N, G) float64
        Samples of each episode up to each edge.
    counts : (N,) float64
        Samples of each episode.
    """

    edges: Array
    cumulative: Array
    counts: Array

    @staticmethod
    def sketch(values: Array) -> NDArray[np.float32]:
        """Return an episode's samples; of many, the means of 32 equal shares of them in order, which keep the mean."""
        if len(values) <= ATOMS:
            return np.asarray(values, np.float32)
        sums = np.concatenate([[0.0], np.cumsum(np.sort(values))])
        ends = np.linspace(0, len(values), ATOMS + 1)
        shares = np.diff(np.interp(ends, np.arange(len(sums)), sums))
        return np.asarray(shares * ATOMS / len(values), np.float32)

    @classmethod
    def of(
        cls,
        first_group: Sequence[tuple[int, int, NDArray[np.float32]]],
        second_group: Sequence[tuple[int, int, NDArray[np.float32]]],
        first_size: int,
        second_size: int,
    ) -> Pool:
        """Return the pool of two groups given as (episode's number, samples, sketch)."""
        entries = [*first_group, *((number + first_size, count, atoms) for number, count, atoms in second_group)]
        values = np.concatenate([atoms for _, _, atoms in entries]).astype(float)
        owner = np.concatenate([np.full(len(atoms), number) for number, _, atoms in entries])
        weight = np.concatenate([np.full(len(atoms), count / len(atoms)) for _, count, atoms in entries])
        unique = np.unique(values)
        edges = unique if len(unique) <= EDGES else np.unique(np.quantile(values, np.linspace(0, 1, EDGES)))
        histogram = np.zeros((first_size + second_size, len(edges)))
        np.add.at(histogram, (owner, np.searchsorted(edges, values)), weight)
        return cls(edges, np.cumsum(histogram, axis=1), histogram.sum(axis=1))

    def shares(self, deal: Flags) -> Array:
        """Return the cumulative distribution of the episodes dealt to a group, `(K, G)` for deals `(K, N)`."""
        group = deal.astype(float)
        with np.errstate(invalid="ignore", divide="ignore"):
            return (group @ self.cumulative) / (group @ self.counts)[:, None]

    def distance(self, deals: Flags) -> Array:
        """Return Wasserstein's distance between the two groups of each deal `(K, N)`, NaN where one has no samples.

        Source: C. Villani, Optimal Transport (2009), ch. 6: in one dimension the area between the two cumulative
        distributions; here between edges at quantiles of all samples, where it is exact for up to 257 values.
        """
        gaps = np.abs(self.shares(deals) - self.shares(~deals))
        return np.asarray(gaps[:, :-1] @ np.diff(self.edges))

    def spread(self, deal: Flags) -> float:
        """Return the standard deviation when both groups weigh the same; distances reach at most twice it."""
        mixture = (self.shares(deal[None])[0] + self.shares(~deal[None])[0]) / 2
        weight = np.diff(mixture, prepend=0.0)
        mean = weight @ self.edges
        return float(np.sqrt(weight @ (self.edges - mean) ** 2))

    def quantile(self, deal: Flags, at: float) -> float:
        """Return a quantile of one group."""
        place = int(np.searchsorted(self.shares(deal[None])[0], at - 1e-9))
        return float(self.edges[min(place, len(self.edges) - 1)])

    def bars(self, deal: Flags) -> Bars:
        """Return both groups as bars from the least to the largest of their middle 98 %."""
        ends = [self.quantile(side, at) for side in (deal, ~deal) for at in (0.01, 0.99)]
        samples = min(self.counts[deal].sum(), self.counts[~deal].sum())
        edges = np.linspace(min(ends), max(ends), int(np.clip(samples / SAMPLES_A_BAR, FEWEST_BARS, BARS)) + 1)
        sides = [np.diff(self._share_below(side, edges)) for side in (deal, ~deal)]
        return Bars(edges, sides[0], sides[1])

    def _share_below(self, deal: Flags, at: Array) -> Array:
        """Return the share of one group up to each value, the first value left out.

        Between edges at quantiles samples count as spread evenly, else those of a tail would pile up in one bar.
        """
        distribution = self.shares(deal[None])[0]
        if len(self.edges) >= EDGES:
            return np.asarray(np.interp(at, self.edges, distribution))
        places = np.searchsorted(self.edges, at, side="right")
        places[0] = np.searchsorted(self.edges, at[0], side="left")  # the first bar holds its own edge
        return np.asarray(np.concatenate([[0.0], distribution])[places])


def spread_of(pool: Pool, deal: Flags) -> GroupSpread:
    """Return the statistics of one group that a row holds."""
    counts = pool.counts[deal]
    return GroupSpread(
        samples=round(float(counts.sum())),
        episodes=int((counts > 0).sum()),
        median=pool.quantile(deal, 0.5),
        low=pool.quantile(deal, 0.05),
        high=pool.quantile(deal, 0.95),
    )
