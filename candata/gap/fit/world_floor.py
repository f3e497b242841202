"""A set of causes in units of the floor of its own world: what it leaves is judged, and fitted, against that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candata.gap.fit.acceptance import leaves
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.folds import cross_fit
from candata.gap.fit.problem import Problem
from candata.gap.measure.floor import floor
from candata.gap.measure.score import score

#: Null replays of each episode around an accepted set.
NULLS_AGAIN = 4
#: A set, the problem in units of the floor of its world, and whether a gap remains that is to be looked into.
Grown = tuple[Fit, Problem, bool]


def judged(problem: Problem, fit: Fit) -> Grown:
    """Return a fit and the problem in units of the floor of its world, and whether a gap remains."""
    world, fit = rescored(problem, fit)
    return fit, world, leaves(world, fit)


def rescored(problem: Problem, best: Fit) -> tuple[Problem, Fit]:
    """Return problem and fit in units of the floor of the fitted world."""
    new = in_world(problem, best.members)
    return new, in_units(best, problem, new)


def in_units(fit: Fit, old: Problem, new: Problem) -> Fit:
    """Return a fit in units of the floor of another problem, held out again in these."""
    factor = np.where(new.score.mask, old.score.sigma / new.score.sigma, 0).astype(np.float32)
    response = fit.response.rescaled(factor)
    evidence = cross_fit(response, new.score, new.parts, new.score.loss(new.nominal))
    return replace(fit, response=response, evidence=evidence)


def in_world(problem: Problem, members: Members, nulls: int = NULLS_AGAIN) -> Problem:
    """Return the problem in units of the floor of a set's world, of so many null replays of each episode."""
    world = problem.setting(members)
    spread = floor(
        problem.replayer,
        problem.recs,
        problem.begin,
        problem.plan,
        problem.noise,
        problem.stream("floor", world),
        nulls,
        world,
    )
    return replace(
        problem, score=score(problem.raw, spread, problem.plan, problem.score.loss_error, problem.streams.seed)
    )
