"""Rule: no pose is stored for rows in which a tracker saw nothing: poses do not jump to one value and back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Rule
from candata.checks._view import EpisodeView
from candata.gap.data.faults import lost_rows
from candata.schema.channels import QUATERNION

REMEDY = "mark these rows invalid: NaN in their place before the import, then --allow-gaps"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield pose channels that jump to one value and back."""
    for channel in sorted(QUATERNION.keys() & view.raw.arrays.keys()):
        pose = view.complete_values(channel)
        is_lost = np.zeros(0, bool) if pose is None else lost_rows(pose)
        if pose is None or not is_lost.any():
            continue
        value = pose[int(np.argmax(is_lost)), :3]
        text = f"{is_lost.sum()} of {len(is_lost)} rows at {' '.join(f'{x:.4g}' for x in value)}"
        yield view.finding(
            "error",
            "lost_poses",
            "poses of nothing: they jump to one value and back",
            text,
            channel,
            is_lost,
            REMEDY,
            rows=int(is_lost.sum()),
        )


RULE = Rule(meaning="poses are of something", episode=_episode)
