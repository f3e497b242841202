"""Copies of a scene's files: the user's own, or the model as MuJoCo saves it."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import mujoco
import yaml

from candata.errors import SceneError
from candata.scenes import Scene
from candata.scenes.assemble import OBJECT_MARK, assemble
from candata.scenes.composition import compose
from candata.scenes.contract import SCENES
from candata.scenes.model_file import compile_model, model_path, read_model
from candata.schema.scene import ArmWithHand, SceneFile

Way = Literal["patch", "whole"]
#: How the names of candata's own sensors begin; it adds them again when it loads a scene.
_SENSOR_PREFIX = "candata_"


@dataclass(frozen=True)
class Copy:
    """A scene's files in a folder of their own; `scene` is the scene.yaml, `model` the main MJCF."""

    folder: Path
    scene: Path
    model: Path


def has_model_file(scene: Scene) -> bool:
    """Tell whether a scene is a user's file of one model, neither of the library nor of an arm with a hand."""
    return Path(scene.name).suffix in (".yaml", ".yml") and isinstance(scene.file.model, str)


def ways(scene: Scene) -> tuple[Way, ...]:
    """Return how a scene can be exported: a user's MJCF as a patch or a whole model, all else as a whole model."""
    return ("patch", "whole") if has_model_file(scene) and _source(scene).suffix.lower() == ".xml" else ("whole",)


def _source(scene: Scene) -> Path:
    """Return the model file of a user's scene."""
    return model_path(_absolute(scene.name), str(scene.file.model))


def _absolute(path: str | Path) -> Path:
    """Return a path from the root; links stay, as what lies beside them is named relative to them."""
    return Path(os.path.abspath(path))


def copy_scene(scene: Scene, way: Way, folder: Path) -> Copy:
    """Return a copy of a scene's files in `folder`, with all that the model names (meshes, textures, includes)."""
    folder.mkdir(parents=True)
    if not has_model_file(scene):
        return _save_model(scene, folder, folder / "scene.xml", folder / "scene.yaml")
    scene_path, source = _absolute(scene.name), _absolute(_source(scene))
    source_paths = [scene_path, source, *(_absolute(p) for p in mujoco.mju_getXMLDependencies(str(source)))]
    top = Path(os.path.commonpath([p.parent for p in source_paths]))
    for path in dict.fromkeys(source_paths):
        target = folder / path.relative_to(top)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    at, model = folder / scene_path.relative_to(top), folder / source.relative_to(top)
    return Copy(folder, at, model) if way == "patch" else _save_model(scene, folder, model.with_suffix(".xml"), at)


def _save_model(scene: Scene, folder: Path, model: Path, at: Path) -> Copy:
    """Return a copy whose model is one file as MuJoCo saves it, servos of a URDF included."""
    spec = _spec(scene)
    if has_model_file(scene) and _source(scene).suffix.lower() == ".urdf":
        _with_meshes(spec, _source(scene), model.parent)
    assemble(scene.name, scene.file, spec)
    for sensor in list(spec.sensors):
        if sensor.name.startswith(_SENSOR_PREFIX):
            spec.delete(sensor)
    compile_model(spec, scene.name)
    model.write_text(spec.to_xml())
    roles = {"model": os.path.relpath(model, at.parent), "actuators": scene.file.actuator_names}
    file = SceneFile.model_validate(scene.file.model_dump() | roles)
    at.write_text(yaml.safe_dump(file.model_dump(mode="json", exclude_defaults=True), sort_keys=False))
    return Copy(folder, at, model)


def _spec(scene: Scene) -> mujoco.MjSpec:
    """Return the spec of a scene, uncompiled.

    Raises
    ------
    SceneError
        When the scene's file is gone or cannot be read, the scene holds another object than its files do, or it
        consists of an arm and a hand with meshes.
    """
    if not has_model_file(scene) and OBJECT_MARK in scene.name:
        raise SceneError(
            f"scene {scene.name} holds an object that its model does not",
            expected="a built-in scene, or a scene.yaml",
            found=f"another object after {OBJECT_MARK}",
            fix="make an MJCF that attaches the object's scene.xml, then candata scene init",
        )
    if isinstance(scene.file.model, ArmWithHand):
        return _composed(scene, scene.file.model)
    if not has_model_file(scene):
        return SCENES.load(scene.name).build()
    return read_model(_source(scene))


def _composed(scene: Scene, model: ArmWithHand) -> mujoco.MjSpec:
    """Return the spec of an arm with a hand, whose files lie in folders of their own."""
    spec = compose(model.arm, model.hand, at=model.at, path=_absolute(scene.name))
    names = [mesh.file for mesh in spec.meshes if mesh.file]
    if names:
        raise SceneError(
            f"scene {scene.name} is not exported: its arm and hand name files of different folders",
            expected="one model file, or an arm and a hand without meshes",
            found=", ".join(names[:3]),
            fix="make one MJCF of both with <attach>, then candata scene init",
        )
    return spec


def _with_meshes(spec: mujoco.MjSpec, source: Path, folder: Path) -> None:
    """Copy the meshes of a URDF beside a model in `folder`, and let the spec name them there.

    MuJoCo lists the files that an MJCF depends on, but none for a URDF.
    """
    for mesh in spec.meshes:
        at = source.parent / spec.meshdir / mesh.file
        if mesh.file and at.is_file():
            mesh.file = f"meshes/{mesh.name}{at.suffix}"
            (folder / "meshes").mkdir(exist_ok=True)
            shutil.copyfile(at, folder / mesh.file)
    spec.modelfiledir, spec.meshdir = str(folder), ""
