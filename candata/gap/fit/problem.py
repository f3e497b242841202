"""What a search works on: the problem, and a fitted set of candidates with its held-out evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.noise import NoiseKind
from candata.gap.data.recordings import Recordings
from candata.gap.fit.candidates import Candidate
from candata.gap.fit.fits import Fit, Members
from candata.gap.fit.folds import cross_fit
from candata.gap.fit.response import Curve, Plane
from candata.gap.fit.signatures import Library
from candata.gap.measure.score import Compact, Score
from candata.gap.replay.replayer import EffectSet, Replayer, name_of, needs_simulation, replay_all, sense
from candata.gap.replay.residuals import Layout, residual
from candata.gap.replay.starts import Starts, joined
from candata.gap.run.pace import Pace
from candata.gap.run.streams import Content, Streams
from candata.scenes.traits import is_toss
from candata.schema.scene import Noise

if TYPE_CHECKING:
    from candata.gap.fit.stage import Stage

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Replayed episodes that are kept, the newest ones: of two or three looks in which every effect of a hand is simulated
#: on six, or of 150 worlds on twenty. Record 43.
KEPT = 6000


@dataclass
class SoFar:
    """What a diagnosis has come to know, the newest of each, for an answer should its budget be spent.

    Attributes
    ----------
    step : str
        What is being done, as the user was told.
    recs : Recordings or None
        All that was recorded.
    problem : Problem or None
        What is searched, once the floor is measured.
    first : Stage or None
        Every candidate alone, once all were looked at.
    best : Fit or None
        The set of effects that explains most, in units of its own floor.
    episodes_replayed : int
        Episodes whose replays were asked for, one for each set of effects, whether they were simulated or kept.
    """

    step: str = ""
    recs: Recordings | None = None
    problem: Problem | None = None
    first: Stage | None = None
    best: Fit | None = None
    episodes_replayed: int = 0


@dataclass(frozen=True)
class Problem:
    """What every step of the attribution needs; `before` and `raw` are the nominal replay and its residuals.

    `ruled_out` names effects that other evidence excludes, `measured` what was measured without any fit; `brief` is
    set where only a few of the episodes are looked at, and fewer signatures do; `played` keeps the residuals `(B, D)`
    of episodes from their starts in worlds that were simulated, as some of them are asked for again, alone or among
    others; `simulated` is set where every candidate is simulated on the recording, its signature set aside, and
    `telling` where other episodes are looked at first than usual; `pace` tells how far the search is, and `sofar` keeps
    what it has come to know.
    """

    replayer: Replayer
    recs: Recordings
    begin: Starts
    plan: Layout
    score: Score
    parts: list[Index]
    noise: Noise
    floor_kind: NoiseKind
    streams: Streams
    library: Library
    before: dict[str, Array]
    raw: Array
    ruled_out: frozenset[str] = frozenset()
    measured: Members = ()
    brief: bool = False
    simulated: bool = False
    telling: Index | None = None
    played: dict[tuple[str, tuple[str, bytes]], Array] = field(default_factory=dict)
    pace: Pace = field(default_factory=Pace)
    sofar: SoFar = field(default_factory=SoFar)

    @property
    def plays_all(self) -> bool:
        """Whether every effect is simulated on the recording wherever it is looked at, as on tosses."""
        return self.simulated or is_toss(self.replayer.scene)

    @property
    def nominal(self) -> Compact:
        """Normalised residuals `(E, K)` of the nominal scene."""
        return self.score.normal(self.raw)

    def residuals(self, variants: Sequence[EffectSet]) -> list[Compact]:
        """Return normalised residuals `(E, K)` of each effect set, by rollouts where none is kept."""
        self.sofar.episodes_replayed += len(variants) * len(self.recs)
        return [self.score.normal(z) for z in self._replayed(variants)]

    def _replayed(self, variants: Sequence[EffectSet]) -> list[Array]:
        """Return residuals `(E, B, D)` of all episodes in each effect set, by rollouts of those that are not kept."""
        names, ids = [name_of(some) for some in variants], list(zip(self.recs.ids, self.begin.keys, strict=True))
        kept = {(name, i): self.played[name, i] for name in names for i in ids if (name, i) in self.played}
        missing: dict[tuple[int, ...], dict[str, EffectSet]] = {}
        for name, some in zip(names, variants, strict=True):
            index = tuple(e for e, i in enumerate(ids) if (name, i) not in kept)
            missing.setdefault(index, {})[name] = some
        for index, worlds in missing.items():
            if not index:
                continue
            found = self._simulated(np.array(index), list(worlds.values()))
            new = {(name, ids[e]): z[k] for name, z in zip(worlds, found, strict=True) for k, e in enumerate(index)}
            kept.update(new)
            self.played.update(new)
        for old in list(self.played)[:-KEPT]:
            del self.played[old]
        return [np.stack([kept[name, i] for i in ids]) for name in names]

    def _simulated(self, index: Index, variants: Sequence[EffectSet]) -> list[Array]:
        """Return residuals `(E, B, D)` of some episodes in each effect set, by rollouts."""
        recs, plan = self.recs.take(index), self.plan.take(index)
        played = replay_all(self.replayer, recs, self.begin.take(index), variants)
        return [residual(recs, plan, readings) for readings in played]

    def losses_from(self, begins: Sequence[Starts], variants: Sequence[EffectSet]) -> Array:
        """Return losses `(S, V, E)` of V effect sets that are replayed from S other starts, all stepped together."""
        count = len(self.recs)
        index = np.tile(np.arange(count), len(begins))
        recs, plan = self.recs.take(index), self.plan.take(index)
        begin = joined(begins)
        found = [residual(recs, plan, r) for r in replay_all(self.replayer, recs, begin, variants)]
        each = [[self.score.loss(self.score.normal(z)) for z in np.split(many, len(begins))] for many in found]
        return np.array(each).swapaxes(0, 1)

    def at(self, members: Members) -> Compact:
        """Return normalised residuals `(E, K)` where some effects act."""
        return self.residuals([self.setting(members)])[0]

    def where(self, fit: Fit) -> Compact:
        """Return residuals `(E, K)` where a fit is: a plane was simulated there, a curve perhaps beside it."""
        if isinstance(fit.response, Plane):
            return fit.response.z
        ((_, u),) = fit.members
        return fit.response.read(u) if fit.response.was_simulated(u) else self.at(fit.members)

    def without_each(self, members: Members, some: Members | None = None) -> list[Compact]:
        """Return normalised residuals `(E, K)` of a set without each of its members, or of some; the others stay."""
        left_out = members if some is None else some
        return self.residuals([self.setting([m for m in members if m is not left]) for left in left_out])

    def stream(self, name: str, *content: Content) -> np.random.Generator:
        """Return the random stream of a question about these episodes, by its name and what it is asked of."""
        return self.streams.of(name, self.recs.ids, *content)

    def signatures(self, points: Sequence[tuple[Candidate, Array]]) -> list[Compact]:
        """Return normalised signatures `(E, K)` of candidates at coordinates, alone in the nominal scene.

        What alters forces only as they are read needs no simulation: it is read off the replay of the recording.
        """
        self.sofar.episodes_replayed += len(points) * len(self.recs)
        settings = [self.setting([point]) for point in points]
        kept = iter(self.library.signatures([s for s in settings if needs_simulation(s)], self._replayed))
        return [self.score.normal(next(kept) if needs_simulation(some) else self._sensed(some)) for some in settings]

    def _sensed(self, some: EffectSet) -> Array:
        """Return what sensing effects take off the residuals `(E, B, D)` of the nominal replay."""
        return self.raw - residual(self.recs, self.plan, sense(self.replayer.scene, self.before, some))

    def setting(self, members: Sequence[tuple[Candidate, Array]]) -> EffectSet:
        """Return the effect settings of candidates at coordinates."""
        return tuple(c.setting(u, self.replayer.scene) for c, u in members)


def fit_one(problem: Problem, c: Candidate, response: Curve | Plane, base: Array) -> Fit:
    """Return one candidate's fit on all episodes and its held-out evidence."""
    u = response.fitter(problem.score)(np.arange(len(base)))
    return Fit(((c, u),), response, cross_fit(response, problem.score, problem.parts, base))
