"""How far: held-out discrepancies before and after, shares, intervals and support by resampling episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.data.robust_loss import weights
from candata.gap.fit.candidates import typical_size
from candata.gap.fit.comparison import BLUNT, standard_error
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Curve, Plane
from candata.gap.replay.replayer import needs_simulation, replay_all
from candata.gap.replay.residuals import residual
from candata.gap.screening.refinement import ENOUGH
from candata.gap.screening.shortlist import taken
from candata.gap.search.attribution import Attribution
from candata.rotation import difference
from candata.schema.report import Gap
from candata.statistics import resamples

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Resamples of the episodes for gaps and support, and for parameters (each is a refit).
RESAMPLES, REFITS = 2000, 100
#: What errors of joints' readings are called, with their unit, of hinges and of slides.
JOINT_MEASURES = {
    "joint_position": ("joint_position_rad", "slide_position_m"),
    "joint_velocity": ("joint_velocity_rad_s", "slide_velocity_m_s"),
    "joint_effort": ("joint_effort_N_m", "slide_effort_N"),
}
#: How much wider than its curvature says an interval of one number of several is. Chosen: of 218 numbers of blind cases
#: of one seed, 72 of them of several, 2.5 covered 98 %, and 70 % of their widths, as of those of one number, 93 %.
WIDER_MANY = 1.75
#: Numbers beyond which a fit is taken to have ended in a valley. Chosen: 16 joint offsets did, 6 numbers of a tracker
#: did not. (Of 17 numbers of two such fits 6 were covered without what that adds, 15 with it.)
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
#: What a set leaves [floors, or the share of the gap, the smaller] where a right one is as likely as a wrong one.
#: Measured on 96 effects that were named in two runs of blind cases: a set that leaves much is seldom the cause.
DOUBTFUL = 0.1
#: Ends of a 90 % interval.
ENDS = (0.05, 0.95)
#: Floors of what remains up to which a gap counts as closed where a set is trusted.
REMAINING = 0.30
#: One in so many episodes at most may hold most of what remains and be told apart. Chosen.
FEW = 8
NONE = np.zeros(0, np.int64)


@dataclass(frozen=True)
class HeldOut:
    """Episodes that no fit has seen, replayed without and with the chosen effects.

    Attributes
    ----------
    recs : Recordings
    before, after : dict of str to ndarray
        Readings of the nominal and the repaired simulator.
    size_before, size_after : (E,) float64
        Discrepancy in floors of the repaired world.
    points : (E, d) float64
        Coordinates with which each episode was repaired; empty without a chosen set.
    """

    recs: Recordings
    before: dict[str, Array]
    after: dict[str, Array]
    size_before: Array
    size_after: Array
    points: Array


def held_out(problem: Problem, fit: Fit | None) -> HeldOut:
    """Return every episode replayed with what was fitted without it (cross-fitting), by rollouts."""
    before = problem.before
    size_before = problem.score.size(problem.nominal)
    if fit is None:
        return HeldOut(problem.recs, before, before, size_before, size_before, np.zeros((len(problem.recs), 0)))
    after = {n: v.copy() for n, v in before.items()}
    points = np.zeros((len(problem.recs), fit.evidence.points.shape[1]))
    for test, u in zip(problem.parts, fit.evidence.points, strict=True):
        world = problem.setting(fit.split(u))
        part = replay_all(problem.replayer, problem.recs.take(test), problem.begin.take(test), [world])[0]
        points[test] = u
        for name, values in part.items():
            after[name][test] = values
    size_after = problem.score.size(problem.score.normal(residual(problem.recs, problem.plan, after)))
    return HeldOut(problem.recs, before, after, size_before, size_after, points)


def gap(before: Array, after: Array, rng: np.random.Generator, gap_left: bool, ids: Sequence[str] = ()) -> Gap:
    """Return the gap in floors and the share of it that closes, with a 90 % bootstrap interval over episodes.

    1 - (after - floor) / (before - floor), floor 1; a share above 1 is the floor's own luck and is printed as 1.
    Where there is no gap (`gap_left` false), there is no share. Of episodes with `ids`, few that hold most of what
    remains are told apart: a contact that begins too deep throws an object farther than any replay of it, true or not.
    """
    if not gap_left:
        return Gap(before=round(float(before.mean()), 4), after=round(float(before.mean()), 4))
    picks = resamples(rng, len(before), RESAMPLES)
    many = _closed(before[picks].mean(1), after[picks].mean(1))
    low, high = np.quantile(many, ENDS)
    odd, rest = _outlying(before, after) if len(ids) else (NONE, NONE)
    return Gap(
        before=round(float(before.mean()), 4),
        after=round(float(after.mean()), 4),
        closed=round(float(_closed(before.mean(), after.mean())), 4),
        low=round(float(low), 4),
        high=round(float(high), 4),
        outlying=tuple(ids[e] for e in odd),
        closed_elsewhere=round(float(_closed(before[rest].mean(), after[rest].mean())), 4) if len(odd) else None,
    )


def _outlying(before: Array, after: Array) -> tuple[Index, Index]:
    """Return the fewest episodes that hold more than half of what remains, where all had much to explain; the rest."""
    order, left = np.argsort(-after, kind="stable"), after - 1
    count = 1 + int(np.argmax(np.cumsum(left[order]) > left.sum() / 2))
    few, rest = np.sort(order[:count]), np.sort(order[count:])
    is_few = count <= len(order) // FEW and left.mean() > DOUBTFUL and before[rest].mean() - 1 > REMAINING
    return (few, rest) if is_few else (NONE, rest)


def _closed(before: Array, after: Array) -> Array:
    """Return the closed share, at most 1, at least -1."""
    return np.clip(1 - (after - 1) / np.maximum(before - 1, 1e-6), -1, 1)


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


def trust(size: Gap) -> float:
    """Return how much the support of a set counts, 0 to 1, by what it leaves unexplained."""
    left = min(max(size.after - size.floor, 0.0), 1.0 - (1.0 if size.closed is None else size.closed))
    return 1.0 / (1.0 + (max(left, 0.0) / DOUBTFUL) ** 2)


def support(first: Sequence[Fit], base: Array, rng: np.random.Generator) -> Array:
    """Return, for each fit, the share of resampled sets of episodes in which its held-out loss is the least.

    The nominal scene takes part, so the shares need not add up to 1.
    """
    losses = np.stack([base, *(f.evidence.loss for f in first)])
    picks = resamples(rng, losses.shape[1], RESAMPLES)
    winner = losses[:, picks].mean(2).argmin(0)
    return np.bincount(winner, minlength=len(losses))[1:] / RESAMPLES


def shares(problem: Problem, fit: Fit, rivals: Sequence[Fit] = ()) -> list[tuple[float, float]]:
    """Return (leave-one-out share, support) of each member of a set.

    The share is what the loss rises when the member is left out and nothing refitted, over the whole gain; support
    is how often, when episodes are resampled, that rise is positive and no one of the `rivals` without the member, sets
    of as many effects, leaves less. How much more one leaves is known as well as fits are sharp (`BLUNT` of the rise,
    one standard deviation): an alias that loses by next to nothing, in every episode alike, takes half.
    """
    if len(fit.members) == 1:
        return [(1.0, float("nan"))]
    own = problem.score.loss(fit.plane.z)
    whole = max(float((problem.score.loss(problem.nominal) - own).mean()), 1e-9)
    picks = resamples(problem.stream("shares"), len(own), RESAMPLES)
    out = []
    for label, z in zip(fit.labels, problem.without_each(fit.members), strict=True):
        rise = problem.score.loss(z) - own
        holds = rise[picks].mean(1) > 0
        for rival in rivals:
            if label not in rival.labels:
                rng = problem.stream("how sharp fits are", label, rival.labels)
                blunt = BLUNT * abs(float(rise.mean())) * rng.standard_normal(RESAMPLES)
                holds &= (rival.evidence.loss - fit.evidence.loss)[picks].mean(1) + blunt > 0
        out.append((round(float(rise.mean()) / whole, 3), float(holds.mean())))
    return out


def measures(held: HeldOut, slides: NDArray[np.bool_]) -> dict[str, dict[str, float]]:
    """Return mean, spread and median over episodes of the mean error over rows, in physical units, before and after.

    Parameters
    ----------
    held : HeldOut
    slides : (J,) bool
        Joints that are slides [m]; the others are hinges [rad].
    """
    out: dict[str, dict[str, float]] = {}
    for name, size in _errors(held.recs, held.before, slides).items():
        repaired = _errors(held.recs, held.after, slides)[name]
        out[name] = {
            f"{label}{suffix}": float(statistic(values))
            for label, values in (("before", size), ("after", repaired))
            for suffix, statistic in (("", np.nanmean), ("_sd", np.nanstd), ("_median", np.nanmedian))
        }
    return out


def _errors(recs: Recordings, readings: dict[str, Array], slides: NDArray[np.bool_]) -> dict[str, Array]:
    """Return `(E,)` mean error of each episode by quantity, with its unit in the name."""
    out = {}
    for channel, recorded in recs.compared.items():
        if channel == "object_pose":
            shift = np.linalg.norm(recorded[..., :3] - readings[channel][..., :3], axis=-1)
            turn = np.linalg.norm(difference(recorded[..., 3:], readings[channel][..., 3:]), axis=-1)
            out["object_position_m"] = _mean(shift)
            out["object_rotation_deg"] = np.degrees(_mean(turn))
            continue
        error = np.abs(recorded - readings[channel])
        if channel == "fingertip_force":
            out["fingertip_force_N"] = _mean(error.reshape(len(error), -1))
            continue
        if channel == "joint_effort" and recs.unscaled_effort:
            continue  # its size tells nothing
        for name, columns in zip(JOINT_MEASURES[channel], (~slides, slides), strict=True):
            if columns.any():
                out[name] = _mean(error[:, :, columns].reshape(len(error), -1))
    return out


def _mean(values: Array) -> Array:
    """Return `(E,)` the mean of the finite values of each row; NaN where there are none."""
    finite = np.isfinite(values)
    count = finite.sum(1)
    return np.where(count > 0, np.where(finite, values, 0.0).sum(1) / np.maximum(count, 1), np.nan)


def separating_task(problem: Problem, attribution: Attribution) -> str | None:
    """Return the task among the recorded ones in which the tied candidates differ most, in floors."""
    first, second = attribution.tied[:2]
    a, b = (problem.residuals([problem.setting(f.members)])[0] for f in (first, second))
    apart = ((a - b) ** 2).sum(1) / np.maximum(problem.score.mask.sum(1), 1)
    tasks = sorted(set(problem.recs.tasks) - {""})
    if not tasks:
        return None
    return max(tasks, key=lambda t: float(apart[[i for i, own in enumerate(problem.recs.tasks) if own == t]].mean()))
