"""Rule: poses are metres: objects move as fast, and lie as far away, as things do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._view import View
from candata.schema.channels import QUATERNION

#: Distance from the origin [m] beyond which a manipulated object, or a hand, is not expected.
FAR_M = 10.0
#: Speeds [m/s] that are doubtful and impossible: thrown by hand a ball leaves at 40 m/s at most.
FAST_MPS, IMPOSSIBLE_MPS = 20.0, 100.0
#: Share of the steps that must be as fast, beside at least three.
STEPS = 0.02
REMEDY = "give the unit in the map (`units: {object_pose: mm}`), or check the columns of the position"


def _episode(view: View) -> Iterator[Finding]:
    """Yield pose channels that lie or move like nothing does."""
    for channel in sorted(QUATERNION.keys() & view.raw.arrays.keys()):
        pose = view.whole(channel)
        if pose is None or view.time_s is None:
            continue
        place = pose[:, :3]
        far = np.abs(np.nan_to_num(place)).max(axis=1) > FAR_M
        speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(view.time_s)
        fast = np.r_[False, np.nan_to_num(speed) > FAST_MPS]
        many = fast.sum() >= max(3, STEPS * len(fast))
        largest = float(np.nanmax(np.abs(place)))
        if not many and far.mean() < 0.5:
            continue
        top = float(np.nanquantile(speed, 1 - STEPS / 2))
        level: Level = "error" if (many and top > IMPOSSIBLE_MPS) or largest > 10 * FAR_M else "warning"
        text = f"up to {largest:.3g} m from the origin, up to {top:.3g} m/s (as millimetres: {largest / 1e3:.3g} m)"
        yield view.finding(
            level, "pose_unit", "poses are no metres, or no poses", text, channel, far | fast if many else far, REMEDY,
            largest_m=largest, speed_mps=top,
        )  # fmt: skip


RULE = Rule(meaning="poses are metres", episode=_episode)
