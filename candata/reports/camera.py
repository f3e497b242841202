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
    """Return the free camera that just holds all that moves over `qpos` (K, nq)."""
    low, high = _extent(model, qpos)
    centre = (low + high) / 2
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T - centre
    view = View(tuple(float(x) for x in centre), 1.0)
    right, up, back = _axes(view.forward).T
    tan_y = math.tan(math.radians(model.vis.global_.fovy) / 2)
    across = np.maximum(np.abs(corners @ right) / (tan_y * aspect), np.abs(corners @ up) / tan_y)
    distance = float(np.max(across + corners @ back))
    return View(view.lookat, max(1.08 * distance, 1e-3))


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


def _extent(model: mujoco.MjModel, qpos: Array) -> tuple[Array, Array]:
    """Return the corners (3,), (3,) [m] of the box around the geoms that move, or around all bounded ones."""
    bounded = model.geom_rbound > 0
    moving = bounded & (model.body_weldid[model.geom_bodyid] != 0)
    shown = np.flatnonzero(moving if moving.any() else bounded)
    if len(shown) == 0:
        return np.full(3, -0.5), np.full(3, 0.5)
    data, low, high = mujoco.MjData(model), np.full(3, np.inf), np.full(3, -np.inf)
    centre, half = model.geom_aabb[shown, :3], model.geom_aabb[shown, 3:]
    for pose in qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        turn = data.geom_xmat[shown].reshape(-1, 3, 3)
        middle = data.geom_xpos[shown] + np.einsum("gij,gj->gi", turn, centre)
        reach = np.einsum("gij,gj->gi", np.abs(turn), half)
        low, high = np.minimum(low, (middle - reach).min(axis=0)), np.maximum(high, (middle + reach).max(axis=0))
    return low, high
