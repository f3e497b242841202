"""Generated sets: a recipe becomes episodes in a dataset; the same command again adds nothing."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.datasets import create_dataset, pending_parts, publish, put_cloud
from candata.datasets.versions import DATASET, index_of, newest_version
from candata.errors import UsageError, Where
from candata.policies import read_motions, read_step_policy
from candata.scenes import Scene, load_scene
from candata.scenes.clouds import surface_cloud
from candata.scenes.object_folder import named_object
from candata.schema.disturbance import Disturbances
from candata.schema.effect import EffectSetting
from candata.schema.manifest import Lineage, VersionFile
from candata.schema.randomisation import RandomEffect
from candata.simulate import seal as seals
from candata.simulate.jobs import (
    OPERATION,
    GenerationRecipe,
    check,
    chunks,
    episode_id,
    lineage,
    possible_policies,
    tool_versions,
)
from candata.simulate.pool import EpisodeChunk, producer, run_chunks


@dataclass(frozen=True)
class Withheld:
    """Effects to withhold.

    Attributes
    ----------
    asked : str or tuple of RandomEffect
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
    objects: Sequence[str] = (),
    effects: Sequence[EffectSetting] = (),
    randomisation: Sequence[RandomEffect] = (),
    disturbances: Disturbances | None = None,
    policies: Sequence[str] = (),
    policy_file: str | Path | None = None,
    step_policy: str | None = None,
    duration_s: float = 3.2,
    noise: bool = True,
    withheld: Withheld | None = None,
    workers: int | None = None,
    progress: Callable[[int], None] = lambda _count: None,
    note: Callable[[str], None] = lambda _words: None,
) -> VersionFile:
    """Return the version that holds the set; bit-identical for a seed whatever the number of workers.

    Chunks that an earlier run wrote are taken as they are, so that a run that was stopped goes on, and a run
    that ended adds nothing.

    Parameters
    ----------
    out : str or Path
        Dataset; made when missing, else added to.
    scene : str
        Name of a scene, or path of a `scene.yaml`.
    episodes, seed : int
        How many, and the seed of all that is random in them.
    objects : sequence of str
        Objects that take turns in the place of the scene's own, each for one round of the motions: registered names, or
        folders. An episode then names its object, and `labels` its scene's digest.
    effects : sequence of EffectSetting
        Effects of every episode.
    randomisation : sequence of RandomEffect
        Effects drawn for each episode, from the seed and its number; each episode's `meta.effects` has its draw.
    disturbances : Disturbances, optional
        Noise on commands, and kicks, drawn for each episode; `meta.kicks` has those that it got.
    policies : sequence of str
        Motions, which take turns; the scene's own by default.
    policy_file : str or Path, optional
        Motions as commands, which take turns instead: a Parquet file such as a diagnosis proposes.
    step_policy : str, optional
        What gives the commands in a closed loop instead: `package.module:function`, `FILE.py:function` or a network.
    duration_s : float
        Length of an episode; what a policy file holds has its own.
    noise : bool
        Add the sensor noise that the scene declares.
    withheld : Withheld, optional
        Draw an effect or several, apply them, and keep them out of the dataset.
    workers : int, optional
        Processes; as many as there are cores by default.
    progress : callable
        Called with the number of episodes just done.
    note : callable
        Called with words for people where a run that was stopped goes on.

    Raises
    ------
    UsageError
        When something cannot be simulated, or the dataset holds these ids made in another way.
    SceneError
        When the scene is not sound.
    """
    model = load_scene(scene)
    _check_count(episodes, seed, workers)
    recipe = GenerationRecipe(
        scene=scene,
        objects=tuple(objects),
        seed=seed,
        effects=tuple(effects),
        randomisation=tuple(randomisation),
        disturbances=disturbances,
        policies=tuple(policies) or possible_policies(model),
        duration_s=duration_s,
        noise=noise,
    )
    if policy_file is not None:
        recipe = _with_file(recipe, model, policy_file, policies)
    if step_policy is not None:
        if policies or policy_file is not None:
            raise UsageError("two sources of commands at once", fix="give --policies, --policy-file or --policy-module")
        source = read_step_policy(step_policy)
        names = {"policies": (source.name,), "step_policy": step_policy, "policy_digest": source.digest}
        recipe = recipe.model_copy(update=names)
    if effects and randomisation:
        raise UsageError("effects and a randomisation at once", fix="write plain numbers into the randomisation")
    held_objects = _held_objects(recipe, model, episodes)
    if withheld is not None:
        recipe = _with_secret(recipe, model, withheld, Path(out), seed)
    digests = {held.name: held.scene_digest for held in held_objects} if recipe.objects else {}
    history = lineage(recipe, model, tool_versions(), digests)
    _refuse_other(Path(out), recipe, episodes, history)
    root = create_dataset(out, exist_ok=True)
    recipe = recipe.model_copy(update={"point_clouds": tuple(put_cloud(root, held.cloud) for held in held_objects)})
    return _complete(root, recipe, episodes, history, workers, progress, note)


@dataclass(frozen=True)
class _HeldObject:
    """An object of a set: its name, the digest of the scene that holds it, and points on its surface."""

    name: str
    scene_digest: str
    cloud: NDArray[np.float32]


def _held_objects(recipe: GenerationRecipe, model: Scene, episodes: int) -> tuple[_HeldObject, ...]:
    """Return the objects of a set, once it is known that all can be simulated; none of a scene without an object."""
    if not recipe.objects:
        check(recipe, model, range(episodes))
        name = model.file.object
        return () if name is None else (_HeldObject(name, model.digest, surface_cloud(model)),)
    names = [named_object(asked_name).name for asked_name in recipe.objects]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise UsageError("an object is named twice", expected="objects of different names", found=", ".join(repeated))
    held_objects = []
    for turn, (name, scene_name) in enumerate(zip(names, recipe.scenes, strict=True)):
        scene = load_scene(scene_name)
        check(recipe, scene, [i for i in range(episodes) if recipe.scene_turn(i) == turn])
        held_objects.append(_HeldObject(name, scene.digest, surface_cloud(scene)))
    return tuple(held_objects)


def _complete(
    root: Path,
    recipe: GenerationRecipe,
    episodes: int,
    history: Lineage,
    workers: int | None,
    progress: Callable[[int], None],
    note: Callable[[str], None],
) -> VersionFile:
    """Make what is missing of the set and publish it."""
    present_ids = set(_index(root))
    config = str(history.config_digest)
    pending = [p for p in pending_parts(root) if p.producer == producer(config)]
    done_ids = present_ids | {name for part in pending for name, _ in part.episodes}
    numbers_left = [tuple(n for n in c if episode_id(recipe, n) not in done_ids) for c in chunks(episodes)]
    chunks_left = [
        EpisodeChunk(str(root), recipe.model_dump_json(), config, numbers) for numbers in numbers_left if numbers
    ]
    done_count = episodes - sum(len(c.numbers) for c in chunks_left)
    if 0 < done_count < episodes:
        note(f"going on: {done_count} of {episodes} episodes stand already")
    progress(done_count)
    new_parts = run_chunks(chunks_left, workers or len(os.sched_getaffinity(0)), progress)
    return publish(root, [*(part.id for part in pending), *new_parts], history)


def _with_file(recipe: GenerationRecipe, scene: Scene, path: str | Path, policies: Sequence[str]) -> GenerationRecipe:
    """Return the recipe that plays the motions of a file."""
    if policies:
        raise UsageError("policies and a policy file at once", fix="leave one of them out")
    motion_file = read_motions(path, scene)
    names = tuple(m.name for m in motion_file.motions)
    return recipe.model_copy(update={"policies": names, "policy_file": str(path), "policy_digest": motion_file.digest})


def _with_secret(recipe: GenerationRecipe, scene: Scene, withheld: Withheld, out: Path, seed: int) -> GenerationRecipe:
    """Return the recipe with the drawn effects, its own random stream and its commitment."""
    for is_given, words in (
        (recipe.effects, "effects"),
        (recipe.randomisation, "a randomisation"),
        (recipe.objects, "several objects"),
    ):
        if is_given:
            raise UsageError(f"{words} and a withheld effect at once", fix="leave one of them out")
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


def _check_count(episodes: int, seed: int, workers: int | None) -> None:
    """Refuse counts and seeds that mean nothing."""
    for name, value, minimum in (("episodes", episodes, 1), ("seed", seed, 0), ("jobs", workers, 1)):
        if value is not None and value < minimum:
            raise UsageError(f"--{name} is too small", expected=f"at least {minimum}", found=str(value))


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
    differing_keys = [[k for k, v in _facts(lineage).items() if _facts(step).get(k) != v] for step in earlier]
    if not differing_keys:
        return "a dataset of generate-sim", "another producer"
    step, keys = min(zip(earlier, differing_keys, strict=True), key=lambda pair: len(pair[1]))
    texts = [", ".join(f"{k} {_facts(s).get(k)}" for k in keys) for s in (step, lineage)]
    return texts[0], texts[1]


def _facts(step: Lineage) -> dict:
    """Return what a configuration consists of."""
    details = {k: v for k, v in step.details.items() if k != "scene"}
    return {**details, **step.tools, "seeds": step.seeds, "sealed": step.sealed}
