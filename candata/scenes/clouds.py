"""Surface clouds: points on a scene's object, the same for the same shape on every machine."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import SceneError
from candata.rotation import conjugate, rotate
from candata.scenes.assemble import Scene, subtree

POINTS, SEED = 512, 0


def surface_cloud(scene: Scene, points: int = POINTS, seed: int = SEED) -> NDArray[np.float32]:
    """Return `(points, 3) float32 [m]` in the object's frame, uniform over the area of its geoms.

    Parameters
    ----------
    scene : Scene
        Its colliding geoms are sampled; all of the object's where none collides.
    points, seed : int
        How many, and the seed of the sampling.

    Raises
    ------
    SceneError
        When the scene has no object, or none of its geoms has a surface.
    """
    if scene.object_id is None:
        raise SceneError(f"scene {scene.name} has no object", fix="name it: `object: BODY`")
    import trimesh  # slow to import, needed once a set

    model, body = scene.model, scene.object_id
    geoms = scene.object_geoms
    if not len(geoms):
        geoms = np.flatnonzero(np.isin(model.geom_bodyid, list(subtree(model, body))))
    shapes = [shape for g in geoms if (shape := _mesh(model, int(g))) is not None]
    if not shapes:
        raise SceneError(f"object {scene.file.object} has no surface", expected="a geom that is a solid")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    placed = [
        trimesh.Trimesh(v @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g], f, process=False)
        for g, v, f in shapes
    ]
    found, _ = trimesh.sample.sample_surface(trimesh.util.concatenate(placed), points, seed=seed)
    local = rotate(conjugate(data.xquat[body]), np.asarray(found) - data.xpos[body])
    return local.astype(np.float32)


def _mesh(model: mujoco.MjModel, geom: int) -> tuple[int, NDArray, NDArray] | None:
    """Return `(geom, vertices, faces)` in the geom's frame; None for planes and fields."""
    import trimesh

    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return (geom, *_own_mesh(model, int(model.geom_dataid[geom])))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        made = trimesh.creation.box(2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        made = trimesh.creation.icosphere(3, size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        made = trimesh.creation.icosphere(3, 1.0).apply_scale(size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        made = trimesh.creation.cylinder(size[0], 2 * size[1], sections=64)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        made = trimesh.creation.capsule(2 * size[1], size[0])
    else:
        return None
    return geom, np.asarray(made.vertices), np.asarray(made.faces)


def _own_mesh(model: mujoco.MjModel, mesh: int) -> tuple[NDArray, NDArray]:
    """Return vertices and faces of a mesh of the model."""
    v, f = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[v : v + model.mesh_vertnum[mesh]]
    return np.array(vertices, float), np.array(model.mesh_face[f : f + model.mesh_facenum[mesh]])
