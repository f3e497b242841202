"""Rule: poses are metres: objects move as fast, and lie as far away, as things do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._view import EpisodeView
from candata.schema.channels import QUATERNION

#: Distance from the origin [m] beyond which a manipulated object, or a hand, is not expected.
FAR_M = 10.0
#: Speeds [m/s] that are doubtful and impossible: thrown by hand a ball leaves at 40 m/s at most.
FAST_MPS, IMPOSSIBLE_MPS = 20.0, 100.0
#: Share of the steps that must be as fast, beside at least three.
STEPS = 0.02
REMEDY = "give the unit in the map (`units: {object_pose: mm}`), or check the columns of the position"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield pose channels that lie or move like nothing does."""
    for channel in sorted(QUATERNION.keys() & view.raw.arrays.keys()):
        pose = view.complete_values(channel)
        if pose is None or view.time_s is None:
            continue
        place = pose[:, :3]
        is_far = np.abs(np.nan_to_num(place)).max(axis=1) > FAR_M
        speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(view.time_s)
        is_fast = np.r_[False, np.nan_to_num(speed) > FAST_MPS]
        is_often_fast = is_fast.sum() >= max(3, STEPS * len(is_fast))
        reach_m = float(np.nanmax(np.abs(place)))
        if not is_often_fast and is_far.mean() < 0.5:
            continue
        top = float(np.nanquantile(speed, 1 - STEPS / 2))
        level: Level = "error" if (is_often_fast and top > IMPOSSIBLE_MPS) or reach_m > 10 * FAR_M else "warning"
        text = f"up to {reach_m:.3g} m from the origin, up to {top:.3g} m/s (as millimetres: {reach_m / 1e3:.3g} m)"
        yield view.finding(
            level,
            "pose_unit",
            "poses are no metres, or no poses",
            text,
            channel,
            is_far | is_fast if is_often_fast else is_far,
            REMEDY,
            largest_m=reach_m,
            speed_mps=top,
        )


RULE = Rule(meaning="poses are metres", episode=_episode)
