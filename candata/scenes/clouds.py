"""Surface clouds: points on a scene's object, the same for the same shape and seed."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import SceneError
from candata.rotation import conjugate, rotate
from candata.scenes.assemble import Scene, subtree

Array = NDArray[np.float64]
POINTS, SEED = 512, 0


class _Surface(NamedTuple):
    """Area [m^2], and a function that draws n points on it, uniform over the area, in the geom's frame."""

    area: float
    draw: Callable[[int, np.random.Generator], Array]


def surface_cloud(scene: Scene, points: int = POINTS, seed: int = SEED) -> NDArray[np.float32]:
    """Return `(points, 3) float32 [m]` in the object's frame, uniform over the area of its surface.

    Parameters
    ----------
    scene : Scene
        The meshes of its object that collide with nothing are sampled: they are what a camera sees, whereas convex
        pieces fill hollows. Without such meshes its colliding geoms are; all of the object's where none collides.
    points, seed : int
        How many, and the seed of the sampling.

    Raises
    ------
    SceneError
        When the scene has no object, or none of its geoms has a surface.
    """
    if scene.object_id is None:
        raise SceneError(f"scene {scene.name} has no object", fix="name it: `object: BODY`")
    model, body = scene.model, scene.object_id
    all_geoms = np.flatnonzero(np.isin(model.geom_bodyid, list(subtree(model, body))))
    surfaces = {int(g): s for g in _seen_geoms(scene, all_geoms) if (s := _surface(model, int(g))) is not None}
    if not surfaces:
        raise SceneError(f"object {scene.file.object} has no surface", expected="a geom that is a solid")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rng = np.random.default_rng(seed)
    areas = np.array([s.area for s in surfaces.values()])
    counts = rng.multinomial(points, areas / areas.sum())
    world = [
        s.draw(n, rng) @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g]
        for n, (g, s) in zip(counts, surfaces.items(), strict=True)
    ]
    return rotate(conjugate(data.xquat[body]), np.concatenate(world) - data.xpos[body]).astype(np.float32)


def _seen_geoms(scene: Scene, geoms: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return those of the object's geoms that make its surface: visual meshes, else what collides, else all."""
    meshes = geoms[scene.model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH]
    visual_meshes = np.setdiff1d(meshes, scene.object_geoms)
    return next((g for g in (visual_meshes, scene.object_geoms) if len(g)), geoms)


def _surface(model: mujoco.MjModel, geom: int) -> _Surface | None:
    """Return the surface of a geom; None for planes and fields."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), np.array(model.geom_size[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom]))
    makers = {
        mujoco.mjtGeom.mjGEOM_BOX: _box,
        mujoco.mjtGeom.mjGEOM_SPHERE: lambda s: _ellipsoid(np.repeat(s[0], 3)),
        mujoco.mjtGeom.mjGEOM_ELLIPSOID: _ellipsoid,
        mujoco.mjtGeom.mjGEOM_CYLINDER: _cylinder,
        mujoco.mjtGeom.mjGEOM_CAPSULE: _capsule,
    }
    return makers[kind](size) if kind in makers else None


def _box(half_extents: Array) -> _Surface:
    """Return the surface of a box of half extents `half (3,)`."""
    faces = 8 * half_extents.prod() / half_extents

    def draw(n: int, rng: np.random.Generator) -> Array:
        points = rng.uniform(-half_extents, half_extents, (n, 3))
        axis = rng.choice(3, n, p=faces / faces.sum())
        points[np.arange(n), axis] = np.where(rng.random(n) < 0.5, -1, 1) * half_extents[axis]
        return points

    return _Surface(float(faces.sum()), draw)


def _directions(n: int, rng: np.random.Generator) -> Array:
    """Return `(n, 3)` unit vectors, uniform on the sphere."""
    vectors = rng.standard_normal((n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _ellipsoid(semi_axes: Array) -> _Surface:
    """Return the surface of an ellipsoid: the sphere's points, kept by how much it stretches the area there.

    Source: at direction u the area element is abc |u / (a, b, c)| times the sphere's; the whole area is
    K. Thomsen's formula (within 1.1 %, exact for a sphere).
    """
    exponent = 1.6075
    a, b, c = semi_axes**exponent
    area = 4 * np.pi * ((a * b + b * c + c * a) / 3) ** (1 / exponent)

    def draw(n: int, rng: np.random.Generator) -> Array:
        directions = np.zeros((0, 3))
        while len(directions) < n:
            u = _directions(max(n, 1), rng)
            share = np.linalg.norm(u / semi_axes, axis=1) * semi_axes.min()
            directions = np.concatenate([directions, u[rng.random(len(u)) < share]])
        return directions[:n] * semi_axes

    return _Surface(float(area), draw)


def _cylinder(size: Array) -> _Surface:
    """Return the surface of a cylinder of radius and half height `size[:2]`."""
    radius, half_height = size[:2]
    side, lid = 4 * np.pi * radius * half_height, np.pi * radius**2

    def draw(n: int, rng: np.random.Generator) -> Array:
        part = rng.choice(3, n, p=np.array([side, lid, lid]) / (side + 2 * lid))
        reach = np.where(part == 0, radius, radius * np.sqrt(rng.random(n)))
        height = np.choose(
            part, [rng.uniform(-half_height, half_height, n), np.full(n, half_height), np.full(n, -half_height)]
        )
        angle = rng.uniform(0, 2 * np.pi, n)
        return np.stack([reach * np.cos(angle), reach * np.sin(angle), height], axis=1)

    return _Surface(float(side + 2 * lid), draw)


def _capsule(size: Array) -> _Surface:
    """Return the surface of a capsule of radius and half length `size[:2]`."""
    radius, half_length = size[:2]
    side, caps = 4 * np.pi * radius * half_length, 4 * np.pi * radius**2

    def draw(n: int, rng: np.random.Generator) -> Array:
        ball = radius * _directions(n, rng)
        ball[:, 2] += np.copysign(half_length, ball[:, 2])
        angle = rng.uniform(0, 2 * np.pi, n)
        tube = [radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-half_length, half_length, n)]
        on_side = rng.random(n) < side / (side + caps)
        return np.where(on_side[:, None], np.stack(tube, axis=1), ball)

    return _Surface(float(side + caps), draw)


def _mesh(model: mujoco.MjModel, mesh: int) -> _Surface:
    """Return the surface of a mesh of the model."""
    v, f = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = np.array(model.mesh_vert[v : v + model.mesh_vertnum[mesh]], float)
    corner = vertices[model.mesh_face[f : f + model.mesh_facenum[mesh]]]
    first_edge, second_edge = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    areas = np.linalg.norm(np.cross(first_edge, second_edge), axis=1) / 2

    def draw(n: int, rng: np.random.Generator) -> Array:
        face = rng.choice(len(areas), n, p=areas / areas.sum())
        s, t = rng.random((2, n, 1))
        # Points beyond the diagonal of the parallelogram are turned back into the triangle.
        s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
        return corner[face, 0] + s * first_edge[face] + t * second_edge[face]

    return _Surface(float(areas.sum()), draw)
