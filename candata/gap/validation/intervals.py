"""Intervals of the numbers of a fit, by resampled episodes and by how the loss curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.robust_loss import weights
from candata.gap.fit.candidates import typical_size
from candata.gap.fit.comparison import standard_error
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve, Plane
from candata.gap.replay.replayer import needs_simulation
from candata.gap.screening.episodes import taken
from candata.gap.screening.refinement import ENOUGH
from candata.gap.validation.closure import ENDS, REFITS
from candata.statistics import resamples

Index = NDArray[np.int64]
Array = NDArray[np.float64]
#: How much wider than its curvature says an interval of one number of several is. Chosen: of 218 numbers of blind cases
#: of one seed, 72 of them of several, 2.5 covered 98 %, and 70 % of their widths, as of those of one number, 93 %.
WIDER_MANY = 1.75
#: Numbers beyond which a fit is taken to have ended in a valley. Chosen: 16 joint offsets did, 6 numbers of a tracker
#: did not. Record 43.
MANY = 8
#: Half width of a normal 90 % interval, in standard errors.
NORMAL = 1.645
#: First and last distance at which the loss around a fit is measured, as shares of a plausible size, and how many
#: standard errors its curvature there, or what a fit is flattered by, must be. Chosen.
NEAREST, FARTHEST, RISEN = 0.125, 1.0, 2.0
#: Share of a plausible size that bounds must leave on one side at least. Chosen: nearer, losses differ by chance.
LEAST_ROOM = 0.02
#: Most numbers whose curvature is simulated: beyond it their refits say how sure they are, `LOOSE` times wider.
MOST_CURVED, LOOSE = 16, 6.0
#: Fewest episodes by which curvature is measured, of as many or more. Chosen.
CURVED = 10
#: Least half width as a share of the effect: episodes share commands and chaos, and slopes are no finer.
FINEST = 0.01


def intervals(problem: Problem, fit: Fit) -> tuple[Array, Array]:
    """Return 90 % ends `(d,)` of the coordinates; the fitted values always lie inside.

    One number is refitted on resampled episodes; a grid's interval is no finer than the grid, and reaches as far as the
    loss cannot be told from the fit's. Refits of several only follow the slopes of one place, and there contacts that
    come and go look like knowledge: their losses are simulated around the fit instead. So are those of one number where
    its fit seems better than it is.
    """
    own = np.concatenate([u for _, u in fit.members])
    slack = FINEST * np.abs(own - np.concatenate([c.neutral for c, _ in fit.members]))
    if isinstance(fit.response, Plane) and len(own) <= MOST_CURVED:
        low, high = _curved(problem, fit, own)
        return low - slack, high + slack
    refit = fit.response.fitter(problem.score)
    picked = resamples(problem.stream("refits"), len(problem.recs), REFITS)
    found = [refit(picks) for picks in picked]
    low, high = np.quantile(np.array(found), ENDS, axis=0)
    grid = fit.response.resolution(own) / 2 if isinstance(fit.response, Curve) else 0.0
    wider = 1.0 if isinstance(fit.response, Curve) else LOOSE
    slack = np.maximum(grid, slack)
    low = own - wider * np.maximum(own - low, 0) - slack
    high = own + wider * np.maximum(high - own, 0) + slack
    if not isinstance(fit.response, Curve) or fit.response.who.choices:
        return low, high
    if not _is_flattered(problem, fit):
        return low, high
    left, right = _curved(problem, fit, own)
    return np.minimum(low, left), np.maximum(high, right)


def _is_flattered(problem: Problem, fit: Fit) -> bool:
    """Tell whether the loss simulated at a fit is surely more than the one read between the points of its curve.

    Where each world deals other outcomes, the mean of two lies nearer to any third than either, and fit and refits fall
    between the same two points, however far from the truth. (Refits of an inertia all lay at 1.66 to 1.76 of a true
    2.12; losses simulated around the fit say 1.35 to 2.95.)
    """
    ((_, own),), (z,) = fit.members, problem.residuals([problem.setting(fit.members)])
    more = problem.score.loss(z) - problem.score.loss(fit.curve.read(own))
    return bool(more.mean() > RISEN * standard_error(more))


def _curved(problem: Problem, fit: Fit, own: Array) -> tuple[Array, Array]:
    """Return ends `(d,)` from how the simulated loss rises to both sides of the fitted coordinates `own (d,)`.

    Each episode's loss is read at the fit and at two places beside it along each axis of `_axes`, and taken for the
    parabola through them, of slope g and curvature A. The standard error along the axis is sd(g) / sqrt(E) / mean(A)
    (the sandwich of Huber 1967), of which half of many episodes tell enough; axes add up by their squares. The distance
    doubles until the loss has risen surely; where it never does, or bounds leave no room, a plausible size is what is
    known of several numbers, and of one what its refits say. A fit of many numbers ends while it could still descend:
    each axis holds where the loss has risen by no more than what would have ended it.
    """
    scene = problem.replayer.scene
    low, high, typical = (
        np.concatenate(parts)
        for parts in zip(*((c.low, c.high, typical_size(c, scene)) for c, _ in fit.members), strict=True)
    )
    read = np.concatenate([np.full(c.size, not needs_simulation((c.setting(u, scene),))) for c, u in fit.members])
    sizes = np.where(np.concatenate([np.full(c.size, c.choices) for c, _ in fit.members]), 0, typical)
    some = every_other(problem.recs.tasks)
    part, fewer = taken(problem, some), np.sqrt(len(some) / len(problem.recs))
    if isinstance(fit.response, Plane):
        axes, z, wider, unknown = _axes(fit.response, sizes, read), fit.response.z[some], WIDER_MANY, 1.0
    else:
        axes, z, wider, unknown = typical[None], part.residuals([problem.setting(fit.members)])[0], 1.0, 0.0
    here = part.score.loss(z)
    half, shift = np.full(len(axes), unknown), np.zeros(len(axes))
    unfinished = ENOUGH * float(here.mean()) if len(own) > MANY else 0.0
    open_ = [i for i, axis in enumerate(axes) if max(_room(axis, own - low, high - own)) > LEAST_ROOM]
    share = NEAREST
    while open_ and share <= FARTHEST:
        places = {i: _places(share, *_room(axes[i], own - low, high - own)) for i in open_}
        worlds = [problem.setting(fit.split(own + s * axes[i])) for i, pair in places.items() for s in pair]
        losses = iter([part.score.loss(z) - here for z in part.residuals(worlds)])
        known = []
        for i, (a, b) in places.items():
            one, other = next(losses), next(losses)
            slope = (one * b**2 - other * a**2) / (a * b * (b - a))
            curvature = 2 * (one * b - other * a) / (a * b * (a - b))
            if curvature.mean() > RISEN * standard_error(curvature):
                sure = NORMAL * wider * fewer * standard_error(slope) / curvature.mean()
                half[i] = min(max(sure, np.sqrt(2 * unfinished / curvature.mean())), 1.0)
                shift[i] = np.clip(-slope.mean() / curvature.mean(), -share, share)
                known.append(i)
        open_ = [i for i in open_ if i not in known]
        share *= 2
    least, width = np.clip(own + shift @ axes, low, high), np.sqrt(half**2 @ axes**2)
    return np.minimum(own, least) - width, np.maximum(own, least) + width


def every_other(tasks: Sequence[str]) -> Index:
    """Return every other episode of each task; all, where that would leave fewer than `CURVED`."""
    order = sorted(range(len(tasks)), key=lambda i: tasks[i])
    return np.sort(order[:: 2 if len(order) >= 2 * CURVED else 1]).astype(int)


def _axes(plane: Plane, typical: Array, read: NDArray[np.bool_]) -> Array:
    """Return directions `(m, d)` that do not work into one another, each as long as a plausible size lets it be.

    Where numbers make up for one another, as the joints of one finger do, the loss is flat along such a direction
    alone, and rises along each number. They are the principal axes of the slopes, every coordinate in units of its
    plausible size `typical (d,)`; those whose size is 0, choices, take no part. Numbers that only alter what is `read
    (d,)` after the fact have axes of their own, which need no simulation; along an axis of the others, they follow by
    as much as leaves least (conjugate directions by the Schur complement).
    """
    free = np.flatnonzero(typical > 0)
    slope = (plane.slope[free] * np.sqrt(weights(plane.z))).reshape(len(free), plane.z.size).astype(float)
    slope *= typical[free, None]
    normal, read = slope @ slope.T, read[free]
    follow = -np.linalg.pinv(normal[np.ix_(read, read)]) @ normal[np.ix_(read, ~read)]
    moved = np.linalg.eigh(normal[np.ix_(~read, ~read)] + normal[np.ix_(~read, read)] @ follow)[1]
    own = np.linalg.eigh(normal[np.ix_(read, read)])[1]
    axes = np.zeros((len(free), len(typical)))
    count = own.shape[1]
    axes[:count, free[read]] = own.T
    axes[count:, free[~read]] = moved.T
    axes[count:, free[read]] = (follow @ moved).T
    return axes / np.abs(axes).max(axis=1, initial=1e-12, keepdims=True) * typical


def _room(axis: Array, below: Array, above: Array) -> tuple[float, float]:
    """Return how far one may go against and along an axis `(d,)`, with that much room `(d,)` below and above."""
    used = np.flatnonzero(axis)
    along = np.where(axis > 0, above, below)[used] / np.abs(axis[used])
    against = np.where(axis > 0, below, above)[used] / np.abs(axis[used])
    return float(against.min()), float(along.min())


def _places(h: float, below: float, above: float) -> tuple[float, float]:
    """Return two distances at which a loss is read: `h` to both sides, or both to the one where bounds leave more."""
    if min(below, above) >= h:
        return h, -h
    side = float(np.copysign(min(h, max(below, above) / 2), above - below))
    return side, 2 * side
