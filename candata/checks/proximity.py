"""Rule: what touches is near: fingertips that feel a force lie at something that they can touch."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._forces import flags, forces, touched
from candata.checks._geometry import adrift, fits, placed
from candata.checks._view import View
from candata.scenes import Scene
from candata.scenes.assemble import subtree

#: Distances between a touching fingertip and what it can touch that are told, doubtful and wrong [m].
TOLD_M, DOUBTFUL_M, WRONG_M = 0.005, 0.015, 0.05
#: Fewest rows with contact, and the share of them that must be as far.
FEWEST, ROWS = 3, 0.5
#: Share of an episode's rows in which a fingertip is taken to be free. Chosen.
QUIET = 0.2
REMEDY = "check the frames of object and hand, the timing of contact against poses, and the order of fingertips"


def _episode(view: View) -> Iterator[Finding]:
    """Yield fingertips that are flagged, or feel a force, far from all that they can touch."""
    scene, touch = view.scene, touched(view)
    if scene is None:
        return
    reason = fits(view, scene)
    if reason or not scene.file.fingertips:
        yield view.finding("unknown", "proximity", reason or "the scene has no fingertips")
        return
    tips = _touching(view, scene)
    if tips is None and touch is not None:
        tips = np.repeat(touch[:, None] > 0, 1, axis=1)
    if tips is None:
        yield view.finding("unknown", "proximity", "it is not known when fingertips touch")
        return
    groups = [_geoms(scene, tip) for tip in range(len(scene.file.fingertips))]
    others = [_touchable(scene.model, geoms) for geoms in groups]
    moved = adrift(scene)
    lost = [
        bool(moved & {int(scene.model.geom_bodyid[g]) for g in [*own, *near]})
        for own, near in zip(groups, others, strict=True)
    ]
    if all(lost) or (any(lost) and tips.shape[1] != len(lost)):
        reason = "fingertips, or what they touch, move by joints that were not recorded"
        yield view.finding("unknown", "proximity", reason)
        return
    tips = tips & ~np.array(lost) if any(lost) else tips
    rows = np.flatnonzero(tips.any(axis=1))
    found = [(row, _distance(scene.model, data, groups, others, tips[row])) for row, data in placed(view, scene, rows)]
    if len(found) < FEWEST:
        return
    apart = float(np.quantile([d for _, d in found], 1 - ROWS))
    if apart > TOLD_M:
        sure = apart > WRONG_M and not _only_bias(view, scene, found)
        level: Level = "error" if sure else "warning" if apart > DOUBTFUL_M else "info"
        at = np.zeros(len(tips), bool)
        at[[row for row, d in found if d > TOLD_M]] = True
        yield view.finding(
            level, "proximity", "contact without proximity", f"{1e3 * apart:.0f} mm to what it can touch",
            "fingertip_contact", at, REMEDY, distance_m=apart, rows=len(found),
        )  # fmt: skip


def _touching(view: View, scene: Scene) -> NDArray[np.bool_] | None:
    """Return `(T, F) bool` which fingertips touch, by force or by flag; None where that is not known by fingertip."""
    force = forces(view)
    count = len(scene.file.fingertips)
    if force is not None and force.total.shape[1] == count:
        return force.touch & force.seen
    flag = flags(view, count)
    return None if flag is None else np.nan_to_num(flag) > 0


def _only_bias(view: View, scene: Scene, found: list[tuple[int, float]]) -> bool:
    """Tell whether rows that lie far from the object are no touches once a constant is taken off each fingertip.

    A sensor that is biased seems to touch all the time. The constant is what it reads while it reads least.
    """
    force = forces(view)
    if force is None or force.total.shape[1] != len(scene.file.fingertips):
        return False
    rest = np.stack([_least(force.xyz[:, tip], force.total[:, tip]) for tip in range(force.total.shape[1])])
    touch = np.nan_to_num(np.abs(force.xyz - rest).sum(axis=2)).max(axis=1) > force.threshold_n
    far = [row for row, apart in found if apart > WRONG_M]
    return bool(touch[far].mean() < ROWS)


def _least(xyz: NDArray[np.float64], total: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median reading of a fingertip `(3,)` [N] in the share of rows in which it reads least."""
    seen = np.isfinite(total)
    if not seen.any():
        return np.zeros(3)
    low = seen & (np.where(seen, total, np.inf) <= np.quantile(total[seen], QUIET))
    return np.asarray(np.median(xyz[low], axis=0))


def _geoms(scene: Scene, tip: int) -> list[int]:
    """Return the colliding geoms of a fingertip: itself, or those of its body and what that carries."""
    model, name = scene.model, scene.file.fingertips[tip]
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) < 0:
        return [model.geom(name).id]
    bodies = list(subtree(model, int(scene.fingertip_bodies[tip])))
    touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.flatnonzero(np.isin(model.geom_bodyid, bodies) & touch).tolist()


def _touchable(model: mujoco.MjModel, tip: list[int]) -> list[int]:
    """Return the geoms that a fingertip can touch: the object, the table, other fingers; not its neighbouring links."""
    welds = model.body_weldid
    own = {int(welds[model.geom_bodyid[g]]) for g in tip}
    near = own | {int(welds[model.body_parentid[b]]) for b in own}
    near |= {int(welds[b]) for b in range(1, model.nbody) if int(welds[model.body_parentid[b]]) in own}
    kind, affine = model.geom_contype, model.geom_conaffinity
    return [
        g
        for g in range(model.ngeom)
        if (int(welds[model.geom_bodyid[g]]) not in near - {0} and int(welds[model.geom_bodyid[g]]) not in own)
        and any((kind[g] & affine[t]) | (kind[t] & affine[g]) for t in tip)
    ]


def _distance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    groups: list[list[int]],
    others: list[list[int]],
    touching: NDArray[np.bool_],
) -> float:
    """Return the largest distance between a touching fingertip and what it can touch [m].

    The least of all fingertips, where it is not known which touches. Looks no farther than 1 m.
    """
    near = [
        min((mujoco.mj_geomDistance(model, data, g, o, 1.0, None) for g in geoms for o in touchable), default=1.0)
        for geoms, touchable in zip(groups, others, strict=True)
    ]
    if len(touching) != len(near):
        return float(min(near))
    return float(max(d for d, t in zip(near, touching, strict=True) if t))


RULE = Rule(meaning="what touches is near", episode=_episode, needs=("object_pose",), scene=True)
