"""Pictures without a GL library: MuJoCo's own ray casting, a sun and its shadow."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.reports.camera import SHOWN_GROUPS, FreeCamera, Pinhole, pinhole
from candata.reports.ghost import CLEARANCE_M, OPACITY, Ghost, ghost_geoms, ghost_model, show_parted
from candata.reports.png import Image

Array = NDArray[np.float64]

#: Whether a ray sees the geoms of a group, by group.
SEEN_GROUPS = (np.arange(mujoco.mjNGROUP) < SHOWN_GROUPS).astype(np.uint8)
#: Colours of the drawing: sky, and the two tiles of a plane (they shade a plane that has its own colour).
SKY, TILES = (0.93, 0.94, 0.95), np.array([[0.86, 0.87, 0.88], [0.80, 0.81, 0.83]])
#: Direction towards the sun (unit length) and the light that reaches a place in its shadow.
SUN, SHADE = np.array([0.32, -0.48, 0.817]), 0.55
#: Difference between neighbours (of 1) from which a pixel is drawn with four rays.
EDGE = 0.03


def draw(
    model: mujoco.MjModel,
    qpos: Array,
    camera: str | FreeCamera,
    width: int,
    height: int,
    ghost: Ghost | None = None,
) -> list[Image]:
    """Return one picture (height, width, 3) uint8 of each row of `qpos` (K, nq), with the ghost of that row."""
    data, frames = mujoco.MjData(model), []
    alone = None if ghost is None else ghost_model(model, ghost)
    ghost_data = None if alone is None else mujoco.MjData(alone)
    geoms = np.zeros(0, np.intp) if alone is None else ghost_geoms(alone)
    for row, pose in enumerate(qpos):
        states = [(model, _forward(model, data, pose))]
        if ghost is not None and np.isfinite(ghost.qpos[row]).all():
            states.append((alone, _forward(alone, ghost_data, ghost.qpos[row])))
            show_parted(alone, geoms, ghost_data, data)
        frames.append(_frame(states, pinhole(model, data, camera), width, height))
    return frames


def _forward(model: mujoco.MjModel, data: mujoco.MjData, pose: Array) -> mujoco.MjData:
    """Return `data` with everything where the positions `pose` put it."""
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    return data


def _frame(states: list[tuple[mujoco.MjModel, mujoco.MjData]], camera: Pinhole, width: int, height: int) -> Image:
    """Return the picture of one state, a ghost's last: a ray a pixel, four where the picture has an edge."""
    x, y = (side.ravel() for side in np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5))

    def colours_at(dx: float, dy: float, pixels: NDArray[np.intp]) -> Array:
        rays = _directions(camera, x[pixels] + dx, y[pixels] + dy, width, height)
        return _colours(states, camera.position, rays)

    colour = colours_at(0.0, 0.0, np.arange(width * height))
    edges = np.flatnonzero(_is_edge(colour.reshape(height, width, 3)))
    if len(edges):
        corners = [colours_at(dx, dy, edges) for dx in (-0.25, 0.25) for dy in (-0.25, 0.25)]
        colour[edges] = np.mean(corners, axis=0)
    return np.round(255 * colour.clip(0, 1)).astype(np.uint8).reshape(height, width, 3)


def _is_edge(colour: Array) -> NDArray[np.bool_]:
    """Return where a pixel of (H, W, 3) differs visibly from one beside, above or below it, `(H, W)`."""
    row_edges = np.abs(np.diff(colour, axis=0)).max(axis=2) > EDGE
    column_edges = np.abs(np.diff(colour, axis=1)).max(axis=2) > EDGE
    is_edge = np.zeros(colour.shape[:2], bool)
    is_edge[1:] |= row_edges
    is_edge[:-1] |= row_edges
    is_edge[:, 1:] |= column_edges
    is_edge[:, :-1] |= column_edges
    return is_edge


def _directions(camera: Pinhole, x: Array, y: Array, width: int, height: int) -> Array:
    """Return unit rays (N, 3) through the places `x`, `y` (pixels from the upper left corner)."""
    half_height = np.tan(camera.fovy_rad / 2)
    image_x, image_y = (2 * x / width - 1) * half_height * width / height, (1 - 2 * y / height) * half_height
    rays = np.stack([image_x, image_y, np.full(len(x), -1.0)], axis=-1) @ camera.axes.T
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _colours(states: list[tuple[mujoco.MjModel, mujoco.MjData]], start: Array, rays: Array) -> Array:
    """Return the colours (N, 3) that rays from `start` see: those of the first state, the others' through them."""
    colour, nearest = np.tile(np.array(SKY), (len(rays), 1)), np.full(len(rays), np.inf)
    for (model, data), opacity in zip(states, (1.0, OPACITY), strict=False):
        geom, distance, normal = _cast(model, data, start, rays)
        hit = (geom >= 0) & (distance < nearest - CLEARANCE_M)
        points = start + rays[hit] * distance[hit, None]
        lit_colour = _lit_colours(model, data, geom[hit], points, normal[hit])
        colour[hit] = opacity * lit_colour + (1 - opacity) * colour[hit]
        nearest[hit] = distance[hit]
    return colour


def _cast(
    model: mujoco.MjModel, data: mujoco.MjData, start: Array, rays: Array
) -> tuple[NDArray[np.int32], Array, Array]:
    """Return the first geom hit by each ray (-1: none), its distance [m] and its normal (N, 3)."""
    geom, distance = np.empty(len(rays), np.int32), np.empty(len(rays))
    normal = np.zeros(rays.size)
    mujoco.mj_multiRay(model, data, start, rays.ravel(), SEEN_GROUPS, True, -1, geom, distance, normal, len(rays), 1e6)
    return geom, distance, normal.reshape(-1, 3)


def _lit_colours(
    model: mujoco.MjModel, data: mujoco.MjData, geom: NDArray[np.int32], points: Array, normal: Array
) -> Array:
    """Return the colours (N, 3) of the points hit: their geom's, lit by the sun or in shadow."""
    sun_distance = 20 * max(float(model.stat.extent), 0.1)
    sun = points.mean(axis=0) + sun_distance * SUN if len(points) else SUN
    offsets = points - sun
    length = np.linalg.norm(offsets, axis=1)
    _, hit_distance, _ = _cast(model, data, sun, offsets / length[:, None])
    in_sun = hit_distance > length * (1 - 1e-4)
    incidence = np.clip(normal @ SUN, 0, 1)
    light = SHADE + (1 - SHADE) * np.where(in_sun, incidence, 0.0) + 0.1 * normal[:, 2]
    return _base_colour(model, data, geom, points) * light[:, None]


def _base_colour(model: mujoco.MjModel, data: mujoco.MjData, geom: NDArray[np.int32], points: Array) -> Array:
    """Return the unlit colour of each point (N, 3): the material's or geom's, tiles on a plane."""
    material = model.geom_matid[geom]
    rgba = np.where((material >= 0)[:, None], model.mat_rgba[material] if model.nmat else 0, model.geom_rgba[geom])
    colour = np.array(rgba[:, :3], float)
    plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
    tile = max(float(model.stat.extent), 0.1) / 8
    cells = np.floor(points[plane, :2] / tile).astype(int).sum(axis=1) % 2
    has_default_colour = np.all(np.abs(colour[plane] - 0.5) < 1e-3, axis=1)
    colour[plane] = np.where(has_default_colour[:, None], TILES[cells], colour[plane] * TILES[cells] / TILES.max())
    return colour
