"""What each effect changes in a test bed, from a few replays, and fits on the sums of such changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.blind.bed import Bed
from candata.gap.data.robust_loss import weights
from candata.gap.fit.candidates import Candidate, candidates, probes
from candata.gap.measure.score import Compact, Score

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Values at which a scalar's loss is read between its probes.
GRID = 41
#: Rounds of reweighted least squares, and its ridge as a share of the mean diagonal.
ROUNDS, RIDGE = 4, 1e-4


@dataclass(frozen=True)
class Signature:
    """Change of the residuals by one candidate.

    Attributes
    ----------
    candidate : Candidate
    at : (P,) float64
        Coordinates of a scalar's probes, its neutral one among them, rising; empty for a vector.
    change : (P, E, K) or (d, E, K) float32
        Change at each probe; for a vector, per unit of each coordinate.
    """

    candidate: Candidate
    at: Array
    change: Compact

    def read(self, u: Array) -> Compact:
        """Return the change `(E, K)` at coordinates `u (d,)`."""
        if len(self.at) == 0:
            return np.tensordot((u - self.candidate.neutral).astype(np.float32), self.change, 1)
        right = int(np.clip(np.searchsorted(self.at, u[0]), 1, len(self.at) - 1))
        low, high = self.at[right - 1], self.at[right]
        part = np.float32(np.clip((u[0] - low) / (high - low), 0, 1))
        return (1 - part) * self.change[right - 1] + part * self.change[right]

    def fit(self, here: Compact, score: Score, index: Index) -> Array:
        """Return the coordinates that fit residuals `here (E, K)` of some episodes best, on top of what they hold."""
        if len(self.at):
            choice = self.at if self.candidate.choices else np.linspace(self.at[0], self.at[-1], GRID)
            some = score.take(index)
            losses = [some.loss(here[index] + self.read(np.array([u]))[index]).mean() for u in choice]
            return np.array([choice[int(np.argmin(losses))]])
        step = least_squares(here[index], self.change[:, index])
        return np.clip(self.candidate.neutral + step, self.candidate.low, self.candidate.high)


def least_squares(here: Compact, slope: Compact) -> Array:
    """Return the step `(d,)` that makes `here + step . slope` smallest by the robust loss, slope `(d, E, K)`."""
    flat, rows = here.ravel().astype(float), slope.reshape(len(slope), -1).astype(float)
    step = np.zeros(len(rows))
    for _ in range(ROUNDS):
        w = weights((flat + step @ rows).astype(np.float32)).astype(float)
        normal = (rows * w) @ rows.T
        ridge = RIDGE * max(float(np.trace(normal)) / len(rows), 1e-12)
        step = np.linalg.solve(normal + ridge * np.eye(len(rows)), -(rows * w) @ flat)
    return step


def signatures(bed: Bed) -> tuple[Compact, list[Signature]]:
    """Return the nominal residuals `(E, K)` and the signature of every effect that can act and shows."""
    scene = bed.scene
    found = candidates(scene, bed.recs.channels)
    points = [(c, u) for c in found for u in probes(c, scene)]
    nominal, *zs = bed.residuals([(), *((c.setting(u, scene),) for c, u in points)])
    out = []
    for c in found:
        mine = [(u, z - nominal) for (owner, u), z in zip(points, zs, strict=True) if owner is c]
        out.append(_curve(c, nominal, mine) if c.size == 1 else _plane(c, nominal, mine))
    return nominal, out


def _curve(c: Candidate, nominal: Compact, mine: list[tuple[Array, Compact]]) -> Signature:
    """Return the signature of a scalar: its probes in order, the neutral value among them."""
    rows = {float(u[0]): z for u, z in mine} | {float(c.neutral[0]): np.zeros_like(nominal)}
    at = np.array(sorted(rows))
    return Signature(c, at, np.stack([rows[u] for u in at.tolist()]))


def _plane(c: Candidate, nominal: Compact, mine: list[tuple[Array, Compact]]) -> Signature:
    """Return the signature of a vector: the secant through the farthest probes of each coordinate."""
    slope = []
    for i in range(c.size):
        own = {float(u[i] - c.neutral[i]): z for u, z in mine if u[i] != c.neutral[i]} | {0.0: np.zeros_like(nominal)}
        low, high = min(own), max(own)
        slope.append((own[high] - own[low]) / np.float32(high - low))
    return Signature(c, np.zeros(0), np.stack(slope))
