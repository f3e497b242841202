"""Opposing points on a scene's object: rays from both sides along a line."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from candata.policies._contract import Array
from candata.scenes import Scene

#: Height to which the object is taken for the rays, so that they meet nothing else [m].
ALONE_M = 100.0


class Chords(NamedTuple):
    """Lines through the object, each between the two points where fingers from outside would meet it.

    Attributes
    ----------
    first, second : (n, 3) float64 [m]
        The points that a line meets first from its far end and from its near end, in the object's frame; NaN where it
        misses the object.
    alignment : (n,) float64
        Smaller cosine of the two angles between the line and the surface's normals: 1 is a line that fingers can press
        along without friction.
    """

    first: Array
    second: Array
    alignment: Array

    @property
    def width_m(self) -> Array:
        """`(n,)` distance of the two points [m]."""
        return np.linalg.norm(self.first - self.second, axis=1)


def chords(scene: Scene, points: Array, directions: Array) -> Chords:
    """Return the lines through points of the object.

    Parameters
    ----------
    scene : Scene
        Its object is met where it can be seen (MuJoCo's rays pass what is transparent).
    points, directions : (n, 3) float64
        In the object's frame: a point [m] on each line and its unit vector.
    """
    model = scene.model
    data = mujoco.MjData(model)
    data.qpos[scene.object_qpos : scene.object_qpos + 7] = (0, 0, ALONE_M, 1, 0, 0, 0)
    mujoco.mj_kinematics(model, data)
    origin = np.array([0, 0, ALONE_M])
    reach_m = 2 * float(np.linalg.norm(points, axis=1).max())
    ends, normals = np.full((2, *points.shape), np.nan), np.zeros((2, *points.shape))
    normal = np.zeros(3)
    for i, (point, direction) in enumerate(zip(points, directions, strict=True)):
        for side, outward in enumerate((direction, -direction)):
            start = point + reach_m * outward
            distance_m = mujoco.mj_ray(model, data, origin + start, -outward, None, True, -1, None, normal)
            if 0 <= distance_m <= 2 * reach_m:
                ends[side, i], normals[side, i] = start - distance_m * outward, normal
    cosines = np.stack([(normals[0] * directions).sum(1), -(normals[1] * directions).sum(1)])
    return Chords(ends[0], ends[1], cosines.min(0))
