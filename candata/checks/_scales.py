"""How large the values of each channel are, in one number an element."""

from __future__ import annotations

import numpy as np

from candata.checks._forces import forces
from candata.checks._signal import noise, white_noise
from candata.checks._view import View

#: Channels whose scale is compared, all but flags, counts and clocks.
COMPARED = ("object_pose", "object_velocity", "joint_position", "joint_velocity", "joint_effort", "action", "hand_pose")


def scales(view: View) -> dict[str, float]:
    """Return the size of what moves in each channel: `channel/element` to a positive number.

    A spread (between the 5 and 95 % quantiles) where it is clear of noise: constants say nothing of units, nor does a
    command under which its joint does not move. Forces by their median in contact; places also by their distance from
    the origin.
    """
    out: dict[str, float] = {}
    for channel in COMPARED:
        values = view.whole(channel)
        if values is None:
            continue
        if channel in ("object_pose", "hand_pose"):
            out[f"{channel}/distance"] = float(np.nanmedian(np.linalg.norm(values[:, :3], axis=1)))
            values = values[:, :3]
        names = _names(view, channel, values.shape[1])
        low, high = np.nanquantile(values, [0.05, 0.95], axis=0)
        quiet = noise(values)
        for name, size, still in zip(names, high - low, quiet, strict=True):
            if size > 10 * still and size > 0:
                out[f"{channel}/{name}"] = float(size)
    joints = view.elements("joint_position") if view.whole("joint_position") is not None else ()
    still_joints = {name for name in joints if f"joint_position/{name}" not in out}
    out = {key: size for key, size in out.items() if not (key.startswith("action/") and key[7:] in still_joints)}
    force = forces(view)
    if force is not None and (force.touch & force.seen).any():
        size = np.sqrt((force.xyz**2).sum(axis=2))
        out["fingertip_force/in contact"] = float(np.median(size[force.touch & force.seen]))
    return _positive(out)


def _names(view: View, channel: str, count: int) -> tuple[str, ...]:
    """Return the names of a channel's columns that are compared; their numbers where they have none."""
    named = view.elements(channel)
    return named if len(named) == count else tuple(map(str, range(count)))


def _positive(sizes: dict[str, float]) -> dict[str, float]:
    """Return the sizes that are numbers above zero."""
    return {name: value for name, value in sizes.items() if np.isfinite(value) and value > 0}


def reaches(view: View) -> tuple[dict[str, float], dict[str, float]]:
    """Return how far the values of each element reach from zero, and their noise, by the keys of `scales`.

    A unit scales both with what moves; less motion scales neither. Noise is left out where there is none.
    """
    reach: dict[str, float] = {}
    quiet: dict[str, float] = {}
    for channel in (*COMPARED, "fingertip_force"):
        values = view.whole(channel)
        if values is None:
            continue
        pose = channel in ("object_pose", "hand_pose")
        places = values[:, :3] if pose else values.reshape(len(values), -1)
        sizes = np.linalg.norm(places, axis=1, keepdims=True) + 0 * places if pose else np.abs(places)
        far, own = np.nanquantile(sizes, 0.95, axis=0), white_noise(places)
        if channel == "fingertip_force":
            reach[f"{channel}/in contact"], quiet[f"{channel}/in contact"] = float(far.max()), float(np.nanmedian(own))
            continue
        names = _names(view, channel, places.shape[1])
        reach |= {f"{channel}/{name}": float(x) for name, x in zip(names, far, strict=True)}
        quiet |= {f"{channel}/{name}": float(x) for name, x in zip(names, own, strict=True)}
    return _positive(reach), _positive(quiet)
