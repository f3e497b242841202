"""Rule: joints stay within the limits of the scene's model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._view import View

#: How far beyond a limit is told, doubtful and wrong [rad or m]: soft limits of a simulator give by some thousandths,
#: encoders are off by hundredths.
TOLD, DOUBTFUL, WRONG = 0.01, 0.08, 0.3
#: Share of rows that counts as beyond.
ROWS = 0.01


def _episode(view: View) -> Iterator[Finding]:
    """Yield joints that go beyond their limits, and commands that do."""
    joint = view.values("joint_position")
    if joint is None or view.scene is None:
        return
    model, known = view.scene.model, view.scene.file.joints
    names = view.elements("joint_position")
    shared = [(k, known.index(name)) for k, name in enumerate(names) if name in known]
    if not shared:
        if joint.shape[1] != len(known) or (view.meta and view.meta.joint_names):
            yield view.finding("unknown", "joint_limits", "the joints are none of the scene's")
            return
        shared = [(k, k) for k in range(len(known))]
    for k, j in shared:
        index = view.scene.joint_ids[j]
        if not model.jnt_limited[index]:
            continue
        low, high = model.jnt_range[index]
        beyond = np.nan_to_num(np.maximum(joint[:, k] - high, low - joint[:, k]))
        most = float(np.quantile(beyond, 1 - ROWS))
        if most > TOLD:
            level: Level = "error" if most > WRONG else "warning" if most > DOUBTFUL else "info"
            text = f"{names[k]} by {most:.3g}, limits {low:.4g} to {high:.4g}"
            yield view.finding(
                level, "joint_limits", "a joint is beyond its limits", text, "joint_position", beyond > TOLD,
                "check unit, sign and zero of the joint, and the model's limits", joint=names[k], beyond=most,
                low=float(low), high=float(high),
            )  # fmt: skip


RULE = Rule(meaning="joints stay within their limits", episode=_episode, needs=("joint_position",), scene=True)
