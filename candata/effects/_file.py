"""`effects.yaml` as a value, and the scene that it names."""

from __future__ import annotations

from pathlib import Path

import yaml

from candata.errors import UsageError, Where
from candata.lfs import refuse_pointer
from candata.schema.effect import EffectsFile
from candata.schema.yaml_text import parse_yaml


def read_effects(path: Path) -> EffectsFile:
    """Return an effects file, checked.

    Raises
    ------
    UsageError
        When it is missing, no YAML, or not valid.
    DataError
        When it is a Git LFS pointer.
    """
    refuse_pointer(path)
    try:
        return EffectsFile.parse(parse_yaml(path.read_text()), path)
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text"
        raise UsageError(f"no effects file: {why}", where=Where(path=str(path))) from None
    except yaml.YAMLError as error:
        raise UsageError(f"{path.name} is not YAML: {error}", where=Where(path=str(path))) from None


def scene_of(file: EffectsFile, path: Path) -> str:
    """Return the scene that an effects file names: a file beside it, whatever the working directory, or a name.

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
    beside = path.parent / file.scene
    return str(beside) if beside.is_file() else file.scene
