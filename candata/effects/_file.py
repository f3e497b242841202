"""Files of effects as values, and the scene that one names."""

from __future__ import annotations

from pathlib import Path

from candata.errors import UsageError, Where
from candata.schema.effect import EffectsFile
from candata.schema.randomisation import RandomisationFile
from candata.schema.yaml_text import read_yaml


def read_effects(path: Path) -> EffectsFile:
    """Return an effects file, checked.

    Raises
    ------
    UsageError
        When it is missing, no YAML, or not valid.
    DataError
        When it is a Git LFS pointer.
    """
    return EffectsFile.parse(read_yaml(path, "the effects file"), path)


def read_randomisation(path: Path) -> RandomisationFile:
    """Return a file of effects with distributions, checked.

    Raises
    ------
    UsageError
        When it is missing, no YAML, or not valid.
    DataError
        When it is a Git LFS pointer.
    """
    return RandomisationFile.parse(read_yaml(path, "the randomisation file"), path)


def scene_of(file: EffectsFile | RandomisationFile, path: Path) -> str:
    """Return the scene that a file of effects names: a file beside it, whatever the working directory, or a name.

    Raises
    ------
    UsageError
        When it names none.
    """
    if file.scene is None:
        raise UsageError(
            f"{path.name} names no scene",
            expected="--scene NAME or scene.yaml, or `scene:` in the file",
            where=Where(path=str(path)),
            fix="see candata scene list",
        )
    neighbour = path.parent / file.scene
    return str(neighbour) if neighbour.is_file() else file.scene
