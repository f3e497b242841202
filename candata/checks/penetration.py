"""Rule: the object lies neither in its support nor in the hand."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._geometry import LOOKED_AT, adrift, fits, placed
from candata.checks._view import View

#: Depths that are told, doubtful and wrong [m]: trackers are off by millimetres, soft contact gives by as much.
TOLD_M, DOUBTFUL_M, WRONG_M = 0.003, 0.02, 0.04
#: Share of rows that are as deep.
ROWS = 0.05
REMEDY = "check frame, offset and scale of the object's pose, the zeros of the joints, and the model's size"


def _episode(view: View) -> Iterator[Finding]:
    """Yield that the object sinks into something, and how deep."""
    scene = view.scene
    if scene is None:
        return
    reason = fits(view, scene)
    if reason:
        yield view.finding("unknown", "penetration", reason)
        return
    mine, lost = set(scene.object_geoms.tolist()), adrift(scene)
    rows, depths, into = [], [], []
    for row, data in placed(view, scene, np.arange(len(view.raw.arrays["time_ns"]))):
        mujoco.mj_collision(scene.model, data)
        touching = [
            c
            for c in data.contact[: data.ncon]
            if len(mine & {int(c.geom1), int(c.geom2)}) == 1
            and not lost & {int(scene.model.geom_bodyid[g]) for g in (c.geom1, c.geom2)}
        ]
        deepest = min(touching, key=lambda c: c.dist, default=None)
        rows.append(row)
        depths.append(0.0 if deepest is None else max(0.0, -float(deepest.dist)))
        into.append(-1 if deepest is None else int(({int(deepest.geom1), int(deepest.geom2)} - mine).pop()))
    if not rows:
        return
    depth = float(np.quantile(depths, 1 - ROWS))
    if depth <= TOLD_M:
        return
    deep = np.array(depths) > TOLD_M
    at = np.zeros(len(view.raw.arrays["time_ns"]), bool)
    at[np.array(rows)[deep]] = True
    most = max({into[k] for k in np.flatnonzero(deep)}, key=[into[k] for k in np.flatnonzero(deep)].count)
    name = scene.model.geom(most).name or scene.model.body(int(scene.model.geom_bodyid[most])).name
    level: Level = "error" if depth > WRONG_M else "warning" if depth > DOUBTFUL_M else "info"
    text = f"{1e3 * depth:.1f} mm deep in {name}, in {deep.mean():.0%} of {min(len(rows), LOOKED_AT)} rows"
    yield view.finding(
        level, "penetration", "the object lies inside something", text, "object_pose", at, REMEDY,
        depth_m=depth, into=name, share=float(deep.mean()),
    )  # fmt: skip


RULE = Rule(
    meaning="the object lies in nothing", episode=_episode, needs=("object_pose",), scene=True,
)  # fmt: skip
