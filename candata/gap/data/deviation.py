"""Slow random deviations of readings: what one repeat of a motion differs from the next by, beyond sensor noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.rotation import exp, multiply

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Channels of a residual, in the order of its columns.
COLUMNS = ("joint_position", "joint_velocity", "joint_effort", "object_pose", "fingertip_force")


@dataclass(frozen=True)
class SlowDeviation:
    """Random deviations of E episodes that last: combinations of shapes that were seen, and paths like none seen.

    A run differs from the next by little that is new at each moment: one friction, one supply voltage of that run. So
    a deviation is a normal random combination of those of other runs of the motion, whose covariance is theirs, and a
    first-order autoregression. The autoregression of a motion of which no shape is known has a random size.

    Attributes
    ----------
    sd : (E, T, D) float64
        Standard deviation of the autoregression [rad, m or N], by the columns of a residual.
    time_s : (D,) float64
        Time over which it is forgotten, to 1/e.
    shapes : (M, S, T, D) float64
        For each motion up to S shapes, the rest zero; M = 0 where none is known.
    motion : (E,) int64
        Which of the shapes are those of an episode.
    piece : (E,) int64
        Episodes of one piece share what is drawn.
    """

    sd: Array
    time_s: Array
    shapes: Array
    motion: Index
    piece: Index

    @property
    def is_shared(self) -> bool:
        """Whether episodes share a deviation."""
        return len(np.unique(self.piece)) < len(self.piece) and bool(self.sd.any() or self.shapes.any())

    @property
    def variance(self) -> Array:
        """Variance `(E, T, D)` of the deviations."""
        shapes = (self.shapes**2).sum(1)
        return self.sd**2 + (shapes[self.motion] if len(shapes) else 0.0)

    def take(self, index: Index) -> SlowDeviation:
        """Return the deviations of some episodes."""
        return replace(self, sd=self.sd[index], motion=self.motion[index], piece=self.piece[index])

    def copies(self, count: int) -> SlowDeviation:
        """Return the deviations of `count` recordings of all episodes, one after the other, that share none."""
        apart = np.repeat(np.arange(count), len(self.sd)) * (self.piece.max(initial=0) + 1)
        made = self.take(np.tile(np.arange(len(self.sd)), count))
        return replace(made, piece=made.piece + apart)

    def drawn(self, rate_hz: float, rng: np.random.Generator) -> Array:
        """Return deviations `(E, T, D)` at `rate_hz` rows a second."""
        pieces, number = np.unique(self.piece, return_inverse=True)
        kept = np.exp(-1 / (rate_hz * self.time_s))
        paths = rng.standard_normal((self.sd.shape[1], len(pieces), self.sd.shape[2]))
        paths[1:] *= np.sqrt(1 - kept**2)
        for row in range(1, len(paths)):
            paths[row] += kept * paths[row - 1]
        size, weights = rng.standard_normal(len(pieces)), rng.standard_normal((len(pieces), self.shapes.shape[1]))
        has_shape = np.append(np.any(self.shapes, axis=(1, 2, 3)), False)
        known = has_shape[self.motion] if len(self.shapes) else np.zeros(len(self.sd), bool)
        size = np.where(known, 1.0, size[number])
        out = size[:, None, None] * paths.swapaxes(0, 1)[number] * self.sd
        if len(self.shapes):
            out += np.einsum("es,estd->etd", weights[number], self.shapes[self.motion])
        return out


def unshaped(sd: Array, time_s: Array, piece: Index | None = None) -> SlowDeviation:
    """Return deviations of which no shape is known, `sd (E, T, D)`; each episode is its own piece by default."""
    count = len(sd)
    shapes = np.zeros((0, 0, *sd.shape[1:]))
    return SlowDeviation(sd, time_s, shapes, np.zeros(count, int), np.arange(count) if piece is None else piece)


def shifted_readings(readings: dict[str, Array], shifts: Array) -> dict[str, Array]:
    """Return readings with shifts `(E, T, D)` added, by the columns of a residual; other channels pass through.

    Poses are moved and then turned about the world's axes, all else is added to.
    """
    out, first = dict(readings), 0
    for channel in (c for c in COLUMNS if c in readings):
        values = readings[channel]
        width = 6 if channel == "object_pose" else int(np.prod(values.shape[2:]))
        shift = shifts[:, : values.shape[1], first : first + width]
        first += width
        if channel == "object_pose":
            turned = multiply(exp(shift[..., 3:]), values[..., 3:])
            out[channel] = np.concatenate([values[..., :3] + shift[..., :3], turned], axis=-1)
        else:
            out[channel] = values + shift.reshape(values.shape)
    return out
