"""The model file of a scene, MJCF or URDF, as a spec: the one place where models are read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import mujoco

from candata.errors import MissingExtraError, SceneError, Where
from candata.scenes.first_load import load_first
from candata.scenes.mesh_paths import resolve_meshes
from candata.scenes.model_text import check_text

#: What MuJoCo raises of a model that it cannot read or compile; too little memory is a RuntimeError.
MODEL_ERRORS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError)
#: Package that downloads the models of MuJoCo Menagerie, by its authors.
MENAGERIE = "mujoco_menagerie"
#: Kinds of elements whose names a scene may read.
_NAMED_KINDS = ("bodies", "joints", "geoms", "sites", "actuators", "tendons", "meshes", "keys", "sensors", "materials")
#: Kinds of elements that may be read from a file.
_OF_FILES = ("meshes", "hfields", "textures", "skins")


def model_path(path: Path, model: str) -> Path:
    """Return where the model of a scene file at `path` lies: beside it, or in an installed package as `PACKAGE:FILE`.

    `mujoco_menagerie:ID` is a robot of MuJoCo Menagerie, `mujoco_menagerie:ID/MODEL` one of its models by name.

    Raises
    ------
    MissingExtraError
        When it is one of MuJoCo Menagerie's, whose package is not installed.
    SceneError
        When the package is not installed, or MuJoCo Menagerie has no such model.
    """
    package, colon, file_name = model.partition(":")
    if not colon or not package.isidentifier() or (path.parent / model).exists():
        return path.parent / model
    if package == MENAGERIE:
        return _menagerie_file(file_name, path)
    package_spec = find_spec(package)
    folders = list(package_spec.submodule_search_locations or ()) if package_spec else []
    if not folders:
        raise SceneError(
            f"the model lies in the package {package}, which is not installed",
            expected=model,
            where=Where(path=str(path)),
            fix=f"pip install {package.replace('_', '-')}",
        )
    return Path(folders[0]) / file_name


def _menagerie_file(name: str, path: Path) -> Path:
    """Return the file of a model of MuJoCo Menagerie, which its package downloads when it is first asked for."""
    try:
        menagerie = import_module(MENAGERIE)
    except ModuleNotFoundError:
        raise MissingExtraError(MENAGERIE.replace("_", "-"), "menagerie") from None
    robot_name, _, model_name = name.partition("/")
    try:
        robot = menagerie.get(robot_name)
        return Path(robot.xml(model_name or robot.default_model))
    except (menagerie.MenagerieError, OSError) as error:
        raise SceneError(
            f"MuJoCo Menagerie gives no model {name}: {error}",
            where=Where(path=str(path)),
            fix="set MENAGERIE_ROOT to the folder of a clone of github.com/google-deepmind/mujoco_menagerie",
        ) from None


def read_model(path: Path) -> mujoco.MjSpec:
    """Return the spec of an MJCF or URDF file, the mesh paths of its packages found.

    A model that is not known yet is loaded in a process of its own first, and never here if that goes wrong.

    Raises
    ------
    DataError
        When it, or a file that it names, is a Git LFS pointer.
    SceneError
        When the file is no model, cannot be read, holds names that are no UTF-8, or names meshes that are not there;
        when it crashes MuJoCo, or takes more time or memory than a first load may.
    SetupError
        When no process can be started.
    """
    load_first(path)
    return parse_model(path)


def parse_model(path: Path) -> mujoco.MjSpec:
    """Return the spec of a model file, read in this process.

    Raises
    ------
    SceneError
        When the file is no model, cannot be read, holds names that are no UTF-8, or names meshes that are not there.
    """
    check_text(path)
    try:
        with without_log():
            spec: mujoco.MjSpec = mujoco.MjSpec.from_file(str(path))
        for kind in _NAMED_KINDS:
            # A name is decoded when it is read.
            [element.name for element in getattr(spec, kind)]
        resolve_meshes(spec, path)
        # So is the path of a file.
        [element.file for kind in _OF_FILES for element in getattr(spec, kind)]
    except UnicodeDecodeError as error:
        raise SceneError(
            f"model {path.name} has a name that is not UTF-8",
            found=repr(error.object),
            where=Where(path=str(path)),
            fix="save the file as UTF-8, or rename the element",
        ) from None
    except MODEL_ERRORS as error:
        text = " ".join(str(error).split())
        raise SceneError(
            f"model {path.name} cannot be read: {text}", where=Where(path=str(path)), fix=_remedy(text)
        ) from None
    return spec


def compile_model(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    """Return the model of a spec.

    Raises
    ------
    SceneError
        When it does not compile; `name` says whose it is.
    """
    try:
        with without_log():
            return spec.compile()
    except MODEL_ERRORS as error:
        text = " ".join(str(error).split())
        raise SceneError(f"scene {name} does not compile: {text}", fix=_remedy(text)) from None


@contextmanager
def without_log() -> Iterator[None]:
    """Keep MuJoCo from writing warnings to the console and to a file of the working directory."""
    usual_config, quiet_config = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    quiet_config.logto_console = quiet_config.logto_file = False
    quiet_config.set()
    try:
        yield
    finally:
        usual_config.set()


def _remedy(text: str) -> str:
    """Return what to do against what MuJoCo says."""
    if "opening file" in text:
        return "put the file there, or correct its path in the model"
    if "decoder" in text:
        return "MuJoCo tells models by their names: call the file .xml (MJCF) or .urdf, meshes .stl, .obj or .msh"
    return "run the model in MuJoCo alone first"
