"""A set of causes in units of the floor of its own world: what it leaves is judged, and fitted, against that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from candata.gap.floor import floor
from candata.gap.folds import cross_fit
from candata.gap.refine import SHARP, joint, scanned
from candata.gap.score import score
from candata.gap.search import Fit, Members, Problem
from candata.gap.shortlist import brief
from candata.gap.worth import leaves

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
    factor = np.where(new.score.mask, problem.score.sigma / new.score.sigma, 0).astype(np.float32)
    response = best.response.rescaled(factor)
    evidence = cross_fit(response, new.score, new.parts, new.score.loss(new.nominal))
    return new, replace(best, response=response, evidence=evidence)


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


def refitted(problem: Problem, first: Fit, world: Problem, best: Fit) -> Fit | None:
    """Return a set refitted in units of the floor of its own world; None where that gains nothing.

    Only one that seemed to leave nothing in units of the `problem` before, so that no slopes were simulated. (An
    object's mass centre and softer contact left -0.07 floors in those of the nominal world and 0.07 in their own; a
    look at all other effects took 44 CPU s, and then the two, refitted, left nothing.) A scalar alone is tried between
    the points at which it is known.
    """
    if len(best.members) < 2:
        found = scanned(world, brief(world)[0], best, world.score.loss(world.nominal))
        return found if found is not best else None
    left = float(problem.score.loss(first.plane.z).mean()) - 1
    if left >= SHARP * (float(problem.score.loss(problem.nominal).mean()) - 1 - left):
        return None
    found = joint(world, best.members, world.score.loss(world.nominal))
    return found if found.gain > best.gain else None
