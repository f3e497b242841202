"""The hand that a model moves: read off the scene that recordings name, kept in the model's configuration."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from candata.datasets import Dataset
from candata.errors import CandataError, UsageError, Where
from candata.scenes import load_scene
from candata.scenes.assemble import OBJECT_MARK
from candata.scenes.kinematics import hand_kinematics
from candata.scenes.recorded_names import builtin_scene
from candata.schema.json_text import parse_json
from candata.schema.kinematics import HandKinematics


def with_hand(config: Any, datasets: Iterable[Dataset], scene: str | None) -> tuple[Any, tuple[str, ...]]:
    """Return a model's configuration with the hand of the data, where the model reads one, and notes for people.

    Parameters
    ----------
    config : Record
        Of a model; one that `reads_hand` gets it where its `hand` is None.
    datasets : iterable of Dataset
        What is trained on; the first scene that they name is taken.
    scene : str or None
        What `load_scene` takes, instead.

    Raises
    ------
    CandataError
        When `scene` is given and is not there, or not of the hand of the data.
    """
    if not getattr(config, "reads_hand", False) or config.hand is not None:
        return config, ()
    catalogs = [dataset.catalog(["scene", "meta"]) for dataset in datasets]
    facts = parse_json(catalogs[0]["meta"][0].as_py())
    if scene is not None:
        base, mark, _ = scene.rpartition(OBJECT_MARK)
        hand = _hand(base if mark and not Path(scene).exists() else scene, facts)
    else:
        named_scenes = [name for table in catalogs for name in table["scene"].to_pylist() if name is not None]
        if not named_scenes:
            return config, ("no fingertips: the recordings name no scene; --scene gives the hand's",)
        try:
            base = str(named_scenes[0]).partition(OBJECT_MARK)[0]
            hand = _hand(builtin_scene(base, Where(episode=facts["id"])), facts)
        except CandataError as error:
            return config, (f"no fingertips: {error.problem}; --scene gives the hand's",)
    if hand is None:
        return config, ("no fingertips: the joints do not say where the scene's fingertips are",)
    return config.model_copy(update={"hand": hand}), ()


def _hand(scene: str, facts: dict) -> HandKinematics | None:
    """Return the hand of a scene, which must have the joints and actuators of the recordings, told by `facts`."""
    loaded_scene = load_scene(scene)
    for key, expected in (
        ("joint_names", loaded_scene.file.joints),
        ("actuator_names", loaded_scene.file.actuator_names),
    ):
        names = tuple(facts.get(key, ()))
        if names != tuple(expected):
            raise UsageError(
                f"scene {scene} is not of the recordings' hand",
                expected=f"{key.replace('_', ' ')} {', '.join(names) or 'none'}",
                found=", ".join(expected) or "none",
                fix="give the scene of this hand, its joints in the recorded order",
            )
    return hand_kinematics(loaded_scene)
