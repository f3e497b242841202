"""How large the values of each channel are, in one number an element."""

from __future__ import annotations

import numpy as np

from candata.checks._forces import forces
from candata.checks._signal import noise
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
        named = view.elements(channel)
        names = named if len(named) == values.shape[1] else tuple(map(str, range(values.shape[1])))
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
    return {name: value for name, value in out.items() if np.isfinite(value) and value > 0}
