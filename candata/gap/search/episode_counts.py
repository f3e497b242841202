"""A scalar cause where contact is chaos: found by how many episodes it explains, not by what the worst leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.candidates import Candidate, probes, widespread
from candata.gap.fit.comparison import null_level, standard_error
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.folds import CrossFit, rest
from candata.gap.fit.problem import Problem
from candata.gap.fit.response import Plane
from candata.gap.fit.stage import Stage
from candata.gap.fit.world_floor import in_world
from candata.gap.measure.score import Compact, Score
from candata.gap.run.pace import COUNT
from candata.gap.screening.episodes import few, taken

Array = NDArray[np.float64]
Member = tuple[Candidate, Array]
#: A mean log loss, the candidate and coordinates that leave it, and residuals `(E, K)` there.
Found = tuple[float, Member, Compact]
#: Scalars that are tried, the first by what they gain; values of each, evenly from its neutral one; how many of these
#: are tried on all episodes, and how often the step around the best is halved. Chosen: of a friction of 0.55, 0.53 and
#: 0.57 left 2.5 floors in the geometric mean, as did 0.65, and the truth 1.5.
TRIED, VALUES, ON_ALL, HALVINGS = 2, 12, 4, 3
#: Scalars of which own worlds are looked at, and how many values of each: those that leave least of a few episodes, of
#: every second one. Chosen: of two true ones one came third, its value first, the other first, its value two further.
ASKED, ASKED_OF_EACH = 4, 2
#: Share of the nominal scene's mean log loss that may be left at most: a world that foretells little because much of it
#: is chaos could do. Chosen: of two recordings of that friction the truth left 0.41 and 0.48.
KEPT = 0.6
#: Null replays of each episode in the worlds that are compared: what chaos deals is known by many draws alone.
#: Record 43.
NULLS = 16
#: Floors that null sets of a world reach from which it is called chaotic. Chosen: 1.3 to 1.6 where an object slips,
#: 1.04 to 1.08 in the worlds of six sets of causes of another hand.
CHAOTIC = 1.25


def recentred(problem: Problem, stage: Stage, chosen: Fit | None) -> tuple[Fit, Problem] | None:
    """Return a scalar cause whose own world leaves no gap, and the problem in units of that world's floor; else None.

    The value is the one that explains most episodes, or else the one in whose own world they are likeliest.
    """
    return _counted(problem, stage, chosen) or _likeliest(problem, stage, chosen)


def _counted(problem: Problem, stage: Stage, chosen: Fit | None) -> tuple[Fit, Problem] | None:
    """Return a scalar cause at the value that explains most episodes, and the problem in units of its world's floor.

    None where that leaves a gap, or where the world of what was `chosen`, or of the best effect alone, foretells the
    recording as surely. What was chosen needs no more than a better value: which effect it is was decided before.

    Where an object slips, some episodes are dealt another outcome even by the true world, and the loss of those hides
    how well it does in the others. The mean logarithm counts each episode by the share of its loss that is explained,
    as a likelihood does whose scale is each episode's own.
    """
    scalars = _scalars(stage, TRIED)
    if not scalars:
        return None
    problem.pace.say("counting the episodes that one value explains", COUNT)
    part = taken(problem, few(problem.recs.tasks))
    found = _least(part, [one for c, u in _with_all(problem, scalars) for one in _values(c, u, part)], ON_ALL)
    if not found:
        return None
    tried = _nearer(problem, _least(problem, [one for _, one, _ in found], ON_ALL))
    left, point, _ = tried[0]
    best = (chosen or stage.fits[0]).members
    before = _typical(problem, problem.residuals([problem.setting(best)])[0])
    if left >= min(before, KEPT * _typical(problem, problem.nominal)):
        return None
    world = in_world(problem, (point,), NULLS)
    if _leaves(world, point):
        return None
    fit = _fitted(problem, world, tried)
    if chosen and chosen.labels == fit.labels:
        return fit, world
    return (fit, world) if _foretells_more(problem, world, point, best) else None


def _likeliest(problem: Problem, stage: Stage, chosen: Fit | None) -> tuple[Fit, Problem] | None:
    """Return a scalar cause at the value in whose own world the recording is likeliest, and the problem in that world.

    None where each leaves a gap there, or what was `chosen`, or the best effect alone, foretells the recording as
    surely. In the nominal world's floor, which knows nothing of the chaos that a cause makes, the truth may explain
    hardly any episode.
    """
    part = taken(problem, few(problem.recs.tasks))
    asked: list[tuple[bool, float, Member]] = []
    for c, u in _with_all(problem, _scalars(stage, ASKED))[:ASKED]:
        for _, point, _ in _least(part, _values(c, u, part)[1::2], ASKED_OF_EACH):
            world = in_world(part, (point,))
            asked.append((not _leaves(world, point), float(_foretold(world, (point,)).mean()), point))
    if not asked:
        return None
    fits, _, point = max(asked, key=lambda one: one[:2])
    if not fits:
        point = _likelier(part, point, (2.0,))
        if _leaves(in_world(part, (point,)), point):
            return None
    point = _likelier(problem, point, (1.0, 0.5, 0.25))
    world, best = in_world(problem, (point,), NULLS), (chosen or stage.fits[0]).members
    if _leaves(world, point) or not _foretells_more(problem, world, point, best):
        return None
    return _fitted(problem, world, _least(problem, [point], 1)), world


def _likelier(problem: Problem, point: Member, shares: Sequence[float]) -> Member:
    """Return the value in whose own world the recording is likeliest, climbing from a point by shares of its step."""
    c, u = point

    def likely(at: Array) -> tuple[float, Array]:
        return float(_foretold(in_world(problem, ((c, at),)), ((c, at),)).mean()), at

    best = likely(u)
    for share in shares:
        ends = (np.clip(best[1] + side * share * _step(c, u, problem), c.low, c.high) for side in (-1, 1))
        ways = [likely(at) for at in ends if at != best[1]]
        while ways and (there := max(ways, key=lambda one: one[0]))[0] > best[0]:
            at, best = np.clip(2 * there[1] - best[1], c.low, c.high), there
            ways = [likely(at)] if at != best[1] else []  # at a bound there is no farther one
    return c, best[1]


def _foretells_more(problem: Problem, world: Problem, point: Member, other: Members) -> bool:
    """Tell whether a value, in its own world, foretells the recording more surely than other effects in theirs."""
    more = _foretold(world, (point,)) - _foretold(in_world(problem, other, NULLS), other)
    return bool(more.mean() > standard_error(more))


def _scalars(stage: Stage, count: int) -> list[Member]:
    """Return the first numbers of a stage that are no choices, each where it explains most alone."""
    found = [f.members[0] for f in stage.fits if f.members[0][0].size == 1 and not f.members[0][0].choices]
    return found[:count]


def alone(problem: Problem, found: Fit, score: Score) -> tuple[Fit, Problem] | None:
    """Return the scalar of a set that leaves no gap alone, and the problem in units of its world's floor; else None.

    Asked in a chaotic world only, by the `score` of the set: there what came beside a cause may make up for a value at
    which it was held when that came. None where the set's world foretells the recording more surely.
    """
    if len(found.members) < 2 or problem.measured or null_level(score) < CHAOTIC:
        return None
    problem.pace.told("asking whether one of these alone leaves no gap")
    for c, u in found.members:
        if c.size > 1 or c.choices:
            continue
        world = in_world(problem, ((c, u),), NULLS)
        if _leaves(world, (c, u)):
            continue
        more = _foretold(in_world(problem, found.members, NULLS), found.members) - _foretold(world, ((c, u),))
        if more.mean() <= standard_error(more):
            return _fitted(problem, world, _least(problem, [(c, u)], 1)), world
    return None


def _leaves(world: Problem, point: Member) -> bool:
    """Tell whether a value leaves a gap in the floor of its own world.

    Not of values that other episodes choose: where contact is chaos, a floor is that of one value alone.
    """
    (z,) = world.residuals([world.setting((point,))])
    return bool(world.score.loss(z).mean() > null_level(world.score))


def _fitted(problem: Problem, world: Problem, tried: Sequence[Found]) -> Fit:
    """Return the fit of the first point tried in the units of its world.

    Each episode is held out by the point that the others choose.
    """
    c, u = tried[0][1]
    logs = np.stack([_logs(problem, z) for *_, z in tried])
    zs = world.residuals([world.setting([p]) for _, p, _ in tried])
    base = world.score.loss(world.nominal)
    chosen = [int(np.argmin(logs[:, rest(world.parts, f)].mean(1))) for f in range(len(world.parts))]
    loss = np.zeros(len(base))
    for i, test in zip(chosen, world.parts, strict=True):
        loss[test] = world.score.loss(zs[i])[test]
    evidence = CrossFit(base - loss, loss, np.array([tried[i][1][1] for i in chosen]))
    return Fit(((c, u),), Plane(c.low, c.high, u, zs[0], np.zeros((1, *zs[0].shape), zs[0].dtype)), evidence)


def _logs(problem: Problem, z: Compact) -> Array:
    """Return `(E,)` the log loss of each episode's residuals `(E, K)`; of what is met exactly, the least there is."""
    return np.log(np.maximum(problem.score.loss(z), np.finfo(float).tiny))


def _typical(problem: Problem, z: Compact) -> float:
    """Return the mean log loss of residuals `(E, K)` over episodes."""
    return float(_logs(problem, z).mean())


def _with_all(problem: Problem, found: Sequence[Member]) -> list[Member]:
    """Return scalars, and the same effects on all elements where those on some were found, each once.

    By the mean loss one element may gain where all of them gain nothing.
    """
    wide = [widespread(c, u, problem.replayer.scene) for c, u in found if c.element is not None]
    return list({c.label: (c, u) for c, u in (*wide, *found) if c.size == 1}.values())


def _values(c: Candidate, u: Array, problem: Problem) -> list[Member]:
    """Return a scalar at values from its neutral one to its farthest probe on the side of `u`; none at its neutral."""
    step = _step(c, u, problem)
    return [(c, c.neutral + i * step) for i in range(1, VALUES + 1)] if step else []


def _step(c: Candidate, u: Array, problem: Problem) -> float:
    """Return the step between values on the side of `u (1,)`, towards it."""
    side = float(np.sign(u[0] - c.neutral[0]))
    return side * max(0.0, *(side * float(p[0] - c.neutral[0]) for p in probes(c, problem.replayer.scene))) / VALUES


def _least(problem: Problem, points: Sequence[Member], count: int) -> list[Found]:
    """Return those points that leave the least mean log loss."""
    zs = problem.residuals([problem.setting([p]) for p in points])
    found = [(_typical(problem, z), p, z) for p, z in zip(points, zs, strict=True)]
    return sorted(found, key=lambda one: one[0])[:count]


def _nearer(problem: Problem, tried: Sequence[Found]) -> list[Found]:
    """Return points with more around the best, at a step that is halved; the best first."""
    c, u = tried[0][1]
    for step in _step(c, u, problem) / 2.0 ** np.arange(1, HALVINGS + 1):
        points = [(c, np.clip(tried[0][1][1] + side * step, c.low, c.high)) for side in (-1, 1)]
        tried = sorted((*tried, *_least(problem, points, len(points))), key=lambda one: one[0])
    return [one for one in tried if one[1][0].label == c.label]


def _foretold(world: Problem, members: Members) -> Array:
    """Return `(E,)` the mean log density of each episode in the world of a set."""
    return world.score.density(world.residuals([world.setting(members)])[0])
