"""Tests of a name against null recordings, in which its effect is known not to act."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import Candidate
from candata.gap.fit.comparison import null_level, standard_error
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.problem import Problem
from candata.gap.fit.world_floor import judged
from candata.gap.measure.floor import null_recordings
from candata.gap.replay.replayer import replay_all
from candata.gap.replay.residuals import residual
from candata.gap.replay.starts import starts
from candata.gap.screening.refinement import joint
from candata.gap.screening.set_slopes import WIDTHS
from candata.gap.search.attribution import Attribution
from candata.gap.validation.intervals import intervals

Array = NDArray[np.float64]
#: Null recordings of every episode on which an effect is tried. Chosen: with twelve episodes their mean gain is known
#: to a seventh of what one recording's differs by.
COPIES = 4
#: Standard errors by which an effect must gain more than on null recordings of the same episodes: in the spread of
#: those from one recording of an episode to the next, and over episodes. Chosen: one in 10,000 and one in 20 of normal
#: errors; the search had the choice of a hundred effects, and a true effect may show in few episodes.
BEYOND_NULLS, BEYOND_CHANCE = 3.7, 1.64
#: The same over episodes, where the mismatch without the name may lie within what nulls show. Chosen: one in 700.
BEYOND_CHANCE_WITHOUT_A_GAP = 3.0
#: Standard errors over episodes by which a mismatch must lie beyond what nulls show to be a gap for sure. Chosen: as
#: many tie two names.
SURE_GAP = 1.0
#: Gain [floors] that no effect can have on a null recording: all that one loses.
ALL_OF_A_NULL = 1.0


def with_names_tested(problem: Problem, found: Attribution) -> Attribution:
    """Return what was found without effects that gain no more than on null recordings, or whose interval holds none.

    Following a recording's noise, or a choice among chaotic outcomes, can make an effect gain on data of the world
    without it; the same effect then gains as much there. What stays is fitted again without them.
    """
    fit = found.chosen
    if fit is None or found.force is not None:
        return found
    world = replace(problem, score=found.score)
    failing = _first_failing(world, fit)
    if failing is None:
        return found
    stays = tuple(m for i, m in enumerate(fit.members) if i != failing)
    if not stays:
        remains = leaves_gap(problem, ())
        return replace(found, chosen=None, tied=(), score=problem.score, remains=remains, rivals=())
    fit = joint(world, stays, world.score.loss(world.nominal), WIDTHS[1:])
    fit, world, remains = judged(world, fit)
    less = replace(found, chosen=fit, tied=(fit,), score=world.score, remains=remains, rivals=())
    return with_names_tested(problem, less)


def _first_failing(problem: Problem, fit: Fit) -> int | None:
    """Return the index of a member that fails a test, those that gain least asked first; None where all pass."""
    measured = {c.name for c, _ in problem.measured}
    here = problem.score.loss(problem.residuals([problem.setting(fit.members)])[0])
    gains = [problem.score.loss(z) - here for z in problem.without_each(fit.members)]
    if len(fit.members) == 1:
        gains = [fit.evidence.gain]
    ends = [fit.split(end) for end in intervals(problem, fit)]
    order = sorted(range(len(gains)), key=lambda i: float(gains[i].mean()))
    for i in order:
        c, _ = fit.members[i]
        if c.name in measured:
            continue
        if _holds_neutral(c, ends[0][i][1], ends[1][i][1]):
            return i
        if not surpasses_nulls(problem, fit.members, i, gains[i]):
            return i
    return None


def _holds_neutral(c: Candidate, low: Array, high: Array) -> bool:
    """Tell whether the interval of a number holds the value at which its effect vanishes."""
    return c.size == 1 and not c.choices and bool(low[0] <= c.neutral[0] <= high[0])


def surpasses_nulls(problem: Problem, members: Members, index: int, gain: Array) -> bool:
    """Tell whether a member's gain `(E,)` on the recordings lies beyond what it gains on null recordings.

    Those are recordings of the world without it, from starts that are equally possible, with noise of their own. The
    member is added to their replay with the value that it has on the real recordings.
    """
    if gain.mean() > ALL_OF_A_NULL:
        return True
    rest = tuple(m for i, m in enumerate(members) if i != index)
    pieces = problem.recs.independent
    nulls = by_piece(null_gains(problem, rest, members), pieces)
    excess = by_piece(gain, pieces) - nulls.mean(0)
    copies, count = nulls.shape
    error = float(np.sqrt(nulls.var(axis=0, ddof=1).mean() / count * (1 + 1 / copies)))
    chance = BEYOND_CHANCE if leaves_gap(problem, rest, SURE_GAP) else BEYOND_CHANCE_WITHOUT_A_GAP
    return bool(excess.mean() > max(BEYOND_NULLS * error, chance * piece_error(excess, nulls)))


def by_piece(values: Array, pieces: NDArray[np.int64]) -> Array:
    """Return `(..., P)` the mean of values `(..., E)` over the episodes of each independent piece of evidence."""
    numbers = np.unique(pieces)
    if len(numbers) == len(pieces):
        return values
    return np.stack([values[..., pieces == n].mean(-1) for n in numbers], axis=-1)


def piece_error(values: Array, nulls: Array) -> float:
    """Return the standard error of the mean over pieces of evidence `(P,)`.

    A single piece tells no spread: then it is that of null recordings `(R, P)` of it.
    """
    return standard_error(values) if len(values) > 1 else float(nulls[:, 0].std(ddof=1))


def leaves_gap(problem: Problem, members: Members, errors: float = 0.0) -> bool:
    """Tell whether the mismatch of a set lies beyond what null recordings show, by so many standard errors."""
    pieces, score = problem.recs.independent, problem.score
    loss = by_piece(score.loss(problem.residuals([problem.setting(members)])[0]), pieces)
    nulls = by_piece(score.null_loss, pieces)
    level = null_level(score if nulls is score.null_loss else replace(score, null_loss=nulls))
    return bool(loss.mean() - errors * piece_error(loss, nulls) > level)


def null_gains(problem: Problem, incumbent: Members, grown: Members, copies: int = COPIES) -> Array:
    """Return `(copies, E)` what a set gains over the incumbent on recordings of the incumbent's world [floors]."""
    worlds = [problem.setting(incumbent), problem.setting(grown)]
    replayer, scene = problem.replayer, problem.replayer.scene
    rng = problem.stream("test of a name", worlds[0])
    nulls = null_recordings(replayer, problem.recs, problem.begin, problem.noise, rng, copies, worlds[0])
    played = replay_all(replayer, nulls, starts(scene, nulls, np.tile(problem.begin.moving, copies)), worlds)
    plan = replace(problem.plan, phase=np.concatenate([problem.plan.phase] * copies))
    each = [np.split(residual(nulls, plan, readings), copies) for readings in played]
    losses = np.array([[problem.score.loss(problem.score.normal(z)) for z in some] for some in each])
    return losses[0] - losses[1]
