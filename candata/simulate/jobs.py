"""The job plan of a generated set: what an episode is called and made of, in chunks of a fixed size."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
from pydantic import Field

from candata import __version__
from candata.errors import DataError, UsageError, Where
from candata.policies import Motion, StepPolicy, policy, policy_names, read_motions, read_step_policy
from candata.scenes import Scene
from candata.scenes.assemble import OBJECT_MARK
from candata.scenes.object_folder import named_object
from candata.schema.disturbance import Disturbances
from candata.schema.effect import EffectSetting
from candata.schema.manifest import Lineage
from candata.schema.randomisation import RandomEffect
from candata.schema.record import Record
from candata.schema.scene import Noise
from candata.simulate.disturbances import check_disturbances
from candata.simulate.episodes import EpisodeJob, planned
from candata.simulate.randomisation import check_randomisation, drawn_effects
from candata.simulate.wanted import wanted_outcome
from candata.simulate.world import build_worlds

#: Episodes a chunk, and a part: fixed, so that who makes a chunk changes nothing in it.
CHUNK = 16
OPERATION = "generate-sim"


class GenerationRecipe(Record):
    """What a set is made from; plain values, so that any process can be told.

    `scene` is what `load_scene` takes; `seed` feeds the episodes' random streams; `sealed` is null for a set
    whose effects everybody may know, else the commitment of a withheld one. `effects` act in every episode, those of
    `randomisation` are drawn for each. With a `policy_file` (its content named by `policy_digest`) the motions of the
    file take turns, and `policies` are their names. `objects` are what `named_object` takes; they take turns in the
    place of the scene's own, each for one round of the policies. `point_clouds` has one name for each of `scenes`;
    nothing where the scene has no object. With a `step_policy` (what `read_step_policy` takes, its content named by
    `policy_digest`) that gives the commands of all episodes, and `policies` is its name. `disturbances` are drawn for
    each episode.
    `outcomes` are the shares of wanted outcomes; none where any will do. `together` is how many effects of the
    randomisation act at once. `noise` says whether the scene's sensor noise is added, or which noise in its place.
    """

    scene: str
    seed: int
    effects: tuple[EffectSetting, ...] = ()
    randomisation: tuple[RandomEffect, ...] = ()
    disturbances: Disturbances | None = None
    policies: tuple[str, ...]
    policy_file: str | None = None
    step_policy: str | None = None
    policy_digest: str | None = None
    duration_s: float
    noise: bool | Noise
    taxels: bool = False
    objects: tuple[str, ...] = ()
    point_clouds: tuple[str, ...] = ()
    outcomes: dict[str, float] = Field(default_factory=dict)
    together: tuple[int, int] | None = Field(default=None, exclude_if=lambda value: value is None)
    sealed: str | None = None

    @property
    def scenes(self) -> tuple[str, ...]:
        """What `load_scene` takes for the scene with each of the objects; the scene alone without any."""
        return tuple(f"{self.scene}{OBJECT_MARK}{name}" for name in self.objects) or (self.scene,)

    def scene_turn(self, index: int) -> int:
        """Return which of `scenes` episode `index` plays in."""
        return index // len(self.policies) % len(self.scenes)

    def wanted(self, index: int) -> str | None:
        """Return the outcome that is wanted of episode `index`, by turns that no policy or object runs in step with."""
        if not self.outcomes:
            return None
        pairs = len(self.policies) * len(self.scenes)
        return wanted_outcome(self.outcomes, index // pairs + index % pairs)


def check(recipe: GenerationRecipe, scene: Scene, indices: Sequence[int] = ()) -> None:
    """Refuse what cannot be simulated in `scene`.

    Parameters
    ----------
    recipe : GenerationRecipe
    scene : Scene
    indices : sequence of int
        Episodes that play there: their effects are drawn, as a worker will draw them.

    Raises
    ------
    UsageError
        When a policy or an effect cannot act in the scene, or an episode would have fewer than 2 rows.
    """
    for name in () if recipe.policy_file or recipe.step_policy else recipe.policies:
        if not policy(name).possible(scene):
            raise UsageError(
                f"policy {name} cannot act in scene {scene.name}",
                expected=f"one of {', '.join(possible_policies(scene)) or '(none)'}",
                found=name,
            )
    if not recipe.policies:
        raise UsageError(f"no policy can act in scene {scene.name}", fix="add actuators or an object")
    if recipe.duration_s * scene.file.rate_hz < 2:
        raise UsageError(
            "the episodes are too short",
            expected=f"at least {2 / scene.file.rate_hz:g} s",
            found=f"{recipe.duration_s:g} s",
            fix="give a longer --duration-s",
        )
    build_worlds(scene, [recipe.effects])
    check_randomisation(recipe.randomisation, scene)
    if recipe.disturbances is not None:
        check_disturbances(recipe.disturbances, scene)
    if recipe.taxels and not scene.file.fingertips:
        raise UsageError(f"scene {scene.name} has no fingertips, so no taxels", fix="leave --taxels out")
    if recipe.step_policy is not None:
        _check_step_policy(recipe, scene)
    for index in indices if recipe.randomisation else ():
        _drawn_effects(recipe, scene, index)


def _drawn_effects(recipe: GenerationRecipe, scene: Scene, index: int) -> tuple[EffectSetting, ...]:
    """Return the effects of the randomisation that act in an episode."""
    return drawn_effects(recipe.randomisation, scene, recipe.seed, index, recipe.together)


def _check_step_policy(recipe: GenerationRecipe, scene: Scene) -> None:
    """Refuse a closed loop without actuators, under a clock that drifts, or whose policy does not begin."""
    if not len(scene.actuator_ids):
        raise UsageError(f"scene {scene.name} has no actuators to command")
    names = {*(effect.name for effect in recipe.effects), *(effect.name for effect in recipe.randomisation)}
    if "clock_drift" in names:
        raise UsageError("a clock that drifts cannot act in a closed loop", fix="leave clock_drift out")
    read_step_policy(str(recipe.step_policy)).begin(scene, np.random.default_rng(recipe.seed))


def possible_policies(scene: Scene) -> tuple[str, ...]:
    """Return the policies of the scene's usual mix: its own list, else all that are possible and not on request."""
    loaded = {name: policy(name) for name in policy_names()}
    return scene.policies or tuple(n for n, each in loaded.items() if not each.on_request and each.possible(scene))


def policies_with_goal(recipe: GenerationRecipe, scene: Scene) -> tuple[str, ...]:
    """Return those of a recipe's policies that mean to do something with the object of a scene, by a plan of each.

    A policy that cannot act or plan there counts as one that has a goal: `check`, or its episodes, say what is wrong.
    """
    return tuple(name for name in recipe.policies if _has_goal(recipe, scene, name))


def _has_goal(recipe: GenerationRecipe, scene: Scene, policy_name: str) -> bool:
    """Tell whether a policy's plan has a goal."""
    if not policy(policy_name).possible(scene):
        return True
    first_job = EpisodeJob(id=policy_name, index=0, policy=policy_name, seed=recipe.seed)
    try:
        return planned(scene, first_job, recipe.duration_s).goal is not None
    except DataError:
        return True


def job(recipe: GenerationRecipe, index: int, scene: Scene, motions: Sequence[Motion] = ()) -> EpisodeJob:
    """Return the job of episode `index`, which plays in `scene`; policies, or the motions of a file, take turns."""
    turn, scene_turn = index % len(recipe.policies), recipe.scene_turn(index)
    return EpisodeJob(
        id=episode_id(recipe, index),
        index=index,
        policy=recipe.policies[turn],
        seed=recipe.seed,
        effects=(*recipe.effects, *_drawn_effects(recipe, scene, index)),
        hidden=recipe.sealed is not None,
        point_cloud=recipe.point_clouds[scene_turn] if recipe.point_clouds else None,
        object=named_object(recipe.objects[scene_turn]).name if recipe.objects else None,
        motion=motions[turn] if motions else None,
        step_policy=_step_policy(recipe.step_policy, str(recipe.policy_digest)) if recipe.step_policy else None,
        disturbances=recipe.disturbances,
    )


@lru_cache(maxsize=1)
def _step_policy(source: str, digest: str) -> StepPolicy:
    """Return the policy of a recipe, read once a process.

    Raises
    ------
    DataError
        When it is no longer what the recipe was made from.
    """
    step_policy = read_step_policy(source)
    if step_policy.digest != digest:
        raise DataError("the policy has changed while it was played", where=Where(path=source))
    return step_policy


def noise_of(noise: bool | Noise, scene: Scene) -> Noise | None:
    """Return the sensor noise of a set's episodes: the scene's, another in its place, or none."""
    if isinstance(noise, bool):
        return scene.file.noise if noise else None
    return noise


def motions_of(recipe: GenerationRecipe, scene: Scene) -> tuple[Motion, ...]:
    """Return the motions of the recipe's policy file; none without one.

    Raises
    ------
    DataError
        When the file is no longer what the recipe was made from.
    """
    if recipe.policy_file is None:
        return ()
    motion_file = read_motions(recipe.policy_file, scene)
    if motion_file.digest != recipe.policy_digest:
        raise DataError("the policy file has changed while it was played", where=Where(path=recipe.policy_file))
    return motion_file.motions


def episode_id(recipe: GenerationRecipe, index: int) -> str:
    """Return `<scene>-s<seed>-000012`; `withheld-000012` for a withheld set."""
    prefix = "withheld" if recipe.sealed else f"{short_name(recipe.scene)}-s{recipe.seed}"
    return f"{prefix}-{index:06d}"


def short_name(scene: str) -> str:
    """Return the word for a scene in ids: its name, its file's, or the folder's of a `scene.yaml`."""
    path = Path(scene)
    if path.suffix not in (".yaml", ".yml"):
        return scene
    return path.stem if path.stem != "scene" else path.resolve().parent.name


def chunks(episodes: int, shard: tuple[int, int] = (1, 1)) -> list[range]:
    """Return the episode numbers of each chunk; the last may be shorter. Of shard `(i, n)` every n-th, from the i-th.

    Raises
    ------
    UsageError
        When there is no such shard, or it has no chunk.
    """
    number, count = shard
    all_chunks = [range(start, min(start + CHUNK, episodes)) for start in range(0, episodes, CHUNK)]
    if not 1 <= number <= count:
        raise UsageError("there is no such shard", expected="1/2 and 2/2, for example", found=f"{number}/{count}")
    if number > len(all_chunks):
        raise UsageError(
            f"shard {number}/{count} has no episodes",
            expected=f"at most {len(all_chunks)} shards: {episodes} episodes are made in chunks of {CHUNK}",
            found=f"{count} shards",
        )
    return all_chunks[number - 1 :: count]


def lineage(recipe: GenerationRecipe, scene: Scene, tools: dict[str, str], object_digests: dict[str, str]) -> Lineage:
    """Return how the set came to be; of a withheld set neither seed nor effects, only the commitment.

    `object_digests` names the objects that take turns, with the digest of the scene that holds each.
    """
    is_withheld = recipe.sealed is not None
    details = {
        "scene": scene.name,
        "scene_digest": scene.digest,
        "policies": list(recipe.policies),
        "duration_s": recipe.duration_s,
        "noise": recipe.noise if isinstance(recipe.noise, bool) else recipe.noise.model_dump(mode="json"),
    }
    if recipe.taxels:
        details["taxels"] = True
    if object_digests:
        details["objects"] = object_digests
    if recipe.outcomes:
        details["outcomes"] = recipe.outcomes
    if recipe.policy_digest is not None:
        details["step_policy" if recipe.step_policy else "policy_file"] = recipe.policy_digest
    if recipe.disturbances is not None:
        details["disturbances"] = recipe.disturbances.model_dump(mode="json", exclude_none=True)
    if not is_withheld:
        details["effects"] = [e.model_dump(mode="json") for e in recipe.effects]
        if recipe.randomisation:
            details["randomisation"] = [e.model_dump(mode="json", exclude_none=True) for e in recipe.randomisation]
        if recipe.together is not None:
            details["together"] = list(recipe.together)
    seeds = () if is_withheld else (recipe.seed,)
    return Lineage(
        operation=OPERATION,
        config_digest=_digest(details, seeds, recipe.sealed),
        seeds=seeds,
        revision=__version__,
        tools=tools,
        details=details,
        sealed=recipe.sealed,
    )


def tool_versions() -> dict[str, str]:
    """Return the versions that decide what a simulation gives."""
    return {"candata": __version__, "mujoco": mujoco.__version__, "python": platform.python_version()}


def _digest(details: dict, seeds: Sequence[int], commitment: str | None) -> str:
    """Return sha256 over all that decides what an episode holds, the simulator's version included."""
    # Where a scene lies decides nothing; what it is does.
    decides = {k: v for k, v in details.items() if k != "scene"}
    text = json.dumps([decides, list(seeds), commitment, mujoco.__version__, __version__], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
