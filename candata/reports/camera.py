"""Where a picture is taken from: a camera of the model's, or one fitted to what moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Name of the model camera that reports use when the model has it.
REPORT_CAMERA = "report"
#: Free space around a fitted picture, and how often its centre is corrected for perspective.
MARGIN, CENTRING_ROUNDS = 1.12, 4
#: The eight corners of a box, (8, 3).
SIGNS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T


@dataclass(frozen=True)
class View:
    """A free camera: it looks at `lookat` from `distance_m`; angles as MuJoCo's free camera has them."""

    lookat: tuple[float, float, float]
    distance_m: float
    azimuth_deg: float = 140.0
    elevation_deg: float = -22.0

    @property
    def forward(self) -> Array:
        """Unit vector along which the camera looks, `(3,) float64`."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return np.array(
            [
                math.cos(elevation) * math.cos(azimuth),
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
            ]
        )


@dataclass(frozen=True)
class Eye:
    """A pinhole: position (3,) [m], axes (3, 3) with columns right, up, back; vertical field [rad]."""

    position: Array
    axes: Array
    fovy_rad: float


def choose(model: mujoco.MjModel, qpos: Array, camera: str | View | None, aspect: float) -> str | View:
    """Return the camera to use: the one asked for, the model's `report`, or a fitted one.

    Parameters
    ----------
    model : mujoco.MjModel
    qpos : (K, nq) float64
        Positions that shall be in the picture.
    camera : str, View or None
        Name of a model camera, a free camera, or None to choose.
    aspect : float
        Width over height of the picture.
    """
    if camera is not None:
        return camera
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, REPORT_CAMERA) >= 0:
        return REPORT_CAMERA
    return fit(model, qpos, aspect)


def fit(model: mujoco.MjModel, qpos: Array, aspect: float) -> View:
    """Return the free camera that just holds all that moves over `qpos` (K, nq), centred."""
    points = _points(model, qpos)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    right, up, back = _axes(View((0.0, 0.0, 0.0), 1.0).forward).T
    tan_y = math.tan(math.radians(model.vis.global_.fovy) / 2)

    def needed(seen: Array) -> float:
        across = np.maximum(np.abs(seen @ right) / (tan_y * aspect), np.abs(seen @ up) / tan_y)
        return max(MARGIN * float(np.max(across + seen @ back)), 1e-3)

    for _ in range(CENTRING_ROUNDS):
        seen = points - centre
        depth = np.maximum(needed(seen) - seen @ back, 1e-6)
        for axis in (right, up):
            slope = (seen @ axis) / depth
            centre = centre + axis * needed(seen) * (slope.min() + slope.max()) / 2
    lookat = (float(centre[0]), float(centre[1]), float(centre[2]))
    return View(lookat, needed(points - centre))


def eye(model: mujoco.MjModel, data: mujoco.MjData, camera: str | View) -> Eye:
    """Return the pinhole of a camera in the state `data` (after `mj_forward`)."""
    if isinstance(camera, View):
        position = np.array(camera.lookat) - camera.distance_m * camera.forward
        return Eye(position, _axes(camera.forward), math.radians(model.vis.global_.fovy))
    number = model.camera(camera).id
    axes = data.cam_xmat[number].reshape(3, 3).copy()
    return Eye(data.cam_xpos[number].copy(), axes, math.radians(float(model.cam_fovy[number])))


def _axes(forward: Array) -> Array:
    """Return the columns right, up, back of a level camera that looks along `forward`."""
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), -forward], axis=1)


def _points(model: mujoco.MjModel, qpos: Array) -> Array:
    """Return the box corners (N, 3) [m] of the geoms that move, or of all bounded ones when none does."""
    bounded = model.geom_rbound > 0
    moving = bounded & (model.body_weldid[model.geom_bodyid] != 0)
    shown = np.flatnonzero(moving if moving.any() else bounded)
    if len(shown) == 0:
        return np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
    corners = model.geom_aabb[shown, None, :3] + SIGNS * model.geom_aabb[shown, None, 3:]
    data, found = mujoco.MjData(model), []
    for pose in qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        turn = data.geom_xmat[shown].reshape(-1, 3, 3)
        found.append(data.geom_xpos[shown, None] + np.einsum("gij,gcj->gci", turn, corners))
    return np.concatenate(found).reshape(-1, 3)
