"""Pictures without a GL library: MuJoCo's own ray casting, a sun and its shadow."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.reports.camera import Eye, View, eye
from candata.reports.png import Image

Array = NDArray[np.float64]

#: Geom groups that MuJoCo's viewers show by default: 0 to 2.
SHOWN_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
#: Colours of the drawing: sky, and the two of an untextured plane's tiles.
SKY, TILES = (0.93, 0.94, 0.95), np.array([[0.86, 0.87, 0.88], [0.80, 0.81, 0.83]])
#: Direction towards the sun (unit length) and what reaches a place in its shadow.
SUN, SHADE = np.array([0.32, -0.48, 0.817]), 0.55


def draw(model: mujoco.MjModel, qpos: Array, camera: str | View, width: int, height: int) -> list[Image]:
    """Return one picture (height, width, 3) uint8 of each row of `qpos` (K, nq)."""
    data, frames = mujoco.MjData(model), []
    for pose in qpos:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        frames.append(_frame(model, data, eye(model, data, camera), width, height))
    return frames


def _frame(model: mujoco.MjModel, data: mujoco.MjData, pinhole: Eye, width: int, height: int) -> Image:
    """Return the picture of one state, averaged over a 2 x 2 grid of rays a pixel."""
    rays = _directions(pinhole, 2 * width, 2 * height)
    geom, distance, normal = _cast(model, data, pinhole.position, rays)
    colour = np.tile(np.array(SKY), (len(rays), 1))
    hit = geom >= 0
    points = pinhole.position + rays[hit] * distance[hit, None]
    colour[hit] = _shaded(model, data, geom[hit], points, normal[hit])
    colour = colour.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
    return np.round(255 * colour.clip(0, 1)).astype(np.uint8)


def _directions(pinhole: Eye, width: int, height: int) -> Array:
    """Return unit rays (height * width, 3) through the middle of each cell, row by row."""
    reach = np.tan(pinhole.fovy_rad / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * reach * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * reach
    grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1).reshape(-1, 3)
    rays = grid @ pinhole.axes.T
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _cast(
    model: mujoco.MjModel, data: mujoco.MjData, start: Array, rays: Array
) -> tuple[NDArray[np.int32], Array, Array]:
    """Return the first geom hit by each ray (-1: none), its distance [m] and its normal (N, 3)."""
    geom, distance = np.empty(len(rays), np.int32), np.empty(len(rays))
    normal = np.zeros(rays.size)
    mujoco.mj_multiRay(
        model, data, start, rays.ravel(), SHOWN_GROUPS, True, -1, geom, distance, normal, len(rays), 1e6
    )
    return geom, distance, normal.reshape(-1, 3)


def _shaded(
    model: mujoco.MjModel, data: mujoco.MjData, geom: NDArray[np.int32], points: Array, normal: Array
) -> Array:
    """Return the colours (N, 3) of the points hit: their geom's, lit by the sun or in shadow."""
    far = 20 * max(float(model.stat.extent), 0.1)
    sun = points.mean(axis=0) + far * SUN if len(points) else SUN
    way = points - sun
    length = np.linalg.norm(way, axis=1)
    _, reached, _ = _cast(model, data, sun, way / length[:, None])
    lit = reached > length * (1 - 1e-4)
    facing = np.clip(normal @ SUN, 0, 1)
    light = SHADE + (1 - SHADE) * np.where(lit, facing, 0.0) + 0.1 * normal[:, 2]
    return _base_colour(model, data, geom, points) * light[:, None]


def _base_colour(model: mujoco.MjModel, data: mujoco.MjData, geom: NDArray[np.int32], points: Array) -> Array:
    """Return each point's own colour (N, 3): the material's or geom's, tiles on a plane."""
    material = model.geom_matid[geom]
    rgba = np.where(
        (material >= 0)[:, None], model.mat_rgba[material] if model.nmat else 0, model.geom_rgba[geom]
    )
    colour = np.array(rgba[:, :3], float)
    plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
    tile = max(float(model.stat.extent), 0.1) / 8
    cells = np.floor(points[plane, :2] / tile).astype(int).sum(axis=1) % 2
    colour[plane] = TILES[cells]
    return colour
