"""How far: held-out discrepancies before and after, the closed share, and support by resampling episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.fit.comparison import BLUNT
from candata.gap.fit.fits import Fit
from candata.gap.fit.problem import Problem
from candata.gap.replay.replayer import replay_all
from candata.gap.replay.residuals import residual
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
