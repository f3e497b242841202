"""A test bed: recordings of a case, ready to be replayed in any world and scored as the diagnosis scores them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.gap.data.noise import sensor_noise
from candata.gap.data.recordings import Recordings, recordings
from candata.gap.measure.floor import floor
from candata.gap.measure.score import Compact, Score, score
from candata.gap.replay.replayer import EffectSet, Replayer, replay_all
from candata.gap.replay.residuals import Layout, layout, residual
from candata.gap.replay.starts import Starts, starts
from candata.scenes import Scene

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Null replays of each episode: enough for a spread by phase, a quarter of what a diagnosis takes.
REPLICAS = 4


@dataclass(frozen=True)
class Bed:
    """Recordings in a scene, their floor and their score.

    Attributes
    ----------
    replayer, recs, begin, plan, score
        As in a diagnosis.
    """

    replayer: Replayer
    recs: Recordings
    begin: Starts
    plan: Layout
    score: Score

    @property
    def scene(self) -> Scene:
        """The nominal scene."""
        return self.replayer.scene

    def residuals(self, variants: Sequence[EffectSet]) -> list[Compact]:
        """Return normalised residuals `(E, K)` of each effect set, by rollouts."""
        found = replay_all(self.replayer, self.recs, self.begin, variants)
        return [self.score.normal(residual(self.recs, self.plan, r)) for r in found]

    def take(self, index: Index) -> Bed:
        """Return the bed of some episodes."""
        plan = replace(self.plan, phase=self.plan.phase[index])
        return Bed(self.replayer, self.recs.take(index), self.begin.take(index), plan, self.score.take(index))


def make_bed(dataset: Dataset, scene: Scene, rng: np.random.Generator, episodes: int, world: EffectSet = ()) -> Bed:
    """Return the bed of a dataset's first episodes, in units of the floor of a world.

    Parameters
    ----------
    dataset : Dataset
    scene : Scene
        The nominal scene.
    rng : numpy.random.Generator
        Noise of the null replays.
    episodes : int
        How many episodes at most.
    world : tuple of EffectSetting
        The world whose floor it is; the nominal one by default.
    """
    ids = dataset.ids[:episodes]
    recs = recordings(scene, dataset.episodes(ids))
    replayer, begin = Replayer(scene), starts(scene, recs)
    readings = replay_all(replayer, recs, begin, [()])[0]
    plan = layout(scene, recs, begin, readings)
    noise = sensor_noise(scene.file.noise, recs, readings, scene.sliding).noise
    spread = floor(replayer, recs, begin, plan, noise, rng, REPLICAS, world)
    return Bed(replayer, recs, begin, plan, score(residual(recs, plan, readings), spread, plan))
