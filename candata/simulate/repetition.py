"""An episode made again from what it and its dataset keep: bit for bit the same, or an error that says what differs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ConfigDict, Field

from candata.datasets import Dataset, append, create_dataset, get_cloud, put_cloud
from candata.datasets.history import Origin, derived_lineage, tree
from candata.errors import DataError, UsageError, Where
from candata.policies import Motion, StepPolicy, read_motions, read_step_policy
from candata.scenes import Scene, load_scene
from candata.scenes.assemble import OBJECT_MARK
from candata.scenes.contract import OBJECTS
from candata.scenes.labels import with_labels
from candata.scenes.object_folder import named_object
from candata.schema.disturbance import Disturbances
from candata.schema.episode import Episode, EpisodeMeta
from candata.schema.manifest import VersionFile
from candata.schema.record import Record
from candata.schema.scene import Noise
from candata.simulate.episodes import EpisodeJob, make_episodes
from candata.simulate.jobs import OPERATION, noise_of, tool_versions
from candata.simulate.perturbation import Draw

#: Number of an episode, at the end of its id (`candata.simulate.jobs.episode_id`).
_INDEX = re.compile(r"-(\d{6,})$")


class _Details(Record):
    """What the lineage of a generated set says of its episodes (`candata.simulate.jobs.lineage`), as far as needed."""

    model_config = ConfigDict(extra="ignore")

    scene: str
    scene_digest: str
    policies: tuple[str, ...]
    duration_s: float
    noise: bool | Noise
    objects: dict[str, str] = Field(default_factory=dict)
    policy_file: str | None = None
    step_policy: str | None = None
    disturbances: Disturbances | None = None


@dataclass(frozen=True)
class _Generation:
    """A generation in a dataset's lineage: its seeds, the versions that made it, and what it made."""

    seeds: tuple[int, ...]
    tools: Mapping[str, str]
    details: _Details


def repeat_episode(
    dataset: Dataset,
    episode_id: str,
    *,
    scene: str | None = None,
    objects: Sequence[str] = (),
    policy_file: str | Path | None = None,
    step_policy: str | None = None,
) -> Episode:
    """Return an episode that was simulated again, bit-equal to the one in the dataset.

    Seed, number, policy, object and effects are those of the episode; duration, noise and the digest of the scene are
    those of its `generate-sim` in the lineage, however often the dataset was filtered and merged since.

    Parameters
    ----------
    dataset : Dataset
        A version that holds the episode.
    episode_id : str
        Its id.
    scene : str, optional
        Where its scene lies now; where it lay then by default.
    objects : sequence of str
        Names or folders of objects; needed where the object's folder is not a registered name.
    policy_file : str or Path, optional
        The motions that the set was made with; needed where these came from a file.
    step_policy : str, optional
        The policy of a closed loop that the set was made with; needed where it had one.

    Raises
    ------
    UnknownNameError
        When the dataset holds no such episode, or there is no such scene or object.
    UsageError
        When the episode was not made by `generate-sim` or is withheld, or its policy file is not given.
    DataError
        When the scene or the policy file is not what it was, or the episode is not the same.
    """
    recorded = dataset.episode(episode_id)
    differences: list[DataError] = []
    for generation in _origins(dataset, recorded.meta):
        try:
            asked_scene = _scene(recorded.meta, generation, scene, objects)
            if "fingertip_collision" in recorded or "taxels" in recorded:
                asked_scene = with_labels(asked_scene, "taxels" in recorded)
            repeated = _simulated(recorded.meta, generation, asked_scene, policy_file, step_policy)
            _refuse_difference(recorded, repeated, generation)
        except DataError as error:
            differences.append(error)
        else:
            return repeated
    raise differences[0]


def store_repeated(out: str | Path, dataset: Dataset, episode: Episode) -> VersionFile:
    """Return the version of the dataset at `out` that holds an episode made again, with its object's point cloud.

    Raises
    ------
    DataError
        When `out` holds another episode of this id.
    """
    root = create_dataset(out, exist_ok=True)
    if episode.meta.point_cloud is not None:
        put_cloud(root, get_cloud(dataset.path, episode.meta.point_cloud))
    details = {"again": episode.meta.id}
    return append(root, [episode], derived_lineage(f"{OPERATION} --again", [dataset], details))


def _origins(dataset: Dataset, meta: EpisodeMeta) -> tuple[_Generation, ...]:
    """Return the generations in the dataset's lineage that may have made the episode; one in nearly all datasets."""
    if meta.source != "sim" or meta.seed is None or meta.effects is None:
        known_text = "of a withheld set: its seed and effects are sealed" if meta.id.startswith("withheld") else ""
        raise UsageError(
            "the episode cannot be made again",
            expected="an episode of generate-sim, with its seed and effects",
            found=known_text or f"one with source {meta.source}, seed {meta.seed}",
            where=Where(path=str(dataset.path), episode=meta.id),
        )
    by_configuration = dict(_generations(tree(dataset)))
    origins = tuple(generation for generation in by_configuration.values() if _may_have_made(generation, meta))
    if not origins:
        raise UsageError(
            "the lineage does not say how the episode was made",
            expected=f"a generate-sim of scene {meta.scene} with seed {meta.seed}",
            found="none",
            where=Where(path=str(dataset.path), episode=meta.id),
            fix="give the dataset that generate-sim wrote",
        )
    return origins


def _generations(origin: Origin) -> Iterator[tuple[tuple[str | None, str], _Generation]]:
    """Yield every generation in a tree of versions, with the digest of its configuration and its scene as typed."""
    for step in origin.steps:
        record = step.record
        if record.operation == OPERATION:
            details = _Details.parse(record.details, f"lineage of {origin.dataset}")
            yield (record.config_digest, details.scene), _Generation(record.seeds, record.tools, details)
        for parent in step.parents:
            yield from _generations(parent)


def _may_have_made(generation: _Generation, meta: EpisodeMeta) -> bool:
    """Tell whether a generation has the episode's seed, scene and motion."""
    details = generation.details
    scene_names = [f"{details.scene}{OBJECT_MARK}{name}" for name in details.objects] or [details.scene]
    return meta.seed in generation.seeds and meta.scene in scene_names and meta.task in details.policies


def _scene(meta: EpisodeMeta, generation: _Generation, scene: str | None, objects: Sequence[str]) -> Scene:
    """Return the scene of an episode, which must be what it was."""
    name, digest = scene or generation.details.scene, generation.details.scene_digest
    if generation.details.objects:
        name = f"{name}{OBJECT_MARK}{_object_source(meta, objects)}"
        digest = generation.details.objects[str(meta.object)]
    loaded_scene = load_scene(name)
    if loaded_scene.digest != digest:
        raise DataError(
            "the scene is not the one that the episode was made in",
            expected=f"scene digest {digest[:12]}",
            found=f"scene digest {loaded_scene.digest[:12]}; {_versions_text(generation)}",
            where=Where(path=name, episode=meta.id),
            fix="restore the scene's files, or name where they lie now with --scene",
        )
    return loaded_scene


def _object_source(meta: EpisodeMeta, objects: Sequence[str]) -> str:
    """Return the name or the folder of an episode's object."""
    by_name = {named_object(source).name: source for source in objects}
    name = str(meta.object)
    if name not in by_name and name not in OBJECTS:
        raise UsageError(
            f"the object {name} is no registered one",
            expected="--objects with the folder that it came from",
            found=", ".join(by_name) or "no --objects",
            where=Where(episode=meta.id),
        )
    return by_name.get(name, name)


def _motion(
    meta: EpisodeMeta, generation: _Generation, scene: Scene, index: int, policy_file: str | Path | None
) -> Motion | None:
    """Return the motion of a policy file that an episode played; None where it played a policy."""
    digest = generation.details.policy_file
    if digest is None and policy_file is not None:
        raise UsageError("the commands of the episode came from no policy file", fix="leave --policy-file out")
    if digest is None:
        return None
    if policy_file is None:
        raise UsageError(
            "the episode played a policy file, which a dataset does not keep",
            expected=f"--policy-file with the motions {digest[:12]}",
            where=Where(episode=meta.id),
        )
    file = read_motions(policy_file, scene)
    if file.digest != digest:
        raise DataError(
            "the policy file is not the one that the episode played",
            expected=f"motions {digest[:12]}",
            found=f"motions {file.digest[:12]}",
            where=Where(path=str(policy_file), episode=meta.id),
        )
    return file.motions[index % len(file.motions)]


def _step_policy(meta: EpisodeMeta, generation: _Generation, source: str | None) -> StepPolicy | None:
    """Return the policy of an episode's closed loop; None where its commands were planned."""
    digest = generation.details.step_policy
    if digest is None and source is not None:
        raise UsageError("the commands of the episode were planned", fix="leave --policy-module out")
    if digest is None:
        return None
    if source is None:
        raise UsageError(
            "the episode came from a policy in a closed loop, which a dataset does not keep",
            expected=f"--policy-module with the policy {digest[:12]}",
            where=Where(episode=meta.id),
        )
    step_policy = read_step_policy(source)
    if step_policy.digest != digest:
        raise DataError(
            "the policy is not the one that the episode came from",
            expected=f"policy {digest[:12]}",
            found=f"policy {step_policy.digest[:12]}",
            where=Where(path=source, episode=meta.id),
        )
    return step_policy


def _simulated(
    meta: EpisodeMeta,
    generation: _Generation,
    scene: Scene,
    policy_file: str | Path | None,
    step_policy: str | None,
) -> Episode:
    """Return the episode as this machine simulates it, with who, what and when of the one that is stored."""
    match = _INDEX.search(meta.id)
    if match is None:
        raise DataError(
            "the id of the episode does not tell its number",
            expected="an id that ends in it, such as cube_toss-s1-000012",
            found=meta.id,
        )
    index = int(match[1])
    job = EpisodeJob(
        id=meta.id,
        index=index,
        policy=str(meta.task),
        seed=int(meta.seed or 0),
        effects=meta.effects or (),
        motion=_motion(meta, generation, scene, index, policy_file),
        step_policy=_step_policy(meta, generation, step_policy),
        disturbances=generation.details.disturbances,
        draw=Draw.kept(meta.labels),
    )
    noise = noise_of(generation.details.noise, scene)
    (episode,) = make_episodes(scene, [job], duration_s=generation.details.duration_s, noise=noise)
    return Episode(meta, episode.arrays)


def _refuse_difference(recorded: Episode, repeated: Episode, generation: _Generation) -> None:
    """Raise DataError where any bit of any channel differs."""
    channels = dict.fromkeys([*recorded.arrays, *repeated.arrays])
    differing_channels = [name for name in channels if not _is_same(recorded, repeated, name)]
    if differing_channels:
        raise DataError(
            "the episode is not the same when it is made again",
            expected=f"the same bits in {', '.join(channels)}",
            found=f"others in {', '.join(differing_channels)}; {_versions_text(generation)}",
            where=Where(episode=recorded.meta.id),
            fix="use the versions, and a machine of the kind, that it was made with",
        )


def _is_same(recorded: Episode, repeated: Episode, channel: str) -> bool:
    """Tell whether both episodes hold a channel with the same bits."""
    if channel not in recorded or channel not in repeated:
        return False
    first, second = recorded[channel], repeated[channel]
    return first.shape == second.shape and np.ascontiguousarray(first).tobytes() == second.tobytes()


def _versions_text(generation: _Generation) -> str:
    """Return which versions differ between then and now, as a clause."""
    now = tool_versions()
    texts = [
        f"{name} {generation.tools.get(name)} then, {now[name]} now"
        for name in now
        if generation.tools.get(name) != now[name]
    ]
    return ", ".join(texts) or "the versions are the same"
