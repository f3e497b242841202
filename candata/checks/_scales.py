"""Sizes of the values of each channel, one number an element."""

from __future__ import annotations

import numpy as np

from candata.checks._forces import forces
from candata.checks._signal import noise, white_noise
from candata.checks._view import EpisodeView

#: Channels whose scale is compared, all but flags, counts and clocks.
SCALED_CHANNELS = (
    "object_pose",
    "object_velocity",
    "joint_position",
    "joint_velocity",
    "joint_effort",
    "action",
    "hand_pose",
)


def scales(view: EpisodeView) -> dict[str, float]:
    """Return the size of what moves in each channel: `channel/element` to a positive number.

    A spread (between the 5 and 95 % quantiles) where it is clear of noise: constants say nothing of units, nor does a
    command under which its joint does not move. Forces by their median in contact; places also by their distance from
    the origin.
    """
    out: dict[str, float] = {}
    for channel in _scaled(view):
        values = view.complete_values(channel)
        if values is None:
            continue
        if channel in ("object_pose", "hand_pose"):
            out[f"{channel}/distance"] = float(np.nanmedian(np.linalg.norm(values[:, :3], axis=1)))
            values = values[:, :3]
        names = _names(view, channel, values.shape[1])
        low, high = np.nanquantile(values, [0.05, 0.95], axis=0)
        noise_levels = noise(values)
        for name, size, noise_level in zip(names, high - low, noise_levels, strict=True):
            if size > 10 * noise_level and size > 0:
                out[f"{channel}/{name}"] = float(size)
    joints = view.elements("joint_position") if view.complete_values("joint_position") is not None else ()
    still_joints = {name for name in joints if f"joint_position/{name}" not in out}
    out = {key: size for key, size in out.items() if not (key.startswith("action/") and key[7:] in still_joints)}
    force = forces(view)
    if force is not None and (force.touch & force.has_value).any():
        size = np.sqrt((force.xyz**2).sum(axis=2))
        out["fingertip_force/in contact"] = float(np.median(size[force.touch & force.has_value]))
    return _positive(out)


def _scaled(view: EpisodeView) -> tuple[str, ...]:
    """Return the channels whose scale is compared: those that an episode keeps in the source's unit are not."""
    unscaled = view.meta.unscaled if view.meta else ()
    return tuple(channel for channel in SCALED_CHANNELS if channel not in unscaled)


def _names(view: EpisodeView, channel: str, count: int) -> tuple[str, ...]:
    """Return the names of a channel's columns that are compared; their numbers where they have none."""
    names = view.elements(channel)
    return names if len(names) == count else tuple(map(str, range(count)))


def _positive(sizes: dict[str, float]) -> dict[str, float]:
    """Return the sizes that are numbers above zero."""
    return {name: value for name, value in sizes.items() if np.isfinite(value) and value > 0}


def reaches(view: EpisodeView) -> tuple[dict[str, float], dict[str, float]]:
    """Return how far the values of each element reach from zero, and their noise, by the keys of `scales`.

    A unit scales both with what moves; less motion scales neither. Noise is left out where there is none.
    """
    reach: dict[str, float] = {}
    noise_levels: dict[str, float] = {}
    for channel in (*_scaled(view), "fingertip_force"):
        values = view.complete_values(channel)
        if values is None:
            continue
        pose = channel in ("object_pose", "hand_pose")
        places = values[:, :3] if pose else values.reshape(len(values), -1)
        sizes = np.linalg.norm(places, axis=1, keepdims=True) + 0 * places if pose else np.abs(places)
        extents, column_noise = np.nanquantile(sizes, 0.95, axis=0), white_noise(places)
        if channel == "fingertip_force":
            reach[f"{channel}/in contact"], noise_levels[f"{channel}/in contact"] = (
                float(extents.max()),
                float(np.nanmedian(column_noise)),
            )
            continue
        names = _names(view, channel, places.shape[1])
        reach |= {f"{channel}/{name}": float(x) for name, x in zip(names, extents, strict=True)}
        noise_levels |= {f"{channel}/{name}": float(x) for name, x in zip(names, column_noise, strict=True)}
    return _positive(reach), _positive(noise_levels)
