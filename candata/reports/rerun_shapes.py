"""Geoms of a model as Rerun's shapes, in the frame of their body."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

#: Half side of the square that stands for an endless plane [m], and half its thickness.
PLANE_HALF_M, PLANE_THIN_M = 0.5, 0.0005


def shape(rr: Any, model: mujoco.MjModel, geom: int) -> Any | None:
    """Return one geom as an archetype of the module `rr` (rerun); None for kinds that it cannot show."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), np.array(model.geom_size[geom])
    style = {"quaternions": [xyzw(model.geom_quat[geom])], "colors": [_colour(model, geom)], "fill_mode": "solid"}
    centres = [np.array(model.geom_pos[geom])]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh(rr, model, geom)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        half_sizes = [s or PLANE_HALF_M for s in size[:2]]
        return rr.Boxes3D(half_sizes=[[*np.minimum(half_sizes, PLANE_HALF_M), PLANE_THIN_M]], centers=centres, **style)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return rr.Boxes3D(half_sizes=[size], centers=centres, **style)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return rr.Ellipsoids3D(half_sizes=[np.repeat(size[0], 3)], centers=centres, **style)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return rr.Ellipsoids3D(half_sizes=[size], centers=centres, **style)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], centers=centres, **style)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return _capsule(rr, model, geom, style)
    return None


def xyzw(quaternion: Any) -> Any:
    """Return a quaternion w x y z, `(..., 4)`, in Rerun's order x y z w."""
    return np.asarray(quaternion)[..., [1, 2, 3, 0]]


def _capsule(rr: Any, model: mujoco.MjModel, geom: int, style: dict[str, Any]) -> Any:
    """Return a capsule, which Rerun starts at one end and MuJoCo centres."""
    radius, half_length = model.geom_size[geom][:2]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    start = model.geom_pos[geom] - half_length * turn.reshape(3, 3)[:, 2]
    return rr.Capsules3D(lengths=[2 * half_length], radii=[radius], translations=[start], **style)


def _mesh(rr: Any, model: mujoco.MjModel, geom: int) -> Any:
    """Return a mesh with its vertices in the frame of the body."""
    mesh = int(model.geom_dataid[geom])
    v, f = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    vertices = model.mesh_vert[v : v + model.mesh_vertnum[mesh]] @ turn.reshape(3, 3).T + model.geom_pos[geom]
    faces = model.mesh_face[f : f + model.mesh_facenum[mesh]]
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=_colour(model, geom))


def _colour(model: mujoco.MjModel, geom: int) -> list[int]:
    """Return a geom's colour, of its material where it has one."""
    material = int(model.geom_matid[geom])
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return [round(255 * float(v)) for v in rgba]
