"""Objects by name: registered ones, those in folders of their own, and lists of them."""

from __future__ import annotations

from pathlib import Path

from candata.errors import UsageError, Where
from candata.scenes.contract import OBJECTS, SceneObject
from candata.schema.object import ObjectFile, ObjectList
from candata.schema.yaml_text import read_yaml

OBJECT_FILE = "object.yaml"


def read_object(folder: Path) -> SceneObject:
    """Return the object that a folder holds.

    Raises
    ------
    UsageError
        When the folder has no sound `object.yaml`, or lacks a file that it names.
    """
    path = folder / OBJECT_FILE
    if not path.is_file():
        raise UsageError(
            f"{folder} holds no object", expected=OBJECT_FILE, where=Where(path=str(folder)), fix="candata scene object"
        )
    scene_object = SceneObject(ObjectFile.parse(read_yaml(path), path), folder)
    for shape in (scene_object.file.visual, *scene_object.file.pieces):
        if shape.file is not None and not (folder / shape.file).is_file():
            raise UsageError(
                f"{shape.file} of object {scene_object.name} is missing",
                where=Where(path=str(folder / shape.file)),
                fix="make the folder again: candata scene object add",
            )
    return scene_object


def named_object(name: str) -> SceneObject:
    """Return the object that a registered name or the path of a folder means.

    Raises
    ------
    UnknownNameError
        When it is neither; lists the registered ones.
    UsageError
        When the folder holds no sound object.
    """
    folder = Path(name)
    if name not in OBJECTS and "/" in name and not folder.is_dir():
        raise UsageError(
            f"object folder {name} does not exist",
            expected="a folder that `candata scene object add` or `candata fetch ycb` made, or a registered name",
            where=Where(path=name),
        )
    return read_object(folder) if name not in OBJECTS and folder.is_dir() else OBJECTS.load(name)


def listed_objects(path: Path) -> tuple[str, ...]:
    """Return the folders of the objects that an `objects.yaml` lists.

    Raises
    ------
    UsageError
        When the file is missing or not valid.
    """
    if not path.is_file():
        raise UsageError(f"list of objects {path} does not exist", where=Where(path=str(path)))
    listed = ObjectList.parse(read_yaml(path), path)
    return tuple(str(path.parent / listed.folder / name) for name in listed.objects)
