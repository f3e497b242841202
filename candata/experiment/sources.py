"""The sets of an experiment: simulated ones, worlds that stand in for the real one, and parts of real sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from candata.datasets import Dataset, append, open_dataset, put_cloud
from candata.datasets.deriving import new_dataset
from candata.datasets.filtering import chosen_dataset
from candata.datasets.history import derived_lineage
from candata.datasets.versions import DATASET
from candata.effects import read_randomisation
from candata.errors import DataError, UsageError, Where
from candata.experiment.config import SealedWorld
from candata.gap.blind.cases import hidden_world
from candata.gap.blind.draws import background, draw_outside
from candata.loaders import find_split, make_split, save_split
from candata.loaders.splits import DEFAULT
from candata.scenes import Scene, load_scene
from candata.scenes.clouds import surface_cloud
from candata.schema.bench import Label, LabelsFile
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json, read_json
from candata.schema.manifest import Lineage
from candata.schema.randomisation import RandomEffect
from candata.simulate import open_seal
from candata.simulate.episodes import EpisodeJob
from candata.simulate.generate import Withheld, generate
from candata.simulate.jobs import possible_policies
from candata.simulate.recipe import SetOptions, SetRecipe, read_noise
from candata.simulate.seal import canonical, commitment, new_salt, secret_number, write_once

#: Shares of a set that is trained on: no part of it is for testing, which is done on real episodes.
TRAINED_ON: Mapping[str, float] = {"train": 0.9, "val": 0.1}
#: Name of the one label of a world with an outside cause, or with everything a little wrong.
_CASE_NAME = "world"


def repaired_options(recipe: SetRecipe, repair: tuple[EffectSetting, ...] = ()) -> SetOptions:
    """Return what a set is made with; a repair is part of its simulator.

    An effect that is drawn for each episode keeps its draw unless the repair says what it is.

    Raises
    ------
    UsageError
        When a file is not valid, or the randomisation says how many effects act together.
    """
    options = recipe.options()
    if recipe.randomise is None:
        return options | {"effects": (*options["effects"], *repair)}
    repaired = {(setting.name, setting.element) for setting in repair}
    kept = tuple(each for each in options["randomisation"] if (each.name, each.element) not in repaired)
    fixed = tuple(RandomEffect(name=s.name, element=s.element, parameters={**s.parameters}) for s in repair)
    if fixed and options["together"] is not None:
        raise UsageError(
            "a repair acts always, and the randomisation says how many effects act together",
            where=Where(path=recipe.randomise),
            fix="give shares to its effects instead of `together`",
        )
    return options | {"randomisation": (*fixed, *kept)}


def make_simulated(
    root: Path,
    recipe: SetRecipe,
    repair: tuple[EffectSetting, ...],
    jobs: int,
    ray: str | None,
    progress: Callable[[int], None],
) -> Dataset:
    """Return a simulated set, gone on with where it stands in part, with a split for training.

    Raises
    ------
    CandataError
        As `candata.simulate.generate.generate`.
    """
    generate(
        root,
        recipe.scene,
        recipe.episodes,
        recipe.seed,
        workers=jobs,
        ray=ray,
        progress=progress,
        **repaired_options(recipe, repair),
    )
    return _with_split(open_dataset(root))


def make_sealed(
    root: Path, world: SealedWorld, seal: Path, jobs: int, ray: str | None, progress: Callable[[int], None]
) -> Dataset:
    """Return the recordings of a world whose difference from the scene is sealed: those to train on come first.

    Parameters
    ----------
    root : Path
        Where the set goes.
    world : SealedWorld
        What differs.
    seal : Path
        The sealed file; made when missing, and used again for another set of the same world.
    jobs, ray, progress
        As for `candata.simulate.generate.generate`.

    Raises
    ------
    CandataError
        As `generate`; also when the seal is of another world.
    """
    scene = load_scene(world.scene)
    noise = None if world.noise_from is None else read_noise(Path(world.noise_from))
    episodes = world.train + world.test
    seal.parent.mkdir(parents=True, exist_ok=True)
    if world.hidden is None:
        # What is 5 % off, or where an outside cause sits, is of one scene.
        asked: dict[str, str | int | float] = {"cause": world.outside or "all_wrong", "seed": world.seed}
        asked |= {"scene": scene.digest}
        sensed = scene if noise is None else replace(scene, file=scene.file.model_copy(update={"noise": noise}))
        return _case(root, sensed, world, seal, asked)
    withheld = Withheld(read_randomisation(Path(world.hidden)), seal)
    options: SetOptions = {"objects": world.objects, "policies": world.policies, "duration_s": world.duration_s}
    options |= {"noise": noise or True}
    generate(
        root, world.scene, episodes, world.seed, withheld=withheld, workers=jobs, ray=ray, progress=progress, **options
    )
    return open_dataset(root)


def _case(root: Path, scene: Scene, world: SealedWorld, seal: Path, asked: dict[str, str | int | float]) -> Dataset:
    """Return recordings of a world with an outside cause, or in which everything is a little wrong; made at once."""
    if not seal.exists():
        salt = new_salt()
        label = _drawn_label(scene, world, np.random.default_rng(secret_number(world.seed, salt, "experiment")))
        write_once(seal, LabelsFile(salt=salt, asked=asked, labels={_CASE_NAME: canonical(label)}))
    labels = LabelsFile.parse(read_json(seal), seal)
    if labels.asked != asked:
        raise UsageError(
            "the seal is of another world",
            expected=str(asked),
            found=str(labels.asked),
            where=Where(path=str(seal)),
            fix="give the world another name, or choose another --out",
        )
    if not (root / DATASET).exists():
        text = labels.labels[_CASE_NAME]
        label, policies = Label.parse(parse_json(text), seal), possible_policies(scene)
        with new_dataset(root) as draft:
            cloud = put_cloud(draft, surface_cloud(scene))
            plans = [
                EpisodeJob(
                    id=f"withheld-{i:06d}",
                    index=i,
                    policy=policies[i % len(policies)],
                    seed=world.seed,
                    effects=label.effects,
                    hidden=True,
                    point_cloud=cloud,
                    noise_seed=label.seed,
                )
                for i in range(world.train + world.test)
            ]
            made = hidden_world(scene, label, plans, world.duration_s)
            append(draft, made, Lineage(operation="sealed world", sealed=commitment(text, labels.salt)))
    return open_dataset(root)


def _drawn_label(scene: Scene, world: SealedWorld, rng: np.random.Generator) -> Label:
    """Return the truth of a world with an outside cause, or in which everything is a little wrong."""
    if world.outside is not None:
        label = Label(case=_CASE_NAME, kind="outside", outside=draw_outside(world.outside, scene, rng))
    else:
        label = Label(case=_CASE_NAME, kind="background", effects=background(scene, rng, ""))
    return label.model_copy(update={"seed": int(rng.integers(2**62))})


def opened_effects(seal: Path, dataset: Dataset) -> tuple[EffectSetting, ...] | None:
    """Return the effects that were sealed; None where what differs is no effect of the library.

    Raises
    ------
    CandataError
        When the seal is missing, damaged, or of another set.
    """
    value = read_json(seal)
    if not isinstance(value, dict) or "labels" not in value:
        return open_seal(seal, dataset)
    labels = LabelsFile.parse(value, seal)
    text = labels.labels[_CASE_NAME]
    if commitment(text, labels.salt) not in {step.sealed for step in dataset.lineage}:
        raise DataError("the seal does not fit the dataset", where=Where(path=str(seal)))
    label = Label.parse(parse_json(text), seal)
    return None if label.outside is not None else label.effects


def make_part(root: Path, dataset: Dataset, settings: dict[str, Any], cloud_of: str | None = None) -> Dataset:
    """Return the test part of a real set, or so many of its training episodes, as a dataset of its own.

    Parameters
    ----------
    root : Path
        Where it goes; what stands there is whole.
    dataset : Dataset
        The real set.
    settings : dict
        `part` (`test`, `train-all`, `train-30`); `train`, how many come first of a set that was made for this, or
        `split`, the name of a stored split (null: the default one).
    cloud_of : str, optional
        Scene whose object's surface the episodes get as point cloud; those that have one keep it.

    Raises
    ------
    DataError
        When there are fewer training episodes than are asked for, or none are left.
    """
    if not (root / DATASET).exists():
        copy_episodes(root, dataset, part_ids(dataset, settings), {"part": settings["part"]}, cloud_of)
    return _with_split(open_dataset(root), {"test": 1.0} if settings["part"] == "test" else TRAINED_ON)


def copy_episodes(
    root: Path, dataset: Dataset, ids: Sequence[str], details: dict[str, Any], cloud_of: str | None = None
) -> None:
    """Write a new dataset of some episodes.

    Parameters
    ----------
    root : Path
        Where it goes.
    dataset : Dataset
        Version that holds them.
    ids : sequence of str
        Episodes.
    details : dict
        Why these, for the lineage.
    cloud_of : str, optional
        As for `make_part`.
    """
    if cloud_of is None:
        chosen_dataset(dataset, ids, root, details)
        return
    points = surface_cloud(load_scene(cloud_of))
    with new_dataset(root) as draft:
        cloud = put_cloud(draft, points)
        copies = (
            replace(episode, meta=episode.meta.model_copy(update={"point_cloud": episode.meta.point_cloud or cloud}))
            for episode in dataset.episodes(ids)
        )
        append(draft, copies, derived_lineage("filter", [dataset], details))


def part_ids(dataset: Dataset, settings: dict[str, Any]) -> Sequence[str]:
    """Return the ids of a part (`settings` as of `make_part`), training episodes in the order of their ids.

    Raises
    ------
    DataError
        When there are fewer training episodes than are asked for.
    """
    if "train" in settings:
        ids = sorted(dataset.ids)
        train, test = ids[: settings["train"]], ids[settings["train"] :]
    else:
        split = find_split(dataset, settings["split"])
        train, test = sorted((*split.train, *split.val)), sorted(split.test)
    word = str(settings["part"]).removeprefix("train-")
    if word == "test":
        return test
    count = len(train) if word == "all" else int(word)
    if count > len(train):
        raise DataError(
            "too few real training episodes",
            expected=f"{count}, as real_counts says",
            found=str(len(train)),
            where=Where(path=str(dataset.path)),
            fix="record more, or ask for fewer",
        )
    return train[:count]


def _with_split(dataset: Dataset, shares: Mapping[str, float] = TRAINED_ON) -> Dataset:
    """Return the dataset with a default split of these shares; a single episode is all of the first group."""
    save_split(dataset, make_split(dataset, shares if len(dataset) > 1 else {next(iter(shares)): 1.0}), DEFAULT)
    return dataset
