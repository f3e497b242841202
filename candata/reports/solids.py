"""Geoms of a model as few triangles in the frame of their body: what a page draws without a 3D library."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from candata.reports.posed import shown_geoms
from candata.rotation import rotate

#: Triangles of one mesh and of all meshes of a scene. Chosen: a hand of 30 links is drawn at 30 pictures a second.
MOST_OF_MESH, MOST_OF_MESHES = 600, 4000
#: Cells along the longest side of a mesh whose vertices become one, tried from fine to coarse.
CELLS = (48, 32, 24, 18, 14, 11, 8, 6, 4)
#: Half side of the square that stands for an endless plane [m].
PLANE_HALF_M = 0.4
#: Sections of a round solid.
SECTIONS = 10

_Shape = tuple[NDArray[np.float64], NDArray[np.int64]]


@dataclass(frozen=True)
class Solid:
    """A geom as triangles.

    Attributes
    ----------
    vertices : (V, 3) float64 [m]
        In the frame of the body.
    faces : (M, 3) int64
        Vertices of each triangle.
    colour : tuple of float
        Red, green, blue, opacity, of 1.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colour: tuple[float, ...]

    @property
    def is_closed(self) -> bool:
        """Whether it has no hole, is opaque, and its faces turn counterclockwise as seen from outside.

        Faces that turn away are then hidden by others.
        """
        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        return bool(self.colour[3] == 1 and mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0)


def solids(model: mujoco.MjModel, body: int) -> tuple[Solid, ...]:
    """Return the shown geoms of one body as triangles; fields and invisible geoms are left out."""
    geoms = shown_geoms(model)
    mesh_count = sum(int(model.geom_type[g]) == mujoco.mjtGeom.mjGEOM_MESH for g in geoms)
    most_faces = min(MOST_OF_MESH, MOST_OF_MESHES // max(mesh_count, 1))
    return tuple(
        Solid(rotate(model.geom_quat[g], shape[0]) + model.geom_pos[g], shape[1], _colour(model, g))
        for g in geoms
        if model.geom_bodyid[g] == body and _colour(model, g)[3] > 0 and (shape := _shape(model, g, most_faces))
    )


def _colour(model: mujoco.MjModel, geom: int) -> tuple[float, ...]:
    """Return a geom's colour, of its material where it has one."""
    material = int(model.geom_matid[geom])
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return tuple(round(float(v), 3) for v in rgba)


def _shape(model: mujoco.MjModel, geom: int, most_faces: int) -> _Shape | None:
    """Return vertices and triangles of a geom in its own frame; None for kinds that are not drawn."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), np.array(model.geom_size[geom], float)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]), most_faces)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        half_x, half_y = (min(s or PLANE_HALF_M, PLANE_HALF_M) for s in size[:2])
        corners = np.array([[-half_x, -half_y, 0], [half_x, -half_y, 0], [half_x, half_y, 0], [-half_x, half_y, 0]])
        return corners, np.array([[0, 1, 2], [0, 2, 3]])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _of(trimesh.creation.box(extents=2 * size))
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        ball, faces = _of(trimesh.creation.icosphere(subdivisions=1))
        return ball * (size[0] if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size), faces
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _of(trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=SECTIONS))
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return _of(trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[SECTIONS - 2, SECTIONS - 4]))
    return None


def _of(mesh: trimesh.Trimesh) -> _Shape:
    """Return vertices, centred, and triangles of a mesh."""
    return np.array(mesh.vertices) - np.mean(mesh.bounds, axis=0), np.array(mesh.faces, np.int64)


def _mesh(model: mujoco.MjModel, mesh: int, most_faces: int) -> _Shape:
    """Return a mesh with at most so many triangles."""
    v, f = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = np.array(model.mesh_vert[v : v + model.mesh_vertnum[mesh]], float)
    faces = np.array(model.mesh_face[f : f + model.mesh_facenum[mesh]], np.int64)
    return simplified(vertices, faces, most_faces)


def simplified(vertices: NDArray[np.float64], faces: NDArray[np.int64], most_faces: int) -> _Shape:
    """Return a mesh with fewer triangles: vertices of one cell of a grid become their mean, the grid as fine as can be.

    Source: Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes" (1993), section 2.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (M, 3) int64
    most_faces : int
        Triangles to keep at most; the coarsest grid may leave more.
    """
    if len(faces) <= most_faces:
        return vertices, faces
    low = vertices.min(axis=0)
    longest = float(np.ptp(vertices, axis=0).max()) or 1.0
    for cells in CELLS:
        cell = np.floor((vertices - low) / longest * cells)
        _, owner = np.unique(cell, axis=0, return_inverse=True)
        owner = owner.ravel()
        counts = np.bincount(owner)
        means = np.stack([np.bincount(owner, vertices[:, k]) / counts for k in range(3)], axis=1)
        merged = owner[faces]
        is_flat = (merged[:, 0] == merged[:, 1]) | (merged[:, 1] == merged[:, 2]) | (merged[:, 0] == merged[:, 2])
        _, first = np.unique(np.sort(merged[~is_flat], axis=1), axis=0, return_index=True)
        kept = merged[~is_flat][np.sort(first)]
        if len(kept) <= most_faces:
            break
    return means, kept
