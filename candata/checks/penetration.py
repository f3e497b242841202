"""Rule: the object lies neither in its support nor in the hand."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from candata.checks._finding import Finding, Level, Rule
from candata.checks._geometry import LOOKED_AT, fits, recorded_states, unplaced_bodies
from candata.checks._view import EpisodeView

#: Depths that are reported, doubtful and wrong [m]: trackers are off by millimetres, soft contact gives by as much.
TOLD_M, DOUBTFUL_M, WRONG_M = 0.003, 0.02, 0.04
#: Share of rows that are as deep.
ROWS = 0.05
REMEDY = "check frame, offset and scale of the object's pose, the zeros of the joints, and the model's size"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield that the object sinks into something, and how deep."""
    scene = view.scene
    if scene is None:
        return
    reason = fits(view, scene)
    if reason:
        yield view.finding("unknown", "penetration", reason)
        return
    object_geoms, loose_bodies = set(scene.object_geoms.tolist()), unplaced_bodies(scene)
    rows, depths, obstacles = [], [], []
    for row, data in recorded_states(view, scene, np.arange(len(view.raw.arrays["time_ns"]))):
        mujoco.mj_collision(scene.model, data)
        contacts = [
            c
            for c in data.contact[: data.ncon]
            if len(object_geoms & {int(c.geom1), int(c.geom2)}) == 1
            and not loose_bodies & {int(scene.model.geom_bodyid[g]) for g in (c.geom1, c.geom2)}
        ]
        deepest = min(contacts, key=lambda c: c.dist, default=None)
        rows.append(row)
        depths.append(0.0 if deepest is None else max(0.0, -float(deepest.dist)))
        obstacles.append(
            -1 if deepest is None else int(({int(deepest.geom1), int(deepest.geom2)} - object_geoms).pop())
        )
    if not rows:
        return
    depth = float(np.quantile(depths, 1 - ROWS))
    if depth <= TOLD_M:
        return
    is_deep = np.array(depths) > TOLD_M
    at = np.zeros(len(view.raw.arrays["time_ns"]), bool)
    at[np.array(rows)[is_deep]] = True
    main_obstacle = max(
        {obstacles[k] for k in np.flatnonzero(is_deep)}, key=[obstacles[k] for k in np.flatnonzero(is_deep)].count
    )
    name = scene.model.geom(main_obstacle).name or scene.model.body(int(scene.model.geom_bodyid[main_obstacle])).name
    level: Level = "error" if depth > WRONG_M else "warning" if depth > DOUBTFUL_M else "info"
    text = f"{1e3 * depth:.1f} mm deep in {name}, in {is_deep.mean():.0%} of {min(len(rows), LOOKED_AT)} rows"
    yield view.finding(
        level,
        "penetration",
        "the object lies inside something",
        text,
        "object_pose",
        at,
        REMEDY,
        depth_m=depth,
        into=name,
        share=float(is_deep.mean()),
    )


RULE = Rule(
    meaning="the object lies in nothing",
    episode=_episode,
    needs=("object_pose",),
    scene=True,
)
