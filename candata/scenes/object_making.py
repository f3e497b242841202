"""Objects made from meshes, and written into folders of their own."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
import yaml

from candata.errors import DataError, UsageError, Where
from candata.scenes.contract import SceneObject
from candata.scenes.model_file import compile_model
from candata.scenes.object_body import plane_scene
from candata.scenes.object_folder import OBJECT_FILE
from candata.scenes.object_mesh import ENDINGS, CheckedMesh, obj_text, read_mesh
from candata.scenes.object_pieces import convex_pieces
from candata.scenes.resting import DROPS, resting_poses
from candata.schema.object import MOST_PIECES, ObjectFile, RestingPose, Shape, is_object_name

#: Names of the meshes in a folder of an object, and of files that may become one.
VISUAL, PIECE = "visual.obj", "convex_{}.stl"
_PIECE = re.compile(r"convex_(\d+)")
#: Control rate of the scene that is written with an object [Hz]: five physics steps of 2 ms.
RATE_HZ = 100
#: Distance between the boxes of a mesh and of its pieces, as a share of its largest side. Chosen: YCB objects have at
#: most 0.024; it is a half where one frame is in the middle and the other at the base.
MOST_OFF = 0.2
#: Stands for the resting poses while they are sought.
_AS_MODELLED = RestingPose(quaternion=(1.0, 0.0, 0.0, 0.0), height_m=0.0, probability=0.0, tilt_rad=0.0)


@dataclass(frozen=True)
class ObjectSource:
    """What an object is made of.

    Attributes
    ----------
    path : Path
        A mesh; or a folder with `visual.obj` (or .stl, .ply) and, optional, convex pieces `convex_0.stl` and so on.
    name : str
        Name of the object.
    mass_kg : float
        Its mass.
    scale : float
        Factor that makes metres of the numbers in its meshes.
    about, origin, licence : str, optional
        What it is, where it is from, and what has to be said with every copy.
    """

    path: Path
    name: str
    mass_kg: float
    scale: float = 1.0
    about: str | None = None
    origin: str | None = None
    licence: str | None = None


@dataclass(frozen=True)
class MadeObject:
    """An object that was made, and warnings for whoever made it."""

    scene_object: SceneObject
    warnings: tuple[str, ...]


def make_object(
    source: ObjectSource, folder: Path, say: Callable[[str], None] = lambda _line: None, drops: int = DROPS
) -> MadeObject:
    """Return an object made of meshes, its files written into a new folder.

    Written are `object.yaml`, `visual.obj`, the convex pieces, and a scene of it on a plane: `scene.xml`, `scene.yaml`.

    Parameters
    ----------
    source : ObjectSource
        The meshes, and what they do not tell.
    folder : Path
        Folder to make.
    say : callable
        Takes lines about what takes long.
    drops : int
        Drops from random attitudes, of which the resting poses are made.

    Raises
    ------
    UsageError
        When the name is no single word, or mass or scale are not above 0.
    DataError
        When a mesh is missing or spoils a simulation, the pieces do not fit it, or the object never comes to rest.
    SceneError
        When MuJoCo refuses it.
    """
    _check(source)
    visual, given_pieces = _mesh_files(source.path)
    mesh = read_mesh(visual, source.scale)
    pieces, piece_warning = [read_mesh(path, source.scale).hull for path in given_pieces], None
    if pieces:
        _check_frame(source, mesh, pieces)
    else:
        pieces, piece_warning = convex_pieces(mesh, source.name, say)
    folder.mkdir(parents=True)
    (folder / VISUAL).write_text(obj_text(mesh.surface), encoding="ascii")
    for k, piece in enumerate(pieces):
        (folder / PIECE.format(k)).write_bytes(trimesh.exchange.stl.export_stl(piece))
    file = _file(source, mesh, len(pieces))
    rests = resting_poses(compile_model(plane_scene(SceneObject(file, folder)), source.name), drops)
    if not rests:
        raise DataError(
            f"object {source.name} does not come to rest on a plane",
            where=Where(path=str(source.path)),
            fix="check mass, size and pieces: each drop is watched for 10 s",
        )
    scene_object = SceneObject(file.model_copy(update={"rests": rests}), folder)
    _write_texts(scene_object, folder)
    warnings = (*_mesh_warnings(mesh, source.name), *([piece_warning] if piece_warning else []))
    return MadeObject(scene_object, warnings)


def _check(source: ObjectSource) -> None:
    """Refuse a name that is a path, and numbers that are none or not above 0."""
    if not is_object_name(source.name):
        raise UsageError(
            f"{source.name!r} is no name of an object",
            expected="one word of letters, digits, _ and -, such as mug",
            found=repr(source.name),
            fix="name it with --name",
        )
    for option, value, unit in (("--mass", source.mass_kg, " kg"), ("--scale", source.scale, "")):
        if not (np.isfinite(value) and value > 0):
            raise UsageError(f"{option} is no number above 0", expected=f"above 0{unit}", found=f"{value:g}{unit}")


def _mesh_files(path: Path) -> tuple[Path, list[Path]]:
    """Return the visual mesh and the convex pieces that a path means."""
    if not path.is_dir():
        return path, []
    meshes = sorted(file for file in path.iterdir() if file.suffix.lower() in ENDINGS)
    number_of = {file: int(match[1]) for file in meshes if (match := _PIECE.fullmatch(file.stem))}
    surfaces = [file for file in meshes if file not in number_of]
    surfaces = [file for file in surfaces if file.stem == "visual"] or surfaces
    if len(surfaces) != 1:
        raise DataError(
            f"folder {path.name} does not say which mesh is seen",
            expected="visual.obj (or .stl, .ply), or one mesh that is not called convex_0, convex_1, ...",
            found=", ".join(file.name for file in surfaces) or "no such mesh",
            where=Where(path=str(path)),
            fix="call it visual",
        )
    if len(number_of) > MOST_PIECES:
        raise DataError(
            f"folder {path.name} has too many convex pieces",
            expected=f"at most {MOST_PIECES}",
            found=str(len(number_of)),
            where=Where(path=str(path)),
            fix="cut it more coarsely",
        )
    return surfaces[0], sorted(number_of, key=number_of.__getitem__)


def _check_frame(source: ObjectSource, mesh: CheckedMesh, pieces: list[trimesh.Trimesh]) -> None:
    """Refuse pieces whose common box is not that of the mesh: another frame or unit, or some are missing."""
    corners = np.array([piece.bounds for piece in pieces])
    box = np.stack([corners[:, 0].min(0), corners[:, 1].max(0)])
    off_m = float(np.abs(box - mesh.surface.bounds).max())
    if off_m > MOST_OFF * float(mesh.surface.extents.max()):
        raise DataError(
            f"the convex pieces of {source.name} do not fit its mesh",
            expected="pieces that cover the mesh, in its frame and unit",
            found=f"their box is off by {off_m * 1e3:.0f} mm",
            where=Where(path=str(source.path)),
            fix="export mesh and pieces together",
        )


def _file(source: ObjectSource, mesh: CheckedMesh, pieces: int) -> ObjectFile:
    """Return the record of an object whose resting poses are not known yet."""
    sides = " x ".join(f"{side * 1e3:.0f}" for side in mesh.surface.extents)
    return ObjectFile(
        name=source.name,
        about=source.about or f"{source.name.replace('_', ' ')}, {sides} mm, {source.mass_kg:.4g} kg",
        mass_kg=source.mass_kg,
        visual=Shape(type="mesh", file=VISUAL),
        pieces=tuple(Shape(type="mesh", file=PIECE.format(k)) for k in range(pieces)),
        inertia="exact" if mesh.is_closed else "hull",
        rests=(_AS_MODELLED,),
        origin=source.origin,
        licence=source.licence,
    )


def _mesh_warnings(mesh: CheckedMesh, name: str) -> list[str]:
    """Return what was done about a mesh that is not quite sound."""
    warnings = []
    if mesh.was_inside_out:
        warnings.append(f"the normals of {name} pointed inward and were turned")
    if not mesh.is_closed:
        warnings.append(f"the mesh of {name} is open: its mass centre and inertia are those of its convex hull")
    return warnings


def _write_texts(scene_object: SceneObject, folder: Path) -> None:
    """Write the record of an object, and a scene of it on a plane, whose meshes are named from the folder."""
    file = scene_object.file
    (folder / OBJECT_FILE).write_text(_yaml(file.model_dump(mode="json", exclude_defaults=True)), encoding="utf-8")
    spec = plane_scene(SceneObject(file))
    spec.modelfiledir = str(folder)
    compile_model(spec, file.name)
    (folder / "scene.xml").write_text(spec.to_xml(), encoding="utf-8")
    scene = {"model": "scene.xml", "rate_hz": RATE_HZ, "object": file.name, "support": "table"}
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene, sort_keys=False), encoding="utf-8")


def _yaml(value: dict) -> str:
    """Return plain data as YAML, short lists in one line."""
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=None, width=110)
