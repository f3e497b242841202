"""Check: an object's pose that otherwise changes from row to row does not stand still to the last bit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks import EpisodeView, Finding, Rule

#: Time for which a tracker that has lost the object repeats its last pose [s], and share of the other rows that differ
#: from the row before, below which a standing pose means nothing. Chosen.
FROZEN_S, LIVELY = 0.25, 0.9
REMEDY = "mark these rows invalid: the tracker had lost the object"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield the stretch of an episode in which the pose is frozen."""
    pose = view.values("object_pose")
    if pose is None or len(pose) < 2:
        return
    same = np.r_[False, (np.diff(pose, axis=0) == 0).all(axis=1)]
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(np.int8))).reshape(-1, 2)
    frozen = np.zeros(len(same), bool)
    for begin, end in edges:
        frozen[begin:end] = end - begin >= FROZEN_S * view.rate_hz
    if frozen.any() and (~same[~frozen]).mean() >= LIVELY:
        text = f"{frozen.sum()} of {len(same)} rows"
        yield view.finding("warning", "frozen_pose", "the pose is frozen", text, "object_pose", frozen, REMEDY)


RULE = Rule(meaning="poses do not freeze", episode=_episode, needs=("object_pose",))
