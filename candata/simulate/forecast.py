"""What a generated set will take: steps, minutes and gigabytes, from a short trial that leaves nothing."""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from dataclasses import astuple
from pathlib import Path
from typing import Unpack

from candata.datasets import create_dataset
from candata.datasets.parts import RawPart, entry_of
from candata.scenes import load_scene
from candata.scenes.object_folder import named_object
from candata.schema.record import Record
from candata.simulate.jobs import chunks
from candata.simulate.pool import EpisodeChunk, make_chunk
from candata.simulate.recipe import SetOptions, check_count, checked_objects, make_recipe, with_clouds

#: Episodes of the trial, after a first one that compiles the scene: at least, and at most where more policies take
#: turns.
TRIAL, MOST_TRIAL = 4, 8


class Forecast(Record):
    """What a set will take.

    `rows` and `steps` of physics count what is recorded, `minutes` are those of `workers` processes, `tasks` and
    `objects` say how many episodes play each. `trial_episodes` were measured; without any, which then were all left
    out, nothing is known of rows, steps, minutes and gigabytes.
    """

    episodes: int
    tasks: dict[str, int]
    objects: dict[str, int]
    rows: int | None = None
    steps: int | None = None
    minutes: float | None = None
    gigabytes: float | None = None
    workers: int
    trial_episodes: int = 0


def forecast(
    scene: str,
    episodes: int,
    seed: int,
    *,
    workers: int | None = None,
    shard: tuple[int, int] = (1, 1),
    **options: Unpack[SetOptions],
) -> Forecast:
    """Return what `candata.simulate.generate.generate` would take; `options` are those of `make_recipe`.

    Raises
    ------
    UsageError
        When something cannot be simulated.
    SceneError
        When the scene is not sound.
    """
    check_count(episodes, seed, workers)
    numbers = tuple(number for chunk in chunks(episodes, shard) for number in chunk)
    model = load_scene(scene)
    recipe = make_recipe(scene, model, seed, **options)
    held_objects = checked_objects(recipe, model, episodes)
    names = [named_object(name).name for name in recipe.objects] if recipe.objects else [model.file.object]
    processes = workers or len(os.sched_getaffinity(0))
    known = Forecast(
        episodes=len(numbers),
        tasks=Counter(recipe.policies[number % len(recipe.policies)] for number in numbers),
        objects=Counter(name for number in numbers if (name := names[recipe.scene_turn(number)]) is not None),
        workers=processes,
    )
    with tempfile.TemporaryDirectory() as folder:
        root = create_dataset(Path(folder) / "trial")
        text = with_clouds(root, recipe, held_objects).model_dump_json()
        trial_count = min(max(TRIAL, len(recipe.policies)), MOST_TRIAL)
        trial = EpisodeChunk(str(root), text, "trial", numbers[1 : 1 + trial_count] or numbers)
        make_chunk(*astuple(EpisodeChunk(str(root), text, "trial", numbers[:1])))
        begin_s = time.perf_counter()
        part_id = make_chunk(*astuple(trial)).part
        episode_s = (time.perf_counter() - begin_s) / len(trial.numbers)
        if part_id is None:
            return known
        manifest = RawPart(root, entry_of(root, part_id)).manifest()
    count, episode_rows = len(manifest.episodes), manifest.rows / len(manifest.episodes)
    return known.model_copy(
        update={
            "rows": round(episode_rows * len(numbers)),
            "steps": round(episode_rows * len(numbers) * model.substeps),
            "minutes": episode_s * len(numbers) / 60 / min(processes, len(chunks(episodes, shard))),
            "gigabytes": sum(file.bytes for file in manifest.files) / count * len(numbers) / 1e9,
            "trial_episodes": count,
        }
    )
