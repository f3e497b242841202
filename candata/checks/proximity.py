"""Rule: what touches is near: fingertips that feel a force lie at something that they can touch."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Level, Rule
from candata.checks._forces import any_contact, flags, forces
from candata.checks._geometry import fits, recorded_states, unplaced_bodies
from candata.checks._view import EpisodeView
from candata.scenes import Scene

#: Distances between a touching fingertip and what it can touch that are reported, doubtful and wrong [m].
TOLD_M, DOUBTFUL_M, WRONG_M = 0.005, 0.015, 0.05
#: Fewest rows with contact, and the share of them that must be as far.
FEWEST, ROWS = 3, 0.5
#: Share of an episode's rows in which a fingertip is taken to be free. Chosen.
QUIET_SHARE = 0.2
REMEDY = "check the frames of object and hand, the timing of contact against poses, and the order of fingertips"


def _episode(view: EpisodeView) -> Iterator[Finding]:
    """Yield fingertips that are flagged, or feel a force, far from all that they can touch."""
    scene, touch = view.scene, any_contact(view)
    if scene is None:
        return
    reason = fits(view, scene)
    if reason or not scene.file.fingertips:
        yield view.finding("unknown", "proximity", reason or "the scene has no fingertips")
        return
    tips = _tip_contact(view, scene)
    if tips is None and touch is not None:
        tips = np.repeat(touch[:, None] > 0, 1, axis=1)
    if tips is None:
        yield view.finding("unknown", "proximity", "it is not known when fingertips touch")
        return
    groups = [geoms.tolist() for geoms in scene.fingertip_geoms]
    partner_groups = [_touchable(scene.model, geoms) for geoms in groups]
    loose_bodies = unplaced_bodies(scene)
    is_unplaced = [
        bool(loose_bodies & {int(scene.model.geom_bodyid[g]) for g in [*tip_geoms, *partner_geoms]})
        for tip_geoms, partner_geoms in zip(groups, partner_groups, strict=True)
    ]
    if all(is_unplaced) or (any(is_unplaced) and tips.shape[1] != len(is_unplaced)):
        reason = "fingertips, or what they touch, move by joints that were not recorded"
        yield view.finding("unknown", "proximity", reason)
        return
    tips = tips & ~np.array(is_unplaced) if any(is_unplaced) else tips
    rows = np.flatnonzero(tips.any(axis=1))
    distances = [
        (row, _distance(scene.model, data, groups, partner_groups, tips[row]))
        for row, data in recorded_states(view, scene, rows)
    ]
    if len(distances) < FEWEST:
        return
    distance_m = float(np.quantile([d for _, d in distances], 1 - ROWS))
    if distance_m > TOLD_M:
        is_sure = distance_m > WRONG_M and not _only_bias(view, scene, distances)
        level: Level = "error" if is_sure else "warning" if distance_m > DOUBTFUL_M else "info"
        at = np.zeros(len(tips), bool)
        at[[row for row, d in distances if d > TOLD_M]] = True
        yield view.finding(
            level,
            "proximity",
            "contact without proximity",
            f"{1e3 * distance_m:.0f} mm to what it can touch",
            "fingertip_contact",
            at,
            REMEDY,
            distance_m=distance_m,
            rows=len(distances),
        )


def _tip_contact(view: EpisodeView, scene: Scene) -> NDArray[np.bool_] | None:
    """Return `(T, F) bool` which fingertips touch, by force or by flag; None where that is not known by fingertip."""
    force = forces(view)
    count = len(scene.file.fingertips)
    if force is not None and force.total.shape[1] == count:
        return force.touch & force.has_value
    flag = flags(view, count)
    return None if flag is None else np.nan_to_num(flag) > 0


def _only_bias(view: EpisodeView, scene: Scene, distances: list[tuple[int, float]]) -> bool:
    """Tell whether rows that lie far from the object are no touches once a constant is taken off each fingertip.

    A sensor that is biased seems to touch all the time. The constant is what it reads while it reads least.
    """
    force = forces(view)
    if force is None or force.total.shape[1] != len(scene.file.fingertips):
        return False
    rest = np.stack([_rest_reading(force.xyz[:, tip], force.total[:, tip]) for tip in range(force.total.shape[1])])
    touch = np.nan_to_num(np.abs(force.xyz - rest).sum(axis=2)).max(axis=1) > force.threshold_n
    far_rows = [row for row, distance_m in distances if distance_m > WRONG_M]
    return bool(touch[far_rows].mean() < ROWS)


def _rest_reading(xyz: NDArray[np.float64], total: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median reading of a fingertip `(3,)` [N] in the share of rows in which it reads least."""
    has_value = np.isfinite(total)
    if not has_value.any():
        return np.zeros(3)
    low = has_value & (np.where(has_value, total, np.inf) <= np.quantile(total[has_value], QUIET_SHARE))
    return np.asarray(np.median(xyz[low], axis=0))


def _touchable(model: mujoco.MjModel, tip: list[int]) -> list[int]:
    """Return the geoms that a fingertip can touch: the object, the table, other fingers; not its neighbouring links."""
    welds = model.body_weldid
    tip_links = {int(welds[model.geom_bodyid[g]]) for g in tip}
    near_links = tip_links | {int(welds[model.body_parentid[b]]) for b in tip_links}
    near_links |= {int(welds[b]) for b in range(1, model.nbody) if int(welds[model.body_parentid[b]]) in tip_links}
    kind, affine = model.geom_contype, model.geom_conaffinity
    return [
        g
        for g in range(model.ngeom)
        if (
            int(welds[model.geom_bodyid[g]]) not in near_links - {0}
            and int(welds[model.geom_bodyid[g]]) not in tip_links
        )
        and any((kind[g] & affine[t]) | (kind[t] & affine[g]) for t in tip)
    ]


def _distance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    groups: list[list[int]],
    partner_groups: list[list[int]],
    is_touching: NDArray[np.bool_],
) -> float:
    """Return the largest distance between a touching fingertip and what it can touch [m].

    The least of all fingertips, where it is not known which touches. Looks no farther than 1 m.
    """
    tip_distances = [
        min((mujoco.mj_geomDistance(model, data, g, o, 1.0, None) for g in geoms for o in partner_geoms), default=1.0)
        for geoms, partner_geoms in zip(groups, partner_groups, strict=True)
    ]
    if len(is_touching) != len(tip_distances):
        return float(min(tip_distances))
    return float(max(d for d, t in zip(tip_distances, is_touching, strict=True) if t))


RULE = Rule(meaning="what touches is near", episode=_episode, needs=("object_pose",), scene=True)
