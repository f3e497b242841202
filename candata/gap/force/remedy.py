"""The force that mends most of what a world leaves: where it acts, and in which words, decided by playing it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candata.gap.fit.problem import Problem
from candata.gap.force.residual_force import residual_force
from candata.gap.force.stopgap import Stopgap, stopgap
from candata.gap.force.suspects import Suspect, otherwise, pulls, suspects
from candata.gap.measure.floor import null_recordings
from candata.gap.measure.score import Compact
from candata.gap.replay.replayer import EffectSet, replay_all
from candata.gap.replay.starts import starts
from candata.gap.run.pace import FORCE
from candata.gap.screening.episodes import brief, taken

Index = NDArray[np.int64]
#: Episodes that are looked at: enough to describe a force, and what effects that are named leave. Chosen: from twenty,
#: that took 8 and 11 % of two diagnoses.
LOOKED_AT, LEFT_OVER = 24, 12
#: Null replays of each episode.
REPLICAS = 2
#: Suspects that are played in the simulator, if not one of every place alone is more, and the share of the best one's
#: gain that they must have.
PLAYED, NEAR = 3, 0.2
#: Share of the gap that a choice must close more than the plainer one.
MENDS = 0.05
#: Share of the gap that a described force must close beyond what is named, for that to be called unknown. Chosen: the
#: force is fitted with more freedom.
CLEARLY = 0.1
#: Share that it must close for no more names to be looked for. Chosen: of seven causes in no library it closed 0.84
#: to 1 where one name closed 0.21 to 0.83; of sets of two or three that growth did not end at either, 0.73 at most.
NEARLY = 0.8
#: How much less it may close of a few episodes to be played on all. Chosen.
UNSURE = 0.15


class Mended(NamedTuple):
    """What a force mends: the episodes looked at and which these are, whatever stands out there, what mends most."""

    problem: Problem
    which: Index
    suspects: Sequence[Suspect]
    best: Stopgap


@dataclass(frozen=True)
class LoneForce:
    """The force that mends most of the nominal world, each played once, when it is first asked for.

    Attributes
    ----------
    problem : Problem
    """

    problem: Problem

    @cached_property
    def of_few(self) -> Mended | None:
        """That of a few episodes."""
        return self._played(brief(self.problem)[0])

    @cached_property
    def of_all(self) -> Mended | None:
        """That of all episodes."""
        few = brief(self.problem)[0]
        return self.of_few if few is self.problem else self._played(self.problem)

    def _played(self, problem: Problem) -> Mended | None:
        """Return the force that mends most of some episodes."""
        problem.pace.say("trying one force in place of more effects", FORCE)
        return mended(problem, ())


@dataclass(frozen=True)
class Doubt:
    """Whether one force explains clearly more than what is named: then the cause is no sum of names.

    The answer depends on what is asked, not on what was asked before.

    Attributes
    ----------
    lone : LoneForce
        Played on few episodes first, and on more only if it closes much of these.
    named : float
        Share of the gap that sets which were named before close: a force must close more than these, too.
    """

    lone: LoneForce
    named: float = 0.0

    def of(self, problem: Problem, here: Compact) -> Mended | None:
        """Return the force that closes nearly all of the gap, and clearly more than what leaves residuals `(E, K)`.

        None where it does not. A correction of what fingertips read is no force: several faults of theirs add up to
        one.
        """
        named = self.beyond(problem, here).named
        if named + CLEARLY >= 1 or not self.may_close(NEARLY) or not _acts(self.lone.of_few):
            return None
        force = self.lone.of_all
        if force is None or not _acts(force) or force.best.closed < NEARLY:
            return None
        return force if force.best.closed > named + CLEARLY else None

    def beyond(self, problem: Problem, here: Compact) -> Doubt:
        """Return the same doubt, once what leaves residuals `here (E, K)` is named too."""
        return replace(self, named=max(self.named, self._closed(problem, here)))

    def may_close(self, share: float) -> bool:
        """Tell whether what mends most of a few episodes closes a share of the gap there, or nearly."""
        few = self.lone.of_few
        return few is not None and few.best.closed >= share - UNSURE

    def _closed(self, problem: Problem, here: Compact) -> float:
        """Return the share of the gap that a world closes, in the floors that the force is judged by."""
        score = self.lone.problem.score
        units = problem.score.sigma / np.where(score.mask, score.sigma, 1)
        own = [(z * units).astype(np.float32) for z in (problem.nominal, here)]
        before, after = (float(score.size(z).mean()) - 1 for z in own)
        return float(np.clip(1 - after / max(before, 1e-6), -1, 1))


def _acts(force: Mended | None) -> bool:
    """Tell whether what mends most is a force, not a correction of what fingertips read."""
    return force is not None and force.best.suspects[0].place != "fingertip"


def mended(problem: Problem, world: EffectSet) -> Mended | None:
    """Return the force that mends most of what a world leaves; None where none stands out.

    Parameters
    ----------
    problem : Problem
        Episodes, folds, and the score in units of the world's floor.
    world : tuple of EffectSetting
        What the simulator holds already: nothing, or the effects that are named.
    """
    some, index = _some(problem, LEFT_OVER if world else LOOKED_AT)
    found, drawn = _standing_out(some, world)
    if not found:
        return None
    play = partial(stopgap, some, world, replay_all(some.replayer, some.recs, some.begin, [world])[0])
    half = np.sort(np.concatenate([fold[::2] for fold in some.parts]))
    best = _best(partial(play, index=half), found, some.parts)
    if best.closed + MENDS <= 1:  # else nothing can close clearly more
        best = _clearest([best, *(play([pull], index=half) for pull in drawn)])
    return Mended(some, index, found, best if len(half) == len(some.recs) else play(best.suspects))


def _best(play: Callable[[Sequence[Suspect]], Stopgap], found: Sequence[Suspect], parts: list[Index]) -> Stopgap:
    """Return the suspect whose force mends most, or it and all of its kind, in the words that mend most.

    How much a force mends also depends on how chaotic what it acts on is, so the more telling suspect, the single one
    and the plainer description stay unless another closes more by `MENDS`. (Each of two fading motors closes 10 % of
    the gap, and a correction of one fingertip's reading 16 %; both motors together close 83 %.) The first of every
    place is played: a cause shows where it does not act, too. (Behind three fingertips' readings, each worth 5 %, came
    the wind on what they held: 97 %.)
    """
    near = [s for s in found if s.gain >= NEAR * found[0].gain]
    kinds: dict[str, list[Suspect]] = {}
    for s in near:
        kinds.setdefault(s.place, []).append(s)
    front = sorted(near, key=lambda s: s is not kinds[s.place][0])[: max(PLAYED, len(kinds))]
    first = _clearest([play([s]) for s in front])
    best = _clearest([first, *(play(kin) for kin in kinds.values() if len(kin) > 1)])
    if len(best.suspects) > 1 or best.closed + MENDS > 1:
        return best
    others = otherwise(best.suspects[0], parts)[:PLAYED]
    return _clearest([best, *(play([s]) for s in others)])


def _clearest(played: Sequence[Stopgap]) -> Stopgap:
    """Return what closes most, or the first where that closes less than `MENDS` more."""
    best = max(played, key=lambda s: s.closed)
    return best if best.closed >= played[0].closed + MENDS else played[0]


def _some(problem: Problem, most: int = LOOKED_AT) -> tuple[Problem, Index]:
    """Return the problem on the episodes that are looked at, as many of each fold, and which they are."""
    if len(problem.recs) <= most:
        return problem, np.arange(len(problem.recs))
    each = max(most // len(problem.parts), 1)
    index = np.sort(np.concatenate([p[:each] for p in problem.parts]))
    parts = [np.searchsorted(index, p[:each]) for p in problem.parts]
    return replace(taken(problem, index), parts=parts), index


def _standing_out(problem: Problem, world: EffectSet) -> tuple[list[Suspect], list[Suspect]]:
    """Return the suspects whose residual force is described better than any in null replays, and the support's pulls.

    The suspects come best first. Of the pulls no residual force tells: they are played, whatever stands out.
    """
    scene, count = problem.replayer.scene, len(problem.recs)
    real = residual_force(problem.replayer, problem.recs, problem.begin, world)
    rng = problem.stream("nulls beside a force", world)
    nulls = null_recordings(problem.replayer, problem.recs, problem.begin, problem.noise, rng, REPLICAS, world)
    null = residual_force(problem.replayer, nulls, starts(scene, nulls, np.tile(problem.begin.moving, REPLICAS)), world)
    found = suspects(scene, real, null, problem.parts)
    own = [
        _gain(suspects(scene, null.take(np.arange(r * count, (r + 1) * count)), null, problem.parts))
        for r in range(REPLICAS)
    ]
    return [s for s in found if s.gain > max(own)], [pull for s in found for pull in pulls(scene, s)]


def _gain(found: Sequence[Suspect]) -> float:
    """Return the largest gain."""
    return max((s.gain for s in found), default=0.0)
