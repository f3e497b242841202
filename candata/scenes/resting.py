"""How an object rests on a level plane: dropped from many attitudes, and sorted by which side is up."""

from __future__ import annotations

from copy import copy

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist, squareform

from candata.rotation import conjugate, difference, exp, normalise, rotate
from candata.schema.object import RestingPose

Array = NDArray[np.float64]
#: Drops from random attitudes: a share of 10 % is known to 2 %. A drop of a YCB object takes a few milliseconds.
DROPS, SEED = 200, 0
#: Gap under the lowest point at the start [m]: what decides is the attitude, not the fall.
GAP_M = 1e-3
#: Up-directions at most this far apart are of one resting pose [rad]. Chosen: neighbouring faces of a die with 20 faces
#: are 0.73 apart; 150 drops of a lying can leave no larger gap around it (150 random angles: 0.21 expected).
LINK_RAD = np.deg2rad(20)
#: A drop rests when it moves and turns no faster than this [m/s, rad/s] from one look to the next, so many times in a
#: row: on an edge, a slow fall grows twentyfold meanwhile. Light things tremble in their contacts, and stay in place.
STILL, LOOK_S, LOOKS, LONGEST_S = 0.01, 0.1, 3, 10.0
#: Sine of the tilt below which the axis of a turn upside down is noise.
LEVEL = 1e-3
#: Time in which viscous drag slows the object to 1/e [s]: without it balls roll for ever. Rolling friction would stop
#: them too, but holds an object on an edge.
DRAG_S = 0.5
#: Attitudes that are tried beside the random ones: the frame's axes up and down. What stands on a small base is seldom
#: found by chance.
_SIDES = (
    *((1, 0, 0, 0), (0, 1, 0, 0)),
    *((0.5**0.5, 0.5**0.5, 0, 0), (0.5**0.5, -(0.5**0.5), 0, 0)),
    *((0.5**0.5, 0, 0.5**0.5, 0), (0.5**0.5, 0, -(0.5**0.5), 0)),
)


def resting_poses(model: mujoco.MjModel, drops: int = DROPS, seed: int = SEED) -> tuple[RestingPose, ...]:
    """Return the poses in which an object comes to rest, the likeliest first; none where it never rests.

    Probabilities are shares of the random drops that rested; a pose that only a drop from one of the frame's six sides
    found has 0.

    Parameters
    ----------
    model : mujoco.MjModel
        A plane, geom 0, and one free body; see `plane_scene`.
    drops, seed : int
        Drops from random attitudes, and the seed of these.
    """
    model = with_drag(model)
    random = normalise(np.random.default_rng(seed).standard_normal((drops, 4)))
    ends = [_drop(model, attitude) for attitude in (*random, *np.array(_SIDES, float))]
    is_random = np.array([i < drops for i, end in enumerate(ends) if end is not None])
    poses = np.array([end for end in ends if end is not None]).reshape(-1, 7)
    if not len(poses):
        return ()
    ups = rotate(conjugate(poses[:, 3:]), np.array([0.0, 0.0, 1.0]))
    rests = [_rest(poses[at, 2], ups[at], is_random[at].sum() / max(1, is_random.sum())) for at in _clusters(ups)]
    return tuple(sorted(rests, key=lambda rest: (-rest.probability, rest.tilt_rad)))


def with_drag(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of the model of one free body with viscous drag, which brings round things to rest.

    It changes no pose of equilibrium.
    """
    dragged_model = copy(model)
    dragged_model.dof_damping[:3] = model.body_mass[1] / DRAG_S
    dragged_model.dof_damping[3:6] = model.body_inertia[1].max() / DRAG_S
    return dragged_model


def _drop(model: mujoco.MjModel, attitude: Array) -> Array | None:
    """Return the pose `(7,)` in which a drop ends; None where it does not come to rest."""
    data = mujoco.MjData(model)
    # Far above the plane all distances are positive; then the lowest point is brought to the gap.
    reach = 2 * float(np.max(model.geom_rbound[1:] + np.linalg.norm(model.geom_pos[1:], axis=1)))
    data.qpos[:] = (0, 0, reach, *attitude)
    mujoco.mj_kinematics(model, data)
    touching = np.flatnonzero(model.geom_contype[1:]) + 1
    data.qpos[2] -= min(mujoco.mj_geomDistance(model, data, 0, g, 2 * reach, None) for g in touching) - GAP_M
    steps = max(1, round(LOOK_S / model.opt.timestep))
    still_looks, earlier = 0, np.array(data.qpos)
    for _ in range(round(LONGEST_S / LOOK_S)):
        mujoco.mj_step(model, data, nstep=steps)
        pose = np.array(data.qpos)
        moved, turned = pose[:3] - earlier[:3], difference(pose[3:], earlier[3:])
        is_still = max(np.abs(moved).max(), np.abs(turned).max()) < STILL * LOOK_S
        still_looks, earlier = still_looks + 1 if is_still else 0, pose
        if still_looks == LOOKS:
            return pose
    return None


def _clusters(ups: Array) -> list[NDArray[np.intp]]:
    """Return the rows of each group of up-directions `(n, 3)` that lead to one another in steps of `LINK_RAD`."""
    if len(ups) == 1:
        return [np.array([0])]
    labels = fcluster(linkage(ups, "single"), 2 * np.sin(LINK_RAD / 2), "distance")
    return [np.flatnonzero(labels == label) for label in np.unique(labels)]


def _rest(heights_m: Array, ups: Array, probability: float) -> RestingPose:
    """Return the pose of a group: that of its middle member, turned the shortest way from the frame as it is."""
    middle = int(np.argmin(squareform(pdist(ups)).sum(1)))
    up = ups[middle]
    tilt = float(np.arccos(np.clip(up[2], -1, 1)))
    axis = np.array([up[1], -up[0], 0.0])
    length = float(np.linalg.norm(axis))
    # Upside down, any axis does: the frame's x.
    turn = exp(tilt * (axis / length if length > LEVEL else np.array([1.0, 0, 0])))
    return RestingPose(
        quaternion=tuple(np.round(turn, 9).tolist()),
        height_m=round(float(heights_m[middle]), 6),
        probability=round(float(probability), 4),
        tilt_rad=round(tilt, 6),
    )
