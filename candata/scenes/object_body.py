"""The body of an object in a model: its visual surface, which carries the mass, and the pieces that touch."""

from __future__ import annotations

import mujoco

from candata.scenes.contract import SceneObject
from candata.schema.object import Shape

#: Groups of geoms: MuJoCo's viewer shows the first and hides the second at the start (mjVGROUP, mjNGROUP).
SEEN_GROUP, TOUCHING_GROUP = 2, 3
#: Colour of surfaces [r g b a].
COLOUR = (0.2, 0.55, 0.75, 1.0)
_TYPES = {
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
}
_INERTIA = {
    "exact": mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT,
    "hull": mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
}


def add_shapes(spec: mujoco.MjSpec, body: mujoco.MjsBody, scene_object: SceneObject, name: str) -> list[mujoco.MjsGeom]:
    """Return the geoms that touch, after adding all shapes of an object to a body.

    The visual surface bears the name, `NAME_piece_0` and so on are the pieces. Without pieces the surface touches.

    Parameters
    ----------
    spec : mujoco.MjSpec
        Model to add to; takes the meshes.
    body : mujoco.MjsBody
        A body of it.
    scene_object : SceneObject
        The object.
    name : str
        How the names of geoms and meshes begin.
    """
    file = scene_object.file
    surface = _add_shape(spec, body, file.visual, name, scene_object)
    surface.mass, surface.rgba = file.mass_kg, COLOUR
    if surface.type == mujoco.mjtGeom.mjGEOM_MESH:
        spec.mesh(name).inertia = _INERTIA[file.inertia]
    if not file.pieces:
        return [surface]
    surface.contype = surface.conaffinity = 0
    surface.group = SEEN_GROUP
    pieces = []
    for k, piece in enumerate(file.pieces):
        geom = _add_shape(spec, body, piece, f"{name}_piece_{k}", scene_object)
        geom.mass, geom.group = 0, TOUCHING_GROUP
        pieces.append(geom)
    return pieces


def _add_shape(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, shape: Shape, name: str, scene_object: SceneObject
) -> mujoco.MjsGeom:
    """Return the geom of a shape, and its mesh added to the model where it has one."""
    geom = body.add_geom(name=name, type=_TYPES[shape.type], pos=shape.position_m, quat=shape.quaternion)
    if shape.file is None:
        geom.size = (*shape.size_m, 0.0, 0.0)[:3]
        return geom
    if scene_object.folder is None:
        spec.add_mesh(name=name, file=shape.file)
    else:
        # The model keeps the name of the file, not where the folder lies: its digest says what was simulated.
        file = f"{name}_{shape.file}".replace("/", "_")
        spec.assets = spec.assets | {file: (scene_object.folder / shape.file).read_bytes()}
        spec.add_mesh(name=name, file=file)
    geom.meshname = name
    return geom


def plane_scene(scene_object: SceneObject) -> mujoco.MjSpec:
    """Return a model of an object, alone, standing upright on a level plane, which is called `table`."""
    spec = mujoco.MjSpec()
    spec.modelname = scene_object.name
    spec.compiler.degree = False
    spec.worldbody.add_light(pos=(0.3, -0.6, 1.5), dir=(-0.1, 0.4, -1))
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1), rgba=(0.82, 0.78, 0.72, 1)
    )
    upright = scene_object.file.upright
    body = spec.worldbody.add_body(name=scene_object.name, pos=(0, 0, upright.height_m), quat=upright.quaternion)
    body.add_freejoint(name=scene_object.name)
    add_shapes(spec, body, scene_object, scene_object.name)
    return spec
