"""Scenes that recordings name: built-in ones alone, as files that a dataset names are never opened."""

from __future__ import annotations

from candata.errors import UsageError, Where
from candata.scenes.assemble import OBJECT_MARK
from candata.scenes.contract import OBJECTS, SCENES


def builtin_scene(name: str | None, where: Where) -> str:
    """Return the name of a recording's scene, which `load_scene` takes.

    Parameters
    ----------
    name : str or None
        What the recording names.
    where : Where
        The recording.

    Raises
    ------
    UsageError
        When it names none, or a file, or an object that is not registered.
    """
    if not name:
        raise UsageError("the recordings name no scene", where=where, fix="give it: --scene NAME or scene.yaml")
    base, mark, object_name = name.rpartition(OBJECT_MARK)
    if name in SCENES or (base in SCENES and object_name in OBJECTS):
        return name
    scene_name = base if base in SCENES else "scene.yaml"
    folder = f"{mark}FOLDER, with the folder of the object, or of all objects' folders" if mark else ""
    raise UsageError(
        f"the recordings' scene {name} is not built in", where=where, fix=f"give it: --scene {scene_name}{folder}"
    )
