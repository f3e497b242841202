"""The edit test: whether the shrinkage is kept with another object or task in both worlds, nothing refitted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.datasets import Dataset
from candata.errors import DataError, UsageError, Where
from candata.gap.data.noise import sensor_noise
from candata.gap.data.recordings import Recordings, read
from candata.gap.fit.folds import FEWEST
from candata.gap.measure.floor import REPLICAS, floor
from candata.gap.measure.score import Score, score
from candata.gap.replay.effort_unit import with_effort_unit
from candata.gap.replay.replayer import EffectSet, Replayer, replay_all
from candata.gap.replay.residuals import Layout, layout, residual
from candata.gap.replay.starts import Starts, starts
from candata.gap.replay.starts import joined as joined_starts
from candata.gap.run.streams import Streams
from candata.gap.validation.closure import RESAMPLES, gap
from candata.gap.verdict.verdict import EXPLAINED
from candata.scenes import Scene
from candata.schema.effect import EffectSetting
from candata.schema.report import EditTest
from candata.schema.scene import Noise
from candata.simulate.world import build_worlds

Array = NDArray[np.float64]
#: Null replays of each episode where there are more than `MANY`, which are simulated in blocks of at most as many:
#: the mean of many needs fewer of each.
FEW_REPLICAS, MANY = 4, 64
#: Share of what closed in the diagnosis that must close again: what `explained` asks of a whole gap.
KEPT = EXPLAINED
#: Quantile of the mean size of null replays up to which a mismatch may be luck (as `null_level` takes of losses).
LUCK = 0.99


@dataclass(frozen=True)
class Replayed:
    """Recordings replayed without and with a fixed set of effects, none of them fitted here.

    Attributes
    ----------
    recs, begin, plan : Recordings, Starts, Layout
    score : Score
        In units of the floor of the repaired world.
    before, after : dict of str to ndarray
        Readings of the nominal and the repaired simulator.
    size_before, size_after : (E,) float64
        Discrepancy in floors.
    """

    recs: Recordings
    begin: Starts
    plan: Layout
    score: Score
    before: dict[str, Array]
    after: dict[str, Array]
    size_before: Array
    size_after: Array


def replayed(
    replayer: Replayer,
    recs: Recordings,
    world: EffectSet,
    streams: Streams,
    replicas: int,
    noise: Noise | None = None,
) -> Replayed:
    """Return recordings replayed in the nominal scene and in the one with `world` added, measured in its floors.

    The sensors' noise is that of these recordings where none is given.

    No more than `MANY` episodes are simulated at a time: a simulation takes twenty times the memory of its recording.
    """
    blocks = np.array_split(np.arange(len(recs)), -(-len(recs) // MANY))
    return _joined([_replayed(replayer, recs.take(block), world, streams, replicas, noise) for block in blocks], recs)


def _replayed(
    replayer: Replayer,
    recs: Recordings,
    world: EffectSet,
    streams: Streams,
    replicas: int,
    noise: Noise | None,
) -> Replayed:
    """Return one block of recordings replayed without and with `world`."""
    begin = starts(replayer.scene, recs)
    before, after = replay_all(replayer, recs, begin, [(), world])
    plan = layout(replayer.scene, recs, begin, before)
    raw = residual(recs, plan, before)
    noise = noise or sensor_noise(replayer.scene.file.noise, recs, before, replayer.scene.sliding).noise
    rng = streams.of("floor", recs.ids, world)
    level = score(raw, floor(replayer, recs, begin, plan, noise, rng, replicas, world), plan, seed=streams.seed)
    sizes = [level.size(level.normal(r)) for r in (raw, residual(recs, plan, after))]
    return Replayed(recs, begin, plan, level, before, after, sizes[0], sizes[1])


def _joined(blocks: Sequence[Replayed], recs: Recordings) -> Replayed:
    """Return blocks as one."""
    first = blocks[0]

    def joined(parts: Iterable[NDArray], axis: int = 0) -> NDArray:
        return np.concatenate(list(parts), axis=axis)

    return Replayed(
        recs,
        joined_starts([b.begin for b in blocks]),
        replace(first.plan, phase=joined(b.plan.phase for b in blocks)),
        Score(
            sigma=joined(b.score.sigma for b in blocks),
            mask=joined(b.score.mask for b in blocks),
            null=joined((b.score.null for b in blocks), 1),
            floor=joined(b.score.floor for b in blocks),
            null_loss=joined((b.score.null_loss for b in blocks), 1),
            group=first.score.group,
            typical=float(np.mean([b.score.typical for b in blocks])),
        ),
        {n: joined(b.before[n] for b in blocks) for n in first.before},
        {n: joined(b.after[n] for b in blocks) for n in first.after},
        joined(b.size_before for b in blocks),
        joined(b.size_after for b in blocks),
    )


def edit_test(
    dataset: Dataset,
    scene: Scene,
    effects: Sequence[EffectSetting],
    *,
    reference: float = 1.0,
    jobs: int = 1,
    seed: int = 0,
    progress: Callable[[str], None] = lambda stage: None,
) -> EditTest:
    """Return whether effects that were named elsewhere shrink the gap here too, nothing refitted.

    The shrinkage is kept when the 90 % interval of the share closed lies above zero and the share is at least
    `KEPT` of `reference`. Where there was no gap to close, kept is null, unless the effects open one (false).

    Parameters
    ----------
    dataset : Dataset
        Recordings of the same real world with another object or task.
    scene : Scene
        The nominal simulator of that object or task.
    effects : sequence of EffectSetting
        As named by the diagnosis.
    reference : float
        Share that closed in the diagnosis; 1 asks for `KEPT` of the whole gap.
    jobs, seed, progress
        As in `diagnose`.

    Raises
    ------
    DataError
        When the dataset has too few episodes, or does not fit the scene.
    UsageError
        When there are no effects, or one cannot act in the scene.
    """
    if not effects:
        raise UsageError("no effects to test", expected="effects.yaml with at least one effect")
    build_worlds(scene, [effects])
    progress("reading the edited world")
    replayer = Replayer(scene, jobs)
    recs, _ = with_effort_unit(replayer, readable(dataset, scene))
    streams = Streams(seed)
    progress("replaying the edited world")
    replicas = FEW_REPLICAS if len(recs) > MANY else REPLICAS
    found = replayed(replayer, recs, tuple(effects), streams, replicas)
    return _judged(found, f"{dataset.name}@{dataset.digest[:12]}", scene.name, reference, streams)


def readable(dataset: Dataset, scene: Scene) -> Recordings:
    """Return the recordings of an edit test.

    Raises
    ------
    DataError
        When they are too few, or do not fit the scene.
    """
    if len(dataset) < FEWEST:
        raise DataError(
            "too few episodes for the edit test",
            expected=f"at least {FEWEST}",
            found=str(len(dataset)),
            where=Where(path=str(dataset.path)),
        )
    return read(scene, dataset)


def _judged(found: Replayed, dataset: str, scene: str, reference: float, streams: Streams) -> EditTest:
    """Return the numbers of an edit test and whether the shrinkage is kept."""
    ids = found.recs.ids
    level = _luck(found.score, streams.of("luck", ids))
    before, after = found.size_before, found.size_after
    size = gap(before, after, streams.of("gap", ids), gap_left=bool(before.mean() > level))
    if size.closed is None:
        kept = False if after.mean() > max(level, before.mean()) else None
    else:
        kept = bool((size.low or 0.0) > 0 and size.closed >= KEPT * reference)
    return EditTest(
        dataset=dataset,
        scene=scene,
        episodes=len(found.recs),
        before=size.before,
        after=round(float(after.mean()), 4),
        closed=size.closed,
        low=size.low,
        high=size.high,
        kept=kept,
        reference=round(reference, 4),
    )


def _luck(level: Score, rng: np.random.Generator) -> float:
    """Return the mean size in floors that null replays of these episodes reach by luck."""
    sizes = level.size(level.null)
    count = sizes.shape[1]
    picks = rng.integers(len(sizes), size=(RESAMPLES, count))
    return float(np.quantile(sizes[picks, np.arange(count)].mean(1), LUCK))
