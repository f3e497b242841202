"""Held-out real starts: the states from which recorded test episodes began."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from candata.datasets import Dataset
from candata.errors import DataError, UsageError, Where
from candata.gap.data.recordings import recordings
from candata.gap.replay.starts import starts as estimated_starts
from candata.policy_evaluation.contract import RealStarts
from candata.scenes import Scene
from candata.scenes.traits import is_toss


def real_starts(
    scene: Scene, dataset: Dataset, ids: Sequence[str], most_starts: int, threads: int = 1
) -> tuple[RealStarts, tuple[str, ...]]:
    """Return the starts of recorded episodes, as a diagnosis estimates them, and notes on what was left out.

    Parameters
    ----------
    scene : Scene
        The nominal scene, of the hand and the object that were recorded.
    dataset : Dataset
        The recordings.
    ids : sequence of str
        Held-out episodes.
    most_starts : int
        Starts that are wanted; evenly spread over the ids where there are more.
    threads : int
        Threads of the stepping loop.

    Raises
    ------
    UsageError
        When the scene has no actuators or no object.
    DataError
        When no episode fits the scene, or none begins at rest: a policy takes over a hand that rests.
    """
    if not len(scene.actuator_ids) or scene.object_id is None or is_toss(scene):
        raise UsageError(
            f"no policy can act in scene {scene.name}",
            expected="a scene with actuators and an object",
            where=Where(path=scene.name),
        )
    if not ids:
        raise DataError("no held-out episodes to start from", where=Where(path=str(dataset.path)))
    chosen_ids = [
        ids[k] for k in np.unique(np.linspace(0, len(ids) - 1, min(most_starts, len(ids))).round().astype(int))
    ]
    recs = recordings(scene, dataset.episodes(chosen_ids))
    begin = estimated_starts(scene, recs, threads=threads)
    at_rest = np.flatnonzero(~begin.moving)
    if not len(at_rest):
        raise DataError(
            "all held-out episodes begin in motion",
            expected="starts at rest, from which a policy can take over",
            found=f"{len(recs)} episodes that move in their first rows",
            where=Where(path=str(dataset.path)),
        )
    number = {name: k for k, name in enumerate(dataset.ids)}
    starts = RealStarts(
        recs.ids,
        recs.tasks,
        np.array([number[name] for name in recs.ids], np.int64),
        begin.qpos0,
        begin.qvel0,
        begin.memory0,
    )
    left_out = len(recs) - len(at_rest)
    notes = (f"{left_out} starts in motion were left out: a policy takes over a hand that rests",) if left_out else ()
    return starts.take(at_rest), notes
