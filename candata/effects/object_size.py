"""The object is larger or smaller than modelled."""

from __future__ import annotations

import mujoco
import numpy as np

from candata.effects import _select
from candata.effects._contract import Advice, Array, Effect, Parameter, always, constant_bounds, spans, values
from candata.scenes.assemble import Scene, subtree


def _edit(model: mujoco.MjModel, scene: Scene, x: Array, element: str | None) -> None:
    """Scale all lengths of the object about its frame's origin; mass and inertia stay."""
    if x[0] == 1 or scene.object_id is None:
        return
    bodies = sorted(subtree(model, scene.object_id))
    geoms = np.flatnonzero(np.isin(model.geom_bodyid, bodies))
    sites = np.flatnonzero(np.isin(model.site_bodyid, bodies))
    for lengths in (model.geom_size, model.geom_pos, model.geom_rbound, model.geom_aabb):
        lengths[geoms] *= x[0]
    model.site_pos[sites] *= x[0]
    model.body_ipos[bodies] *= x[0]
    model.body_pos[[b for b in bodies if b != scene.object_id]] *= x[0]
    _scale_meshes(model, geoms, x[0])


def _scale_meshes(model: mujoco.MjModel, geoms: _select.Ids, scale: float) -> None:
    """Scale the vertices and bounding volumes of the meshes that these geoms show."""
    meshes = _meshes(model, geoms)
    for mesh in meshes:
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        model.mesh_vert[start : start + count] *= scale
        start, count = model.mesh_bvhadr[mesh], model.mesh_bvhnum[mesh]
        model.bvh_aabb[start : start + count] *= scale


def _meshes(model: mujoco.MjModel, geoms: _select.Ids) -> set[int]:
    """Return ids of the meshes of some geoms."""
    is_mesh = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH
    return set(model.geom_dataid[geoms[is_mesh]].tolist())


def _can_act(scene: Scene) -> bool:
    """Tell whether the object's geometry is its own: no mesh is shared with another body."""
    if scene.object_id is None:
        return False
    object_bodies = np.isin(scene.model.geom_bodyid, list(subtree(scene.model, scene.object_id)))
    ids = np.arange(scene.model.ngeom)
    return not _meshes(scene.model, ids[object_bodies]) & _meshes(scene.model, ids[~object_bodies])


EFFECT = Effect(
    about="geometry of the object is scaled, mass and inertia stay",
    advice=Advice("Multiply the object's lengths by {x}, its mass unchanged", "multiply size and pos of its <geom>s"),
    traits=frozenset({"tracked_length"}),
    parameters=(
        Parameter(
            "scale",
            "1",
            constant_bounds(0.8, 1.25),
            values(0.95, 0.98, 1.02, 1.05),
            spans((0.93, 0.97), (1.03, 1.07)),
            "callipers are right to a millimetre; scanned and catalogue models are off by some per cent",
            always(1.0),
        ),
    ),
    acts_on="object",
    possible=_can_act,
    edit=_edit,
    set_const=True,
)
