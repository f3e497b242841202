"""Responses: how normalised residuals change with a candidate's coordinates, and the best coordinates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.robust_loss import weights
from candata.gap.fit.candidates import Candidate
from candata.gap.measure.score import Compact, Score

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Fitter = Callable[[Index], Array]
#: Points between two neighbouring probes at which a scalar's loss is read off the interpolated response.
BETWEEN = 6
#: Coordinates no farther apart are the same.
SAME = 1e-9
#: Scales by which residuals are divided in the rounds of iteratively reweighted least squares. Large residuals first
#: count as in plain least squares, and only near the fit as outliers (graduated non-convexity, Blake & Zisserman 1987):
#: a far optimum is found too.
SCALES = (32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Curve:
    """Response of a scalar or a choice: residuals at points along it, linear in between.

    Attributes
    ----------
    who : Candidate
    at : (m,) float64
        Coordinates of the points, rising; the neutral one among them.
    z : (m, E, K) float32
        Normalised residuals there.
    sure : (m,) bool
        Points that were simulated on the recording itself; the others come from signatures.
    """

    who: Candidate
    at: Array
    z: Compact
    sure: NDArray[np.bool_]

    def with_probes(self, at: Array, z: Compact, sure: bool = True) -> Curve:
        """Return the curve with more points; one that stands already is replaced.

        What a simulation on the recording says against the signatures is taken to grow evenly from one such point to
        the next, and to stay beyond the last.
        """
        first = np.unique(np.round(at, 9), return_index=True)[1]
        at, z = at[first], z[first]
        mine = self._corrected(at, z) if sure and not self.who.choices and not self.sure.all() else self.z
        keep = ~np.isin(np.round(self.at, 9), np.round(at, 9))
        points = np.concatenate([self.at[keep], at])
        order = np.argsort(points)
        joined = np.concatenate([mine[keep], z])[order]
        return replace(self, at=points[order], z=joined, sure=np.append(self.sure[keep], np.full(len(at), sure))[order])

    def _corrected(self, at: Array, z: Compact) -> Compact:
        """Return `(m, E, K)` residuals with the error seen at new points spread over those that are not sure."""
        knots = np.concatenate([self.at[self.sure], at])
        error = np.stack([new - self.read(np.array([u])) for u, new in zip(at, z, strict=True)])
        order = np.argsort(knots)
        known = np.concatenate([np.zeros((int(self.sure.sum()), *error.shape[1:]), np.float32), error])[order]
        out = self.z.copy()
        for i in np.flatnonzero(~self.sure):
            shares = [np.interp(self.at[i], knots[order], unit) for unit in np.eye(len(knots))]
            out[i] += np.tensordot(np.array(shares, np.float32), known, 1)
        return out

    def nearest_sure(self, u: Array) -> float:
        """Return how far from `u (1,)` the nearest point lies that was simulated on the recording."""
        return float(np.abs(self.at[self.sure] - u[0]).min())

    def was_simulated(self, u: Array) -> bool:
        """Tell whether the residuals at `u (1,)` come from the recording itself."""
        return self.nearest_sure(u) <= SAME

    def rescaled(self, factor: Compact) -> Curve:
        """Return the curve with residuals times `factor (E, K)`: another floor's units."""
        return replace(self, z=self.z * factor)

    def grid(self) -> Array:
        """Return `(G,)` coordinates at which losses are read: the probes and points between them."""
        if self.who.choices:
            return self.at
        steps = np.arange(BETWEEN) / BETWEEN
        inner = (self.at[:-1, None] + np.diff(self.at)[:, None] * steps).ravel()
        return np.append(inner, self.at[-1])

    def resolution(self, u: Array) -> float:
        """Return the distance of the grid's points around `u (1,)`."""
        right = int(np.clip(np.searchsorted(self.at, u[0]), 1, len(self.at) - 1))
        return float(self.at[right] - self.at[right - 1]) / BETWEEN

    def read(self, u: Array) -> Compact:
        """Return `(E, K)` residuals at coordinate `u (1,)`."""
        right = int(np.clip(np.searchsorted(self.at, u[0]), 1, len(self.at) - 1))
        share = np.float32((u[0] - self.at[right - 1]) / (self.at[right] - self.at[right - 1]))
        return self.z[right - 1] + np.clip(share, 0, 1) * (self.z[right] - self.z[right - 1])

    def neutral(self) -> Compact:
        """Return `(E, K)` residuals without the effect."""
        return self.z[int(np.argmin(np.abs(self.at - self.who.neutral[0])))]

    def table(self, score: Score, base: Compact | None = None) -> Array:
        """Return `(G, E)` losses along the grid; with `base (E, K)`, of that residual moved by the response."""
        offset = np.float32(0) if base is None else base - self.neutral()
        return np.stack([score.loss(self.read(np.array([u])) + offset) for u in self.grid()])

    def least_around(self, u: Array, score: Score) -> float:
        """Return the bound below which the mean loss cannot fall between the points around `u (1,)`, if it is convex.

        A convex function lies above the line through its two points on one side, continued beyond them.
        """
        loss = np.array([score.loss(z).mean() for z in self.z])
        bounds = []
        for i in {int(np.clip(np.searchsorted(self.at, u[0] + d), 1, len(loss) - 1)) for d in (-SAME, SAME)}:
            steps = np.linspace(self.at[i - 1], self.at[i], 2 * BETWEEN + 1)
            lines = [
                loss[a] + (loss[b] - loss[a]) / (self.at[b] - self.at[a]) * (steps - self.at[a])
                for a, b in ((i - 2, i - 1), (i, i + 1))
                if a >= 0 and b < len(loss)
            ]
            bounds.append(float(np.max(lines, axis=0).min() if lines else loss[i - 1 : i + 1].min()))
        return min(bounds)

    def fitter(self, score: Score) -> Fitter:
        """Return the function that gives the coordinate `(1,)` with the least mean loss over training episodes.

        Between the points at which losses are read it is the vertex of the parabola through the best and its two
        neighbours: of two aliases, the one whose points happen to lie nearer the truth would seem to explain more.
        """
        table, grid, own = self.table(score), self.grid(), self.who.neutral[0]

        def best(train: Index) -> Array:
            loss = table[:, train].mean(1)
            i = int(np.argmin(loss))
            inside = 0 < i < len(grid) - 1 and not self.who.choices and abs(grid[i] - own) > SAME
            return np.array([_vertex(grid[i - 1 : i + 2], loss[i - 1 : i + 2]) if inside else grid[i]])

        return best


@dataclass(frozen=True)
class Plane:
    """Response of several coordinates: linear around a reference.

    Attributes
    ----------
    low, high : (d,) float64
        Bounds of the coordinates.
    at : (d,) float64
        Reference coordinates.
    z : (E, K) float32
        Normalised residuals there.
    slope : (d, E, K) float32
        Change of the residuals with each coordinate.
    """

    low: Array
    high: Array
    at: Array
    z: Compact
    slope: Compact

    def rescaled(self, factor: Compact) -> Plane:
        """Return the plane with residuals times `factor (E, K)`: another floor's units."""
        return replace(self, z=self.z * factor, slope=self.slope * factor)

    def read(self, u: Array) -> Compact:
        """Return `(E, K)` residuals at coordinates `u (d,)`."""
        return self.z + np.tensordot((u - self.at).astype(np.float32), self.slope, 1)

    def fitter(self, score: Score) -> Fitter:
        """Return the function that gives the best coordinates `(d,)` for training episodes, or the reference.

        The latter where reweighting ends higher than it began, as it may where the loss has several least places.
        """
        here = score.loss(self.z)

        def fit(train: Index) -> Array:
            found = self.best(train)
            end = score.loss(self.read(found))
            return found if end[train].mean() <= here[train].mean() else self.at

        return fit

    def best(self, train: Index) -> Array:
        """Return the coordinates `(d,)` with the least robust loss over the training episodes.

        Iteratively reweighted least squares with a small ridge, each coordinate in units of its range.
        """
        slope, z = self.slope[:, train], self.z[train]
        ridge = _ridge(slope, self.high - self.low)
        step = np.zeros(len(self.at))
        for scale in SCALES:
            now = z + np.tensordot(step.astype(np.float32), slope, 1)
            step = _solve(slope, z, weights(now / np.float32(scale)), ridge)
        return np.clip(self.at + step, self.low, self.high)


def _vertex(at: Array, loss: Array) -> float:
    """Return where the parabola through three points `(3,)` is least, the middle one lying lowest."""
    (a, m, b), (fa, fm, fb) = at, loss
    left, right = (m - a) * (fm - fb), (m - b) * (fm - fa)
    if left == right:
        return float(m)
    return float(np.clip(m - 0.5 * ((m - a) * left - (m - b) * right) / (left - right), a, b))


def _ridge(slope: Compact, span: Array) -> Array:
    """Return the diagonal of a ridge that leaves well-seen coordinates alone, each in units of its range."""
    square = np.maximum(span, 1e-12) ** 2
    strength = np.einsum("dek,dek->d", slope, slope, dtype=np.float64) * square
    return (1e-9 * strength.max(initial=0.0) + 1.0) / square


def _solve(slope: Compact, z: Compact, weight: Compact, ridge: Array) -> Array:
    """Return the weighted least-squares step."""
    flat = slope.reshape(len(slope), -1)
    weighted = flat * weight.ravel()
    return np.linalg.solve((weighted @ flat.T).astype(float) + np.diag(ridge), -weighted @ z.ravel())


@dataclass(frozen=True)
class NullQuadratic:
    """Null losses around zero for several coordinates: gain of a step u is `2 b u - u A u`, halved.

    Attributes
    ----------
    normal : (R, E, d, d) float64
    right : (R, E, d) float64
        Normal equations with the weights of each null, in units of the floor's loss.
    ridge : (d,) float64
    """

    normal: Array
    right: Array
    ridge: Array

    def step(self, chosen: Index, train: Index) -> Array:
        """Return the coordinates fitted to training episodes of a null set; `chosen (E,)` replica of each."""
        a = self.normal[chosen[train], train].sum(0)
        b = self.right[chosen[train], train].sum(0)
        return np.linalg.solve(a + np.diag(self.ridge), b)

    def gain(self, chosen: Index, test: Index, u: Array) -> Array:
        """Return the gain of each test episode at `u`, by the quadratic that bounds the robust loss from above."""
        a, b = self.normal[chosen[test], test], self.right[chosen[test], test]
        return b @ u - 0.5 * np.einsum("i,eij,j->e", u, a, u)


def null_quadratic(plane: Plane, score: Score) -> NullQuadratic:
    """Return the quadratic of a plane on every null replay."""
    unit = np.maximum(score.mask.sum(1), 1) * score.floor
    slope = plane.slope.transpose(1, 0, 2)
    normal, right = [], []
    for z in score.null:
        weighted = slope * weights(z)[:, None, :]
        normal.append(weighted @ slope.transpose(0, 2, 1) / unit[:, None, None])
        right.append(-np.einsum("edk,ek->ed", weighted, z, dtype=np.float64) / unit[:, None])
    ridge = _ridge(plane.slope, plane.high - plane.low) / unit.mean()
    return NullQuadratic(np.stack(normal).astype(float), np.stack(right), ridge)
