"""The scene of each episode: the one it names, or one that is given, once it is known that the two fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError, RateError, Where
from candata.loaders import Windows
from candata.scenes import Scene, load_scene
from candata.scenes.assemble import OBJECT_MARK
from candata.scenes.object_folder import OBJECT_FILE, named_object
from candata.scenes.recorded_names import builtin_scene
from candata.schema.effect import EffectSetting
from candata.schema.json_text import parse_json
from candata.simulate import with_effects

#: Recorded rate may differ by this share from the scene's, as in a diagnosis: clocks drift by parts per million.
RATE_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class EpisodeScenes:
    """Scenes, and which of them each episode plays in.

    Attributes
    ----------
    scenes : mapping of str to Scene
        What `load_scene` took to the scene, with the effects that were asked for.
    number : (E,) int64
        Index into `scenes` by episode of the version; -1 for episodes of which there is no window.
    """

    scenes: Mapping[str, Scene]
    number: NDArray[np.int64]

    @property
    def digests(self) -> dict[str, str]:
        """SHA-256 of each scene, effects included."""
        return {name: scene.digest for name, scene in self.scenes.items()}


def episode_scenes(
    windows: Windows, scene: str | None = None, effects: tuple[EffectSetting, ...] = ()
) -> EpisodeScenes:
    """Return the scene of each episode of the windows, checked against what was recorded.

    Parameters
    ----------
    windows : Windows
        What is to be simulated.
    scene : str or None
        What `load_scene` takes; `SCENE+FOLDER` with a folder of object folders puts each episode's own object there.
        None takes the built-in scene that each episode names.
    effects : tuple of EffectSetting
        Effects added to every scene.

    Raises
    ------
    UsageError
        When an episode names no scene and none is given, or a scene or an effect is not possible.
    DataError
        When the windows lack commands or joints that a scene has, or a scene has another object, other joints or
        another rate than the episodes.
    SceneError
        When a scene is not sound.
    """
    used = np.unique(windows.owner).tolist()
    texts = windows.dataset.catalog(["meta"])["meta"].to_pylist()
    facts = {episode: parse_json(texts[episode]) for episode in used}
    names = {episode: _scene_name(windows, episode, facts[episode], scene) for episode in used}
    distinct = list(dict.fromkeys(names.values()))
    scenes = {name: load_scene(name) for name in distinct}
    for name in distinct:
        members = [episode for episode in used if names[episode] == name]
        _check_channels(windows, scenes[name])
        _check_objects(scenes[name], [facts[episode] for episode in members])
        for episode in members:
            _check_rate(windows, episode, scenes[name])
    number = np.full(len(windows.episode_ids), -1, np.int64)
    number[used] = [distinct.index(names[episode]) for episode in used]
    return EpisodeScenes({name: with_effects(part, effects) for name, part in scenes.items()}, number)


def _scene_name(windows: Windows, episode: int, facts: Mapping, scene: str | None) -> str:
    """Return what `load_scene` takes for the scene of an episode."""
    if scene is None:
        return builtin_scene(facts.get("scene"), Where(path=str(windows.dataset.path), episode=facts["id"]))
    base, mark, folder = scene.rpartition(OBJECT_MARK)
    is_collection = mark and Path(folder).is_dir() and not (Path(folder) / OBJECT_FILE).is_file()
    return f"{base}{mark}{Path(folder) / str(facts.get('object'))}" if is_collection else scene


def _check_channels(windows: Windows, scene: Scene) -> None:
    """Refuse windows without the scene's commands and joints, or with these in another order."""
    shapes, location = windows.cache.file.shapes, str(windows.dataset.path)
    for channel, recorded, expected in (
        ("object_pose", ("object",) if "object_pose" in shapes else (), ("object",) * (scene.file.object is not None)),
        ("action", windows.actuator_names if "action" in shapes else (), scene.file.actuator_names),
        ("joint_position", windows.joint_names if "joint_position" in shapes else (), scene.file.joints),
    ):
        if tuple(recorded) != tuple(expected):
            is_reordered = sorted(recorded) == sorted(expected)
            raise DataError(
                f"{channel} does not fit scene {scene.name}" + (": another order" if is_reordered else ""),
                expected=", ".join(expected) or f"no {channel}",
                found=", ".join(recorded) or f"no {channel}",
                where=Where(path=location, channel=channel),
                fix="give the scene of this hand and object, or list joints and actuators in the recorded order",
            )


def _check_rate(windows: Windows, episode: int, scene: Scene) -> None:
    """Refuse an episode of another rate than the scene's."""
    rate_hz = windows.cache.file.rate_hz[episode]
    if abs(rate_hz / scene.file.rate_hz - 1) > RATE_TOLERANCE:
        raise RateError(
            f"the episode's rate is not that of scene {scene.name}",
            expected=f"{scene.file.rate_hz:g} Hz",
            found=f"{rate_hz:g} Hz",
            where=Where(path=str(windows.dataset.path), episode=windows.episode_ids[episode]),
            fix="give the true rate_hz in scene.yaml, or resample when importing",
        )


def _check_objects(scene: Scene, facts: list[Mapping]) -> None:
    """Refuse episodes of several objects in one scene, and a scene with another object than they were played with.

    A user's own scene may call its body anything, so names are compared where an object was put in another's place.
    """
    base, mark, source = scene.name.rpartition(OBJECT_MARK)
    exchanged = scene.has_other_object
    held_name = named_object(source).name if exchanged and mark else scene.file.object
    names = {fact.get("object"): fact["id"] for fact in facts if fact.get("object") is not None}
    exchanged = exchanged or any(OBJECT_MARK in str(fact.get("scene")) for fact in facts)
    strangers = [name for name in names if name != held_name] if exchanged or len(names) > 1 else []
    if strangers:
        raise DataError(
            f"scene {scene.name} has another object than the recordings",
            expected=", ".join(sorted(map(str, names))),
            found=str(held_name),
            where=Where(episode=names[strangers[0]]),
            fix=f"give --scene {base or scene.name}{OBJECT_MARK}FOLDER with the folder of the object, or with the "
            "folder that holds all objects' folders",
        )
