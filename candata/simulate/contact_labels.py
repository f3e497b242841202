"""Labels of contact from the simulation's own contacts: who meets the object, and what each taxel feels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.rotation import conjugate, rotate
from candata.scenes import Scene

Array = NDArray[np.float64]
Groups = Sequence[tuple[int, NDArray[np.int64]]]
#: Taxels of a fingertip, and force that one count stands for [N]. Source: the XHand's wire
#: (`candata.record.devices.xhand`).
TAXELS, NEWTON_PER_COUNT = 120, 0.1
#: Angle over which a contact's force falls to exp(-1/2) around it [rad]. Chosen: about the distance of neighbouring
#: taxels, sqrt(4 pi / 120), so that a point contact presses some ten of them.
SPREAD_RAD = 0.33


def row_labels(scene: Scene, groups: Groups, sensor_data: Sequence[list[Array]], instant: bool) -> dict[str, NDArray]:
    """Return the labels of R rows together, `(R, n, ...)` each, as `read_labels` gives them; none of a plain scene.

    Parameters
    ----------
    scene : Scene
    groups : sequence of (int, ndarray)
        Number of physics steps a row, and the simulations that take so many; together all n.
    sensor_data : sequence of R lists
        What the sensors of each group read, `(m, S, nsensordata)`.
    instant : bool
        As in `read_labels`.
    """
    labels: dict[str, NDArray] = {}
    if not (len(scene.collision_sensors) or len(scene.contact_sensors)):
        return labels
    count = sum(len(ids) for _, ids in groups)
    for (_, ids), group_data in zip(groups, zip(*sensor_data, strict=True), strict=True):
        for name, value in read_labels(scene, np.stack(group_data), instant).items():
            shape = (len(sensor_data), count, *value.shape[2:])
            labels.setdefault(name, np.zeros(shape, value.dtype))[:, ids] = value
    return labels


def label_channels(labels: dict[str, NDArray], force: Array | None) -> dict[str, NDArray]:
    """Return the channels of an episode from its labels `(T, ...)` and its fingertips' forces `(T, F, 3)` [N]."""
    channels = {}
    if "collision" in labels:
        channels["fingertip_collision"] = labels["collision"]
    if "taxel_force" in labels and force is not None:
        channels["taxels"] = taxel_counts(labels["taxel_force"], force)
    return channels


def read_labels(scene: Scene, data: Array, instant: bool) -> dict[str, NDArray]:
    """Return the labels of some rows.

    Parameters
    ----------
    scene : Scene
        With labels.
    data : (R, m, S, nsensordata) float64
        What the sensors read at each of S physics steps before R rows of m simulations.
    instant : bool
        Whether forces are those of the last physics step instead of the mean.

    Returns
    -------
    dict of str to ndarray
        `collision (R, m, F) bool`: whether a geom of the fingertip met the object in the step before the row.
        `taxel_force (R, m, F, N, 3) float32 [N]`, of a scene with taxels: what they feel, in the fingertip's frame.
    """
    labels: dict[str, NDArray] = {}
    if len(scene.collision_sensors):
        labels["collision"] = np.asarray((data[..., scene.collision_sensors] > 0).any(2))
    if len(scene.contact_sensors):
        labels["taxel_force"] = _taxel_force(scene, data[:, :, -1:] if instant else data)
    return labels


def taxel_counts(taxel_force: NDArray, force: NDArray) -> NDArray[np.int16]:
    """Return `(..., N, 3) int16` counts of taxels that sum to a fingertip's reading, within half a count.

    What the reading holds beyond the contacts (noise, bias, gain) is spread like their forces, evenly without contact.
    Counts are differences of rounded running sums, so that rounding does not pile up over the taxels.

    Parameters
    ----------
    taxel_force : ndarray
        `(..., N, 3) float [N]`, as `read_labels` returns it.
    force : ndarray
        `(..., 3) float [N]`, the fingertip's reading.
    """
    counts = np.zeros(taxel_force.shape, np.int16)
    is_felt = taxel_force.any(axis=(-2, -1)) | np.rint(force / NEWTON_PER_COUNT).any(axis=-1)
    taxel_force, force = taxel_force[is_felt], force[is_felt]  # elsewhere all counts are 0
    x, y, z = np.abs(np.moveaxis(taxel_force, -1, 0))
    size = x + y + z
    total = size.sum(axis=-1, keepdims=True)
    share = np.divide(size, total, out=np.full_like(size, 1 / TAXELS), where=total > 0)
    rest = (force - taxel_force.sum(axis=-2))[:, None]
    sums = np.rint(np.cumsum(taxel_force + share[..., None] * rest, axis=-2) / NEWTON_PER_COUNT)
    sums[:, 1:] -= sums[:, :-1].copy()
    limits = np.iinfo(np.int16)
    counts[is_felt] = sums.clip(limits.min, limits.max)
    return counts


def taxel_directions(count: int = TAXELS) -> Array:
    """Return `(count, 3)` unit vectors spread evenly over a sphere: where the taxels lie, seen from the middle.

    Notes
    -----
    The places of the XHand's taxels are not published. A Fibonacci lattice serves fingertips of any shape.
    Source: A. Gonzalez, Measurement of areas on a sphere using Fibonacci and latitude-longitude lattices, 2010, sec. 3.
    """
    height = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


@lru_cache(maxsize=4)
def _middles(scene: Scene) -> Array:
    """Return the middle of each fingertip's geoms from its body's origin, in the frame of its forces, `(F, 3)` [m]."""
    model, sites = scene.model, scene.file.fingertip_frames
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    middles = []
    for tip, (geoms, body) in enumerate(zip(scene.fingertip_geoms, scene.fingertip_bodies, strict=True)):
        axes = (data.site(sites[tip]).xmat if sites else data.xmat[body]).reshape(3, 3)
        middles.append((data.geom_xpos[geoms].mean(axis=0) - data.xpos[body]) @ axes)
    return np.array(middles)


def _taxel_force(scene: Scene, data: Array) -> NDArray[np.float32]:
    """Return what the taxels feel, in the mean over physics steps: each contact's force spread about its place.

    A taxel's share is a Gaussian of the angle between it and the contact, seen from the middle of the fingertip.
    """
    contacts = data[..., scene.contact_sensors].swapaxes(2, 3)  # a fingertip's contacts of all steps side by side
    row, simulation, tip, step, slot = np.nonzero(contacts[..., 6:9].any(axis=-1))
    taxel_force = np.zeros((*contacts.shape[:3], TAXELS, 3), np.float32)
    if not len(row):
        return taxel_force
    in_contact_frame, place, normal, tangent = np.split(contacts[row, simulation, tip, step, slot], 4, axis=1)
    axes = np.stack([normal, tangent, np.cross(normal, tangent)], axis=1)
    at = row[:, None], simulation[:, None], step[:, None]
    to_tip = conjugate(data[(*at, scene.frame_sensors[tip])])
    force = rotate(to_tip, np.einsum("ki,kij->kj", in_contact_frame, axes)) / data.shape[2]
    offset = rotate(to_tip, place - data[(*at, scene.place_sensors[tip])]) - _middles(scene)[tip]
    distance = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), np.finfo(float).tiny)
    cosine = (offset / distance) @ taxel_directions().T
    share = np.exp((cosine - 1).astype(np.float32) / SPREAD_RAD**2)
    share /= share.sum(axis=1, keepdims=True)
    key = np.ravel_multi_index((row, simulation, tip), contacts.shape[:3])
    first = np.flatnonzero(np.diff(key, prepend=-1))
    felt = np.add.reduceat(share[:, :, None] * force[:, None].astype(np.float32), first)
    taxel_force.reshape(-1, TAXELS, 3)[key[first]] = felt
    return taxel_force
