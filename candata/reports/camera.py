"""Cameras of pictures: one of the model's, or one fitted to what moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Name of the model camera that reports use when the model has it.
REPORT_CAMERA = "report"
#: Free space around a fitted picture, and how often its centre is corrected for perspective.
MARGIN, CENTRING_ROUNDS = 1.12, 4
#: Geom groups that MuJoCo's viewers show by default: those below this number.
SHOWN_GROUPS = 3
#: Views that are tried, as azimuth and elevation [deg] of MuJoCo's free camera, the usual one first. Chosen: three
#: quarters from each side, then the same from higher up.
VIEWS = tuple((azimuth, elevation) for elevation in (-22.0, -50.0) for azimuth in (140.0, 50.0, 230.0, 320.0))
#: Poses at which views are compared, and how much more of the object another view must show than the usual one [of 1].
COMPARED_POSES, CLEARLY_MORE = 6, 0.15
#: Points of a geom that are looked for: its centre and the corners of its box, this far out [of 1]. Chosen: they lie
#: inside of a cylinder or an ellipsoid too.
LOOKED_FOR = 0.5
#: The eight corners of a box, (8, 3).
SIGNS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T


@dataclass(frozen=True)
class FreeCamera:
    """A free camera: it looks at `lookat` from `distance_m`; angles as MuJoCo's free camera has them."""

    lookat: tuple[float, float, float]
    distance_m: float
    azimuth_deg: float = 140.0
    elevation_deg: float = -22.0

    @property
    def direction(self) -> Array:
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
class Pinhole:
    """A pinhole: position (3,) [m], axes (3, 3) with columns right, up, back; vertical field [rad]."""

    position: Array
    axes: Array
    fovy_rad: float


def choose_camera(
    model: mujoco.MjModel, qpos: Array, camera: str | FreeCamera | None, aspect: float
) -> str | FreeCamera:
    """Return the camera to use: `camera` when it is given, the model's `report`, or a fitted one.

    Parameters
    ----------
    model : mujoco.MjModel
    qpos : (K, nq) float64
        Positions that the picture must hold.
    camera : str, FreeCamera or None
        Name of a model camera, a free camera, or None to choose.
    aspect : float
        Width over height of the picture.
    """
    if camera is not None:
        return camera
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, REPORT_CAMERA) >= 0:
        return REPORT_CAMERA
    cameras = [fit_camera(model, qpos, aspect, view) for view in VIEWS]
    shares = _seen_shares(model, qpos, cameras)
    clearest = int(np.argmax(shares))
    return cameras[clearest if shares[clearest] > shares[0] + CLEARLY_MORE else 0]


def fit_camera(model: mujoco.MjModel, qpos: Array, aspect: float, view: tuple[float, float] = VIEWS[0]) -> FreeCamera:
    """Return the free camera that just holds all that moves over `qpos` (K, nq), centred.

    `view` is its azimuth and elevation [deg].
    """
    points = _points(model, qpos)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    right_axis, up_axis, back_axis = _axes(FreeCamera((0.0, 0.0, 0.0), 1.0, *view).direction).T
    tan_y = math.tan(math.radians(model.vis.global_.fovy) / 2)

    def distance_to_hold(offsets: Array) -> float:
        depths = np.maximum(np.abs(offsets @ right_axis) / (tan_y * aspect), np.abs(offsets @ up_axis) / tan_y)
        return max(MARGIN * float(np.max(depths + offsets @ back_axis)), 1e-3)

    for _ in range(CENTRING_ROUNDS):
        offsets = points - centre
        distance = distance_to_hold(offsets)
        depth = np.maximum(distance - offsets @ back_axis, 1e-6)
        for axis in (right_axis, up_axis):
            slope = (offsets @ axis) / depth
            centre = centre + axis * distance * (slope.min() + slope.max()) / 2
    lookat = (float(centre[0]), float(centre[1]), float(centre[2]))
    return FreeCamera(lookat, distance_to_hold(points - centre), *view)


def _seen_shares(model: mujoco.MjModel, qpos: Array, cameras: Sequence[FreeCamera]) -> Array:
    """Return how much of what moves freely each camera sees over `qpos` (K, nq), `(len(cameras),)` of 1.

    All zero in a model without a body that moves freely.
    """
    free_bodies = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    is_object = np.isin(model.geom_bodyid, free_bodies)
    geoms = np.flatnonzero(is_object & (model.geom_group < SHOWN_GROUPS) & (model.geom_rbound > 0))
    shares = np.zeros(len(cameras))
    if len(geoms) == 0:
        return shares
    data = mujoco.MjData(model)
    shown_groups = (np.arange(mujoco.mjNGROUP) < SHOWN_GROUPS).astype(np.uint8)
    chosen = np.unique(np.linspace(0, len(qpos) - 1, COMPARED_POSES).round().astype(int))
    for pose in qpos[chosen]:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        offsets = np.concatenate([np.zeros((1, 3)), LOOKED_FOR * SIGNS])
        boxes = model.geom_aabb[geoms, None, :3] + offsets * model.geom_aabb[geoms, None, 3:]
        turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
        targets = (data.geom_xpos[geoms, None] + np.einsum("gij,gcj->gci", turn, boxes)).reshape(-1, 3)
        for k, camera in enumerate(cameras):
            position = np.array(camera.lookat) - camera.distance_m * camera.direction
            rays = (targets - position).ravel()
            hit, distance = np.empty(len(targets), np.int32), np.empty(len(targets))
            mujoco.mj_multiRay(
                model, data, position, rays, shown_groups, True, -1, hit, distance, None, len(targets), 1e6
            )
            shares[k] += np.mean((hit >= 0) & is_object[hit]) / len(chosen)
    return shares


def pinhole(model: mujoco.MjModel, data: mujoco.MjData, camera: str | FreeCamera) -> Pinhole:
    """Return the pinhole of a camera in the state `data` (after `mj_forward`)."""
    if isinstance(camera, FreeCamera):
        position = np.array(camera.lookat) - camera.distance_m * camera.direction
        return Pinhole(position, _axes(camera.direction), math.radians(model.vis.global_.fovy))
    number = model.camera(camera).id
    axes = data.cam_xmat[number].reshape(3, 3).copy()
    return Pinhole(data.cam_xpos[number].copy(), axes, math.radians(float(model.cam_fovy[number])))


def _axes(direction: Array) -> Array:
    """Return the columns right, up, back of a level camera that looks along `direction`."""
    right_axis = np.cross(direction, [0.0, 0.0, 1.0])
    right_axis /= np.linalg.norm(right_axis)
    return np.stack([right_axis, np.cross(right_axis, direction), -direction], axis=1)


def _points(model: mujoco.MjModel, qpos: Array) -> Array:
    """Return the box corners (N, 3) [m] of the geoms that move, or of all bounded ones when none does."""
    is_bounded = model.geom_rbound > 0
    is_moving = is_bounded & (model.body_weldid[model.geom_bodyid] != 0)
    geoms = np.flatnonzero(is_moving if is_moving.any() else is_bounded)
    if len(geoms) == 0:
        return np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
    corners = model.geom_aabb[geoms, None, :3] + SIGNS * model.geom_aabb[geoms, None, 3:]
    data, points = mujoco.MjData(model), []
    for pose in qpos:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
        points.append(data.geom_xpos[geoms, None] + np.einsum("gij,gcj->gci", turn, corners))
    return np.concatenate(points).reshape(-1, 3)
