"""Rule: joints stay within the limits of the scene's model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._view import EpisodeView

#: Excess over a limit that is reported, doubtful and wrong [rad or m]: soft limits of a simulator
#: give by some thousandths, encoders are off by hundredths.
TOLD_EXCESS, DOUBTFUL_EXCESS, WRONG_EXCESS = 0.01, 0.08, 0.3
#: Share of rows that counts as beyond.
ROWS = 0.01


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield joints that go beyond their limits, and commands that do."""
    joint = view.values("joint_position")
    if joint is None or view.scene is None:
        return
    model, scene_joints = view.scene.model, view.scene.file.joints
    names = view.elements("joint_position")
    joint_columns = [(k, scene_joints.index(name)) for k, name in enumerate(names) if name in scene_joints]
    if not joint_columns:
        if joint.shape[1] != len(scene_joints) or (view.meta and view.meta.joint_names):
            yield view.finding("unknown", "joint_limits", "the joints are none of the scene's")
            return
        joint_columns = [(k, k) for k in range(len(scene_joints))]
    for k, j in joint_columns:
        index = view.scene.joint_ids[j]
        if not model.jnt_limited[index]:
            continue
        low, high = model.jnt_range[index]
        excess = np.nan_to_num(np.maximum(joint[:, k] - high, low - joint[:, k]))
        largest_excess = float(np.quantile(excess, 1 - ROWS))
        if largest_excess > TOLD_EXCESS:
            level: Level = (
                "error" if largest_excess > WRONG_EXCESS else "warning" if largest_excess > DOUBTFUL_EXCESS else "info"
            )
            text = f"{names[k]} by {largest_excess:.3g}, limits {low:.4g} to {high:.4g}"
            yield view.finding(
                level,
                "joint_limits",
                "a joint is beyond its limits",
                text,
                "joint_position",
                excess > TOLD_EXCESS,
                "check unit, sign and zero of the joint, and the model's limits",
                joint=names[k],
                beyond=largest_excess,
                low=float(low),
                high=float(high),
            )


RULE = Rule(meaning="joints stay within their limits", episode=_episode, needs=("joint_position",), scene=True)
