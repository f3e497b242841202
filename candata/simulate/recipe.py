"""The recipe of a generated set, checked: what excludes what, which policies can play, which objects take turns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from candata.datasets import put_cloud
from candata.effects import read_effects, read_randomisation
from candata.errors import UsageError
from candata.policies import read_motions, read_step_policy
from candata.scenes import Scene, load_scene
from candata.scenes.clouds import surface_cloud
from candata.scenes.object_folder import named_object
from candata.schema.disturbance import Disturbances
from candata.schema.effect import EffectSetting
from candata.schema.randomisation import RandomEffect
from candata.schema.record import Record
from candata.schema.scene import Noise
from candata.schema.yaml_text import read_yaml
from candata.simulate.jobs import GenerationRecipe, check, policies_with_goal, possible_policies


def make_recipe(
    scene: str,
    model: Scene,
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
    together: tuple[int, int] | None = None,
    noise: bool | Noise = True,
    taxels: bool = False,
    outcomes: Mapping[str, float] | None = None,
) -> GenerationRecipe:
    """Return the recipe of a set.

    Parameters
    ----------
    scene : str
        Name of a scene, or path of a `scene.yaml`.
    model : Scene
        The scene, loaded.
    seed : int
        Seed of all that is random in the set.
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
    together : (int, int), optional
        Fewest and most effects of the randomisation that act at once; else each acts by its own share.
    noise : bool or Noise
        Whether to add the sensor noise that the scene declares, or the noise to add in its place.
    taxels : bool
        Add what the taxels of each fingertip count.
    outcomes : mapping of str to float, optional
        Shares of wanted outcomes, see `candata.simulate.wanted`: grip, aim and timing are drawn until an episode ends
        as its turn wants. Then only policies with a goal play.

    Raises
    ------
    UsageError
        When two of them exclude each other, or a policy has no goal where outcomes are wanted.
    """
    if not np.isfinite(duration_s):
        raise UsageError("the length of the episodes is no number", expected="seconds", found=f"{duration_s:g}")
    recipe = GenerationRecipe(
        scene=scene,
        objects=tuple(objects),
        seed=seed,
        effects=tuple(effects),
        randomisation=tuple(randomisation),
        disturbances=disturbances,
        policies=tuple(policies) or possible_policies(model),
        duration_s=duration_s,
        together=together,
        noise=noise,
        taxels=taxels,
        outcomes=dict(sorted((outcomes or {}).items())),
    )
    if policy_file is not None:
        recipe = _with_file(recipe, model, policy_file, policies)
    if step_policy is not None:
        recipe = _with_step_policy(recipe, step_policy, policies)
    if effects and randomisation:
        raise UsageError("effects and a randomisation at once", fix="write plain numbers into the randomisation")
    return _with_goals(recipe, model, policies) if outcomes else recipe


def check_count(episodes: int, seed: int, workers: int | None) -> None:
    """Refuse counts and seeds that mean nothing.

    Raises
    ------
    UsageError
        When one is too small.
    """
    for name, value, minimum in (("episodes", episodes, 1), ("seed", seed, 0), ("jobs", workers, 1)):
        if value is not None and value < minimum:
            raise UsageError(f"--{name} is too small", expected=f"at least {minimum}", found=str(value))


class SetOptions(TypedDict, total=False):
    """What a set may be made with beside its scene and seed: the parameters of `make_recipe`."""

    objects: Sequence[str]
    effects: Sequence[EffectSetting]
    randomisation: Sequence[RandomEffect]
    disturbances: Disturbances | None
    policies: Sequence[str]
    policy_file: str | Path | None
    step_policy: str | None
    duration_s: float
    together: tuple[int, int] | None
    noise: bool | Noise
    taxels: bool
    outcomes: Mapping[str, float] | None


def _as_list(value: Any) -> Any:
    """Return a word as a list of one."""
    return [value] if isinstance(value, str) else value


Words = Annotated[tuple[str, ...], BeforeValidator(_as_list)]


class SetRecipe(Record):
    """A set to simulate, as the options of `candata generate-sim` and a file of its `--recipe` name it.

    `effects`, `randomise`, `policy_file` and `noise_from` are files; the other options are those of `make_recipe`.
    """

    scene: str
    episodes: int = Field(ge=1)
    seed: int = Field(default=1, ge=0)
    objects: Words = ()
    effects: str | None = None
    randomise: str | None = None
    policies: Words = ()
    policy_file: str | None = None
    duration_s: float = 3.2
    noise: bool = True
    noise_from: str | None = None
    taxels: bool = False
    outcomes: dict[str, float] | None = None

    def options(self) -> SetOptions:
        """Return what the set is made with, its files read.

        Raises
        ------
        UsageError
            When a file is missing or not valid, or noise is left out and named at once.
        """
        if self.noise_from is not None and not self.noise:
            raise UsageError("no noise and a file of noise at once", fix="leave one of them out")
        drawn = None if self.randomise is None else read_randomisation(Path(self.randomise))
        return {
            "objects": self.objects,
            "effects": () if self.effects is None else read_effects(Path(self.effects)).effects,
            "randomisation": () if drawn is None else drawn.effects,
            "together": None if drawn is None else drawn.together,
            "disturbances": None if drawn is None else drawn.disturbances,
            "policies": self.policies,
            "policy_file": self.policy_file,
            "duration_s": self.duration_s,
            "noise": self.noise if self.noise_from is None else read_noise(Path(self.noise_from)),
            "taxels": self.taxels,
            "outcomes": self.outcomes,
        }


def read_noise(path: Path) -> Noise:
    """Return the sensor noise of a file.

    Raises
    ------
    UsageError
        When it is missing or not valid.
    """
    return Noise.parse(read_yaml(path, "the noise file"), path)


@dataclass(frozen=True)
class HeldObject:
    """An object of a set: its name, the digest of the scene that holds it, and points on its surface."""

    name: str
    scene_digest: str
    cloud: NDArray[np.float32]


def checked_objects(recipe: GenerationRecipe, model: Scene, episodes: int) -> tuple[HeldObject, ...]:
    """Return the objects of a set, once it is known that all can be simulated; none of a scene without an object."""
    if not recipe.objects:
        check(recipe, model, range(episodes))
        name = model.file.object
        return () if name is None else (HeldObject(name, model.digest, surface_cloud(model)),)
    names = [named_object(asked_name).name for asked_name in recipe.objects]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise UsageError("an object is named twice", expected="objects of different names", found=", ".join(repeated))
    held_objects = []
    for turn, (name, scene_name) in enumerate(zip(names, recipe.scenes, strict=True)):
        scene = load_scene(scene_name)
        check(recipe, scene, [i for i in range(episodes) if recipe.scene_turn(i) == turn])
        held_objects.append(HeldObject(name, scene.digest, surface_cloud(scene)))
    return tuple(held_objects)


def with_clouds(root: Path, recipe: GenerationRecipe, held_objects: Sequence[HeldObject]) -> GenerationRecipe:
    """Return the recipe with the names of its objects' point clouds, once these are in the dataset."""
    return recipe.model_copy(update={"point_clouds": tuple(put_cloud(root, held.cloud) for held in held_objects)})


def _with_file(recipe: GenerationRecipe, scene: Scene, path: str | Path, policies: Sequence[str]) -> GenerationRecipe:
    """Return the recipe that plays the motions of a file."""
    if policies:
        raise UsageError("policies and a policy file at once", fix="leave one of them out")
    motion_file = read_motions(path, scene)
    names = tuple(m.name for m in motion_file.motions)
    return recipe.model_copy(update={"policies": names, "policy_file": str(path), "policy_digest": motion_file.digest})


def _with_step_policy(recipe: GenerationRecipe, source: str, policies: Sequence[str]) -> GenerationRecipe:
    """Return the recipe whose commands a policy gives in a closed loop."""
    if policies or recipe.policy_file is not None:
        raise UsageError("two sources of commands at once", fix="give --policies, --policy-file or --policy-module")
    step_policy = read_step_policy(source)
    names = {"policies": (step_policy.name,), "step_policy": source, "policy_digest": step_policy.digest}
    return recipe.model_copy(update=names)


def _with_goals(recipe: GenerationRecipe, scene: Scene, policies: Sequence[str]) -> GenerationRecipe:
    """Return the recipe with the policies that have a goal; refuse those that were named and have none."""
    if recipe.policy_file is not None or recipe.step_policy is not None:
        raise UsageError("commands of your own and wanted outcomes at once", fix="leave one of them out")
    names = policies_with_goal(recipe, scene)
    aimless_names = [name for name in policies or recipe.policies if name not in names]
    if aimless_names and (policies or not names):
        every_policy = recipe.model_copy(update={"policies": possible_policies(scene)})
        raise UsageError(
            f"policy {', '.join(aimless_names)} has no goal, so its episodes have no outcome",
            expected=f"policies with a goal: {', '.join(policies_with_goal(every_policy, scene)) or 'there is none'}",
            fix="name others with --policies, or leave --outcomes out",
        )
    return recipe.model_copy(update={"policies": names})
