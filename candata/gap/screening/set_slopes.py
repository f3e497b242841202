"""Slopes of residuals around a set, by simulations on both sides of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.robust_loss import weights
from candata.gap.fit.candidates import typical_size
from candata.gap.fit.fits import Members
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Plane
from candata.gap.measure.score import Compact
from candata.gap.replay.replayer import is_simulated
from candata.gap.screening.signature_screen import slopes
from candata.scenes.traits import is_toss

Array = NDArray[np.float64]
World = Callable[[Array], Members]
#: Most coordinates whose slopes are simulated, of how many effects all are, and over which shares of a plausible
#: effect's size, one after another. (Sixteen joint offsets beside a torque limit, seventeen numbers, left 4.6 floors by
#: signatures alone, and leave 1.3; the truth has 1.2.)
#: Contact comes and goes: over a narrow width slopes tell of single contacts, and fit nothing but them. Record 43.
MOST_SLOPES, FEW_EFFECTS, WIDTHS = 16, 3, (0.5, 0.25, 0.12)
#: How many times farther than along the strongest direction slopes are simulated along weak ones, at most. Chosen: the
#: 20 true sets left 0.9 floors too much in all, 0.9 with 2.5 and 1.3 with 8.
FARTHER = 4.0


def differences(
    problem: Problem, members: Members, world: World, z: Compact, width: float, known: Compact | None = None
) -> Compact:
    """Return slopes `(d, E, K)` by rollouts that differ by a share of a plausible size; zero for choices.

    Where slopes are `known` roughly, along their principal directions, farther where these show less. Of numbers that
    make up for one another each does much, and all together little, which the difference of their slopes, each off by
    the chaos of contact, does not tell; a rollout along that direction does. Numbers that only alter forces as they are
    read need no such help: no chaos is in what they do, and one simulation serves them all.
    """
    at, low, high = (np.concatenate(parts) for parts in zip(*((u, c.low, c.high) for c, u in members), strict=True))
    free = np.concatenate([np.full(c.size, not c.choices) for c, _ in members])
    size = np.concatenate([typical_size(c, problem.replayer.scene) for c, _ in members])
    slope = np.zeros((len(at), *z.shape), z.dtype)
    if not free.any():
        return slope
    ways, far = np.diag(size)[free], np.full(int(free.sum()), width)
    played = np.concatenate([np.full(c.size, is_simulated(c.name)) for c, _ in members])
    inner = (played & (np.minimum(at - low, high - at) > width * size))[free]
    if known is not None and inner.any():
        vectors, weaker = _principal(known[free][inner], size[free][inner], z)
        ways[inner] = vectors.T @ ways[inner]
        far[inner] *= np.minimum(weaker, FARTHER)
    steps = [_inside(at - low, high - at, way, h) for way, h in zip(ways, far, strict=True)]
    zs = problem.residuals([problem.setting(world(at + h * way)) for h, way in zip(steps, ways, strict=True)])
    along = np.stack([(moved - z) / np.float32(h) for moved, h in zip(zs, steps, strict=True)])
    slope[free] = np.tensordot((ways[:, free] / size[free] ** 2).T.astype(z.dtype), along, 1)
    return slope


def _principal(slope: Compact, size: Array, z: Compact) -> tuple[Array, Array]:
    """Return the principal directions of slopes `(d, E, K)`, columns of `(d, d)` in units of `size (d,)`, and how much
    weaker each is than the strongest.
    """
    flat = (slope * size[:, None, None].astype(slope.dtype)).reshape(len(size), -1)
    values, vectors = np.linalg.eigh(((flat * weights(z).ravel()) @ flat.T).astype(float))
    if values[-1] <= 0:
        return np.eye(len(size)), np.ones(len(size))
    return vectors, np.sqrt(values[-1] / np.maximum(values, 1e-12 * values[-1]))


def _inside(below: Array, above: Array, way: Array, far: float) -> float:
    """Return how far to go along a way `(d,)`, or against it where bounds leave more room there."""
    used = np.flatnonzero(way)
    on, back = (float((np.where(side * way > 0, above, below)[used] / np.abs(way[used])).min()) for side in (1.0, -1.0))
    return min(far, on) if on >= min(far, back) else -min(far, back)


def around(problem: Problem, members: Members, world: World) -> Plane:
    """Return the plane of candidates around their coordinates; `world` gives those that act at coordinates."""
    at = np.concatenate([u for _, u in members])
    z = problem.residuals([problem.setting(world(at))])[0]
    low, high = (np.concatenate([getattr(c, side) for c, _ in members]) for side in ("low", "high"))
    return Plane(low, high, at, z, slopes_of(problem, members, world, z))


def slopes_of(problem: Problem, members: Members, world: World, z: Compact) -> Compact:
    """Return `(d, E, K)` how residuals `z (E, K)` change with each coordinate; none for a choice.

    From signatures; those of tosses by rollouts beside all that acts: a signature of another landing says little.
    """
    if is_toss(problem.replayer.scene):
        return differences(problem, members, world, z, WIDTHS[0])
    return np.concatenate([slopes(problem, c, u) for c, u in members])


def divided(members: Members, u: Array) -> Members:
    """Return the members at stacked coordinates `u (d,)`."""
    ends = np.cumsum([c.size for c, _ in members])
    return tuple((c, part) for (c, _), part in zip(members, np.split(u, ends[:-1]), strict=True))
