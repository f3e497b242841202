"""Episodes: the few that all effects are looked at on first, and the problem that they pose."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.problem import Problem
from candata.gap.measure.score import Compact
from candata.scenes.traits import is_toss

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Episodes that are looked at first, and how many times as many there must be for it to be worth while. On six, true
#: effects that stand out at all kept their rank (17 drawn cases of 20 episodes; four gave up one rank in one of them).
FEW, WORTHWHILE = 6, 2
#: Most episodes of one task among those that are most telling. Chosen.
EACH = 3


def brief(problem: Problem) -> tuple[Problem, Index]:
    """Return the problem that a few of the episodes pose, and which; itself where that saves little.

    Tosses are short, and where one lands decides what it shows: all of them are looked at.
    """
    index = few(problem.recs.tasks) if problem.telling is None else problem.telling
    if is_toss(problem.replayer.scene) or WORTHWHILE * len(index) > len(problem.recs):
        return problem, np.arange(len(problem.recs))
    return taken(problem, index), index


def first_look(problem: Problem) -> tuple[Problem, Index]:
    """Return the problem of the episodes on which all effects are looked at first, and which.

    They are a few. Where signatures are those of these recordings, each costs a replay of its own: then they are the
    more telling half of the few.
    """
    part, index = brief(problem)
    if part is problem or not problem.library.seen:
        return part, index
    half = telling_half(part, part.nominal)
    return taken(part, half), index[half]


def telling_half(problem: Problem, here: Compact) -> Index:
    """Return half of the episodes: those of each task that leave most of the residuals `here (E, K)`."""
    left = problem.score.loss(here)
    return _each_in_turn(problem.recs.tasks, left)[: len(left) // 2]


def few(tasks: Sequence[str], left: Array | None = None) -> Index:
    """Return a few episodes, each task among them: the same ones for the same tasks, so that signatures are shared.

    Where none are, those of each task that leave most, by what each leaves: `left (E,)`.
    """
    return np.sort(_each_in_turn(tasks, left)[: max(FEW, len(set(tasks)))])


def _each_in_turn(tasks: Sequence[str], left: Array | None) -> Index:
    """Return the episodes in the order of one of each task, then another of each; of a task those first of which most
    is left, and of tasks those of which most is. Where nothing is told of that, as they were recorded.
    """
    seen: Counter[str] = Counter()
    turns = []
    for rank, i in enumerate(range(len(tasks)) if left is None else np.argsort(-left, kind="stable")):
        turns.append((seen[tasks[i]], rank, int(i)))
        seen[tasks[i]] += 1
    return np.array([i for _, _, i in sorted(turns)])


def looked_into(problem: Problem, here: Compact) -> Problem:
    """Return the problem in which every candidate is simulated on the recording, first on its most telling episodes.

    Those are the ones of which the residuals `here (E, K)` leave most. What shows only where contact happens so, as a
    fingertip that twists too easily, may show in none of the few that all recordings of the same commands share.
    """
    left = problem.score.loss(here)
    each: Counter[str] = Counter()
    found: list[int] = []
    for i in np.argsort(-left):
        if len(found) < FEW and each[problem.recs.tasks[i]] < EACH:
            each[problem.recs.tasks[i]] += 1
            found.append(int(i))
    # Of one task alone there are no others to take.
    found += [int(i) for i in np.argsort(-left) if int(i) not in found][: FEW - len(found)]
    return replace(problem, simulated=True, telling=np.sort(found))


def with_telling(problem: Problem) -> Problem:
    """Return the problem with each task's most telling episodes looked at first, where no signatures are shared."""
    if not problem.library.seen:
        return problem
    return replace(problem, telling=few(problem.recs.tasks, problem.score.loss(problem.nominal)))


def taken(problem: Problem, index: Index) -> Problem:
    """Return the problem that some of the episodes pose."""
    return replace(
        problem,
        recs=problem.recs.take(index),
        begin=problem.begin.take(index),
        plan=problem.plan.take(index),
        score=problem.score.take(index),
        parts=[np.array([i]) for i in range(len(index))],
        library=problem.library.take(index),
        before={name: values[index] for name, values in problem.before.items()},
        raw=problem.raw[index],
        brief=True,
        telling=None,
    )
