"""Generated sets: a recipe becomes episodes in a dataset; the same command again adds nothing."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Unpack

from candata.datasets import create_dataset, pending_parts, publish
from candata.datasets.quarantine import read_quarantine
from candata.datasets.versions import DATASET, index_of, newest_version
from candata.errors import UsageError, Where
from candata.scenes import Scene, load_scene
from candata.schema.manifest import Lineage, VersionFile
from candata.schema.quarantine import QuarantinedEpisode
from candata.simulate import seal as seals
from candata.simulate.cluster import crew_of
from candata.simulate.crew import Crew
from candata.simulate.jobs import (
    OPERATION,
    GenerationRecipe,
    chunks,
    episode_id,
    lineage,
    tool_versions,
)
from candata.simulate.pool import ChunkResult, EpisodeChunk, make_chunk, producer
from candata.simulate.recipe import SetOptions, check_count, checked_objects, make_recipe, with_clouds


@dataclass(frozen=True)
class Withheld:
    """Effects to withhold.

    Attributes
    ----------
    asked : str or RandomisationFile
        Name of an effect, or `any`; or a randomisation, of which one draw is the world of the whole set.
    seal : Path
        The sealed file, outside the dataset.
    salt : str, optional
        Secret in hex; random by default.
    """

    asked: seals.Asked
    seal: Path
    salt: str | None = None


def generate(
    out: str | Path,
    scene: str,
    episodes: int,
    seed: int,
    *,
    withheld: Withheld | None = None,
    workers: int | None = None,
    ray: str | None = None,
    shard: tuple[int, int] = (1, 1),
    strict: bool = False,
    progress: Callable[[int], None] = lambda _count: None,
    tally: Callable[[Mapping[str, int]], None] = lambda _counts: None,
    note: Callable[[str], None] = lambda _words: None,
    **options: Unpack[SetOptions],
) -> VersionFile:
    """Return the version that holds the set; bit-identical for a seed whatever the number of workers.

    Chunks that an earlier run wrote are taken as they are, so that a run that was stopped goes on, and a run
    that ended adds nothing. An episode that cannot be made is left out, with its reason in the dataset
    (`candata.datasets.quarantine`).

    Parameters
    ----------
    out : str or Path
        Dataset; made when missing, else added to.
    scene : str
        Name of a scene, or path of a `scene.yaml`.
    episodes, seed : int
        How many, and the seed of all that is random in them.
    withheld : Withheld, optional
        Draw an effect or several, apply them, and keep them out of the dataset.
    workers : int, optional
        Processes; as many as there are cores by default.
    ray : str, optional
        Address of a Ray cluster that does the work instead, see `candata.simulate.cluster.on_ray`.
    shard : (int, int)
        `(i, n)` makes every n-th chunk from the i-th. All n into one dataset, or merged, are the whole set.
    strict : bool
        Raise the error of the first episode that cannot be made.
    progress : callable
        Called with the number of episodes just done.
    tally : callable
        Called with how many episodes that this run made ended with each outcome so far.
    note : callable
        Called with words for people where a run that was stopped goes on.
    **options
        What the set is made with, see `candata.simulate.recipe.make_recipe`.

    Raises
    ------
    UsageError
        When something cannot be simulated, or the dataset holds these ids made in another way.
    SceneError
        When the scene is not sound.
    DataError
        When no episode could be made, none of those that want an outcome got it, or one failed with `strict`.
    SetupError
        When the Ray cluster cannot do the work.
    """
    check_count(episodes, seed, workers)
    chunks_asked = chunks(episodes, shard)
    model = load_scene(scene)
    recipe = make_recipe(scene, model, seed, **options)
    held_objects = checked_objects(recipe, model, episodes)
    if withheld is not None:
        recipe = _with_secret(recipe, model, withheld, Path(out), seed)
        held_objects = checked_objects(recipe, model, episodes)  # what was drawn has to be possible with each object
    digests = {held.name: held.scene_digest for held in held_objects} if recipe.objects else {}
    history = lineage(recipe, model, tool_versions(), digests)
    _refuse_other(Path(out), recipe, episodes, history)
    with crew_of(workers or len(os.sched_getaffinity(0)), ray, Path(out)) as crew:
        root = create_dataset(out, exist_ok=True)
        recipe = with_clouds(root, recipe, held_objects)
        return _complete(root, recipe, chunks_asked, history, crew, strict, progress, tally, note)


def _complete(
    root: Path,
    recipe: GenerationRecipe,
    chunks_asked: Sequence[range],
    history: Lineage,
    crew: Crew,
    strict: bool,
    progress: Callable[[int], None],
    tally: Callable[[Mapping[str, int]], None],
    note: Callable[[str], None],
) -> VersionFile:
    """Make what is missing of the set and publish it."""
    config = str(history.config_digest)
    number_of = {episode_id(recipe, number): number for chunk in chunks_asked for number in chunk}
    present_ids = set(_index(root))
    pending = [p for p in pending_parts(root) if p.producer == producer(config)]
    made_ids = present_ids | {name for part in pending for name, _ in part.episodes}
    done_ids = made_ids if strict else made_ids | read_quarantine(root, config).keys()
    numbers_left = [tuple(n for n in c if episode_id(recipe, n) not in done_ids) for c in chunks_asked]
    chunks_left = [
        EpisodeChunk(str(root.absolute()), recipe.model_dump_json(), config, numbers, strict)
        for numbers in numbers_left
        if numbers
    ]
    done_count = len(number_of) - sum(len(c.numbers) for c in chunks_left)
    if 0 < done_count < len(number_of):
        note(f"going on: {done_count} of {len(number_of)} episodes stand already")
    progress(done_count)
    new_parts = [result.part for result in _made(crew, chunks_left, progress, tally) if result.part]
    left_out = {number_of[e.id]: e for e in read_quarantine(root, config).values() if e.id in number_of}
    left_out = {number: e for number, e in left_out.items() if e.id not in made_ids}
    _refuse_failed(recipe, sorted(number_of.values()), left_out)
    return publish(root, [*(part.id for part in pending), *new_parts], history)


def _made(
    crew: Crew,
    chunks_left: Sequence[EpisodeChunk],
    progress: Callable[[int], None],
    tally: Callable[[Mapping[str, int]], None],
) -> list[ChunkResult]:
    """Return what became of the chunks, in their order, once a crew has made them."""
    results: list[ChunkResult] = []
    counts: Counter[str] = Counter()
    with closing(crew(make_chunk, [astuple(chunk) for chunk in chunks_left])) as stream:
        for result in stream:
            results.append(result)
            counts.update(result.outcomes)
            tally(counts)
            progress(len(result.numbers))
    return sorted(results, key=lambda result: result.numbers)


def _refuse_failed(
    recipe: GenerationRecipe, numbers: Sequence[int], left_out: Mapping[int, QuarantinedEpisode]
) -> None:
    """Raise DataError where every episode was left out, or every one of those that want an outcome."""
    by_outcome: dict[str | None, list[int]] = {}
    for number in numbers:
        by_outcome.setdefault(recipe.wanted(number), []).append(number)
    for wanting_numbers in by_outcome.values():
        if all(number in left_out for number in wanting_numbers):
            raise left_out[wanting_numbers[0]].error


def _with_secret(recipe: GenerationRecipe, scene: Scene, withheld: Withheld, out: Path, seed: int) -> GenerationRecipe:
    """Return the recipe with the drawn effects, its own random stream and its commitment."""
    for is_given, words in ((recipe.effects, "effects"), (recipe.randomisation, "a randomisation")):
        if is_given:
            raise UsageError(f"{words} and a withheld effect at once", fix="leave one of them out")
    names = [withheld.asked] if isinstance(withheld.asked, str) else [effect.name for effect in withheld.asked.effects]
    if recipe.step_policy is not None and {seals.ANY_EFFECT, "clock_drift"} & set(names):
        raise UsageError(
            "a clock that drifts cannot act in a closed loop, and might be drawn",
            expected="other effects by name",
            found=", ".join(names),
            fix="give --withhold NAME",
        )
    if out.resolve() in withheld.seal.resolve().parents:
        raise UsageError("the sealed file would lie in the dataset", where=Where(path=str(withheld.seal)))
    if (out / DATASET).exists() and not withheld.seal.exists():
        raise UsageError(
            "the dataset stands, its sealed file does not",
            expected="the sealed file of the first run",
            where=Where(path=str(withheld.seal)),
            fix="name it with --seal, or choose another --out",
        )
    seal = seals.keep(withheld.seal, scene, withheld.asked, seed, withheld.salt)
    secret = {"seed": seal.stream, "effects": seal.effects, "sealed": seal.sealed}
    return recipe.model_copy(update=secret)


def _index(root: Path) -> dict[str, str]:
    """Return episode id to content hash of the newest version."""
    version = newest_version(root) if (root / DATASET).exists() else None
    return index_of(root, version.parts) if version else {}


def _refuse_other(root: Path, recipe: GenerationRecipe, episodes: int, history: Lineage) -> None:
    """Refuse a dataset that holds one of our ids made from another configuration."""
    present_ids = _index(root)
    taken_id = next((i for n in range(episodes) if (i := episode_id(recipe, n)) in present_ids), None)
    if taken_id is None:
        return
    earlier = [step for step in newest_version(root).lineage if step.operation == OPERATION]  # type: ignore[union-attr]
    if history.config_digest in [step.config_digest for step in earlier]:
        return
    theirs_text, ours_text = _difference(earlier, history)
    raise UsageError(
        "the dataset holds episodes of these ids, made from another configuration",
        expected=theirs_text,
        found=ours_text,
        where=Where(path=str(root), episode=taken_id),
        fix="choose another --seed or another --out",
    )


def _difference(earlier: Sequence[Lineage], lineage: Lineage) -> tuple[str, str]:
    """Return what differs, there and here, from the nearest earlier set."""
    differing_keys = [
        [k for k in dict.fromkeys((*_facts(lineage), *_facts(step))) if _facts(step).get(k) != _facts(lineage).get(k)]
        for step in earlier
    ]
    if not differing_keys:
        return "a dataset of generate-sim", "another producer"
    step, keys = min(zip(earlier, differing_keys, strict=True), key=lambda pair: len(pair[1]))
    texts = [", ".join(f"{k} {_facts(s).get(k)}" for k in keys) for s in (step, lineage)]
    return texts[0], texts[1]


def _facts(step: Lineage) -> dict:
    """Return what a configuration consists of."""
    details = {k: v for k, v in step.details.items() if k != "scene"}
    return {**details, **step.tools, "seeds": step.seeds, "sealed": step.sealed}
