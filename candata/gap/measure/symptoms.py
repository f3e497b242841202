"""Where: excess loss by channel element and phase, tested over episodes against null replays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.data.robust_loss import rho
from candata.gap.measure.score import Compact, Score
from candata.gap.replay.residuals import Layout
from candata.scenes import Scene
from candata.schema.report import Symptom

Array = NDArray[np.float64]
#: Sign flips drawn for the max-statistic; p is never below 1 / (FLIPS + 1) (Phipson & Smyth 2010).
FLIPS = 2000
#: Symptoms that a report lists, the largest p they may have, and how many are listed where none is that sure.
LISTED, LEVEL, UNSURE = 8, 0.05, 3
#: Loss below which a cell counts as at the floor: a twentieth of a typical null's.
TINY = 0.03


def locate(plan: Layout, score: Score, nominal: Compact, rng: np.random.Generator) -> HeatMap:
    """Return loss over floor by column and phase, with family-wise p-values over episodes.

    The recorded loss and the loss of one null replay of the same episode are exchangeable when there is no gap, so
    the sign of the difference of their logarithms is flipped by episode (of logarithms, so that one wild episode
    does not drown the others); the largest studentised mean over all cells makes p family-wise (Westfall & Young
    1993).
    """
    recorded = _cells(plan, nominal, score)
    null = np.stack([_cells(plan, z, score) for z in score.null])
    seen = np.isfinite(recorded).sum(0) >= 2
    typical = np.where(np.isfinite(recorded), null.mean(0), np.nan)
    ratio = np.nansum(recorded, 0) / np.maximum(np.nansum(typical, 0), TINY)
    pick = rng.integers(len(null), size=len(nominal))
    differ = np.log(recorded + TINY) - np.log(null[pick, np.arange(len(nominal))] + TINY)
    p = max_test(np.nan_to_num(differ), rng)
    rows = tuple(c if e is None else f"{c} {e}" for c, e, _ in plan.columns)
    shape = (len(plan.phases), len(plan.columns))
    return HeatMap(
        rows,
        plan.phases,
        np.where(seen, ratio, np.nan).reshape(shape).T,
        np.where(seen, p, np.nan).reshape(shape).T,
    )


def _cells(plan: Layout, z: Compact, score: Score) -> Array:
    """Return `(E, P D)` mean loss of each episode by phase and column; NaN where there is nothing."""
    count, blocks = plan.phase.shape
    loss = rho(z).reshape(count, blocks, -1).astype(float)
    mask = score.mask.reshape(loss.shape)
    out = np.full((count, len(plan.phases), loss.shape[2]), np.nan)
    for p in range(len(plan.phases)):
        here = mask & (plan.phase == p)[:, :, None]
        n = here.sum(1)
        out[:, p] = np.where(n > 0, np.where(here, loss, 0).sum(1) / np.maximum(n, 1), np.nan)
    return out.reshape(count, -1)


def max_test(differ: Array, rng: np.random.Generator) -> Array:
    """Return `(C,)` family-wise p-values of mean(differ) > 0 by flipping the signs of episodes."""
    scale = np.sqrt((differ**2).sum(0))
    scale[scale == 0] = np.inf
    observed = differ.sum(0) / scale
    signs = rng.choice([-1.0, 1.0], size=(FLIPS, len(differ)))
    largest = (signs @ differ / scale).max(1)
    return (1 + (largest[:, None] >= observed).sum(0)) / (FLIPS + 1)


def symptoms(plan: Layout, heat: HeatMap) -> tuple[Symptom, ...]:
    """Return the cells that leave the nulls, largest ratio first; where no cell does for sure, the three largest."""
    found = []
    for i, (channel, element, _) in enumerate(plan.columns):
        for j, phase in enumerate(heat.phases):
            if np.isfinite(heat.ratio[i, j]) and heat.ratio[i, j] > 1:
                found.append(
                    Symptom(
                        channel=channel,
                        element=element,
                        phase=phase,
                        ratio=round(float(heat.ratio[i, j]), 3),
                        p=round(float(heat.p[i, j]), 5),
                    )
                )
    found.sort(key=lambda s: -s.ratio)
    sure = [s for s in found if s.p <= LEVEL]
    return tuple(sure[:LISTED] or found[:UNSURE])


def acts_on(found: Sequence[Symptom], slides: Sequence[str]) -> str | None:
    """Return what the worst symptom belongs to: joint, wrist, fingertip or object."""
    if not found:
        return None
    first = found[0]
    if first.channel.startswith("joint_"):
        return "wrist" if first.element in slides else "joint"
    return {"fingertip_force": "fingertip", "object_pose": "object"}[first.channel]


def slides(scene: Scene) -> list[str]:
    """Return the names of slide joints: a wrist on rails."""
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    return [j for j, i in zip(scene.file.joints, scene.joint_ids, strict=True) if scene.model.jnt_type[i] == slide]


@dataclass(frozen=True)
class HeatMap:
    """Excess of the recorded loss over the floor, channel element by phase.

    Attributes
    ----------
    rows : tuple of str
        `channel` or `channel element` labels.
    phases : tuple of str
        Column labels.
    ratio : (R, P) float64
        Loss over floor; 1 is the floor, NaN where there is no data.
    p : (R, P) float64
        Family-wise p-value over episodes; NaN where there is no data.
    """

    rows: tuple[str, ...]
    phases: tuple[str, ...]
    ratio: Array
    p: Array
