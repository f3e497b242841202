"""Regimes: in which of its blocks a symptom's excess lies, by recorded motion and load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from candata.gap.data.lag import drives
from candata.gap.data.recordings import Recordings
from candata.gap.data.robust_loss import rho
from candata.gap.fit.problem import Problem
from candata.gap.measure.symptoms import LEVEL, max_test
from candata.gap.replay.residuals import Layout
from candata.scenes import Scene
from candata.schema.contact import fingertip_contact
from candata.schema.report import Symptom
from candata.statistics import noise_sd

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: A block counts as moving above this share of its joint's fast speed (the 90 % quantile), and above this many
#: standard deviations of what noise alone makes of a speed.
MOVING, SURELY = 0.15, 4.0
#: A motor pulls where its joint is off its target by more than this share of what it is off at most (the 90 %
#: quantile), and by more than noise.
PULLS = 0.5
#: Blocks before and after a joint sets out the other way that count as near the reversal.
NEAR = 1
#: Pairs of a block inside and one outside that give an episode a say (half their harmonic mean), and such episodes.
BLOCKS, EPISODES = 2.0, 6
#: By how much the excess within must exceed that of the other blocks to be called concentrated.
CONCENTRATED = 1.25


@dataclass(frozen=True)
class Regimes:
    """What each block of the recording was: `(E, B, ...)`.

    Attributes
    ----------
    motion : dict of str to (E, B, J) bool
        The recorded motion of each joint.
    tips : (E, B, F) bool
        Whether a fingertip read a contact in most of a block's rows; no columns where forces were not recorded.
    carried : (J, F) bool
        Fingertips that a joint carries.
    pulled : (E, B, J) bool
        Where the joint's position servo pulls hard; nowhere without one.
    """

    motion: dict[str, Flags]
    tips: Flags
    carried: Flags
    pulled: Flags


def regimes(scene: Scene, recs: Recordings, plan: Layout) -> Regimes:
    """Return what each block of a recording was, by recorded joints and forces alone: no simulation has a say."""
    count = plan.phase.shape[1]
    joint = recs.readings.get("joint_position", np.zeros((len(recs), count * plan.rows, 0)))
    force = recs.readings.get("fingertip_force", np.zeros((len(recs), count * plan.rows, 0, 3)))
    touch = np.stack([fingertip_contact(f) for f in force])[:, : count * plan.rows]
    tips = touch.reshape(len(recs), count, plan.rows, -1).mean(2) > 0.5
    return Regimes(
        motion(joint, count, plan.rows), tips, _carried(scene, tips.shape[2]), _pulled(scene, recs, count, plan.rows)
    )


def _pulled(scene: Scene, recs: Recordings, count: int, rows: int) -> Flags:
    """Return `(E, B, J)` where a servo's joint is far from where it would rest without a load."""
    out, servos = np.zeros((len(recs), count, len(scene.joint_ids)), bool), drives(scene)
    if "joint_position" not in recs.readings or recs.commands.shape[2] != len(scene.actuator_ids):
        return out
    off = servos.targets(recs.commands) - recs.readings["joint_position"][..., servos.joints]
    size = np.abs(off[:, : count * rows].reshape(len(recs), count, rows, -1).mean(2))
    for column, j in enumerate(servos.joints):
        own = size[..., column]
        if np.isfinite(own).any():
            noise = _noise(recs.readings["joint_position"][..., j], rows)
            out[..., j] |= np.nan_to_num(own) > max(PULLS * np.nanquantile(own, 0.9), SURELY * noise)
    return out


def _noise(joint: Array, rows: int) -> float:
    """Return the standard deviation that noise of a joint `(E, T)` has in a block's mean; 0 where nothing was seen."""
    return float(noise_sd(joint, 1) / np.sqrt(rows))


def motion(joint: Array, count: int, rows: int) -> dict[str, Flags]:
    """Return in which blocks each joint moves up or down, is near a reversal, or is still.

    Parameters
    ----------
    joint : (E, T, J) float64
        Recorded positions, NaN where not seen.
    count, rows : int
        Blocks, and rows of each.
    """
    blocks = joint[:, : count * rows].reshape(len(joint), count, rows, -1)
    centre = blocks.mean(2)
    speed = np.full(centre.shape, np.nan)
    speed[:, 1:-1] = (centre[:, 2:] - centre[:, :-2]) / 2
    seen = np.isfinite(speed)
    least = _least(joint, speed, rows)
    up, down = (np.nan_to_num(s * speed) > least for s in (1.0, -1.0))
    turning = _around(_turned(up.astype(int) - down))
    moving = (up | down) & ~turning
    return {
        "moving": moving,
        "moving +": moving & up,
        "moving -": moving & down,
        "reversal": turning & seen,
        "still": seen & ~up & ~down & ~turning,
    }


def _least(joint: Array, speed: Array, rows: int) -> Array:
    """Return `(J,)` the change from block to block above which a joint moves."""
    out = np.zeros(joint.shape[2])
    for j in range(len(out)):
        size = np.abs(speed[..., j])
        if np.isfinite(size).any():
            # Half the difference of two means.
            noise = _noise(joint[..., j], rows) / np.sqrt(2)
            out[j] = max(MOVING * np.nanquantile(size, 0.9), SURELY * noise)
    return out


def _turned(sign: NDArray[np.int64]) -> Flags:
    """Return where a joint sets out against the way it moved last, however long it stood between."""
    index = np.where(sign != 0, np.arange(sign.shape[1])[None, :, None], 0)
    last = np.take_along_axis(sign, np.maximum.accumulate(index, axis=1), axis=1)
    before = np.concatenate([np.zeros_like(last[:, :1]), last[:, :-1]], axis=1)
    return np.asarray(sign * before < 0)


def _around(flags: Flags) -> Flags:
    """Return flags `(E, B, J)` that are set where one within `NEAR` blocks is."""
    wide = np.pad(flags, ((0, 0), (NEAR, NEAR), (0, 0)))
    return np.asarray(sliding_window_view(wide, 2 * NEAR + 1, axis=1).any(-1))


def _carried(scene: Scene, tips: int) -> Flags:
    """Return `(J, F)` whether a joint's body is an ancestor of a fingertip's body, or that body itself."""
    out = np.zeros((len(scene.joint_ids), tips), bool)
    bodies = scene.model.jnt_bodyid[scene.joint_ids]
    for f in range(tips):
        body = int(scene.fingertip_bodies[f])
        while body:
            out[bodies == body, f] = True
            body = int(scene.model.body_parentid[body])
    return out


def splits(scene: Scene, regime: Regimes, channel: str, element: str | None) -> dict[str, tuple[Flags, Flags]]:
    """Return the regimes that make sense for one column, each beside the strata within which it is compared.

    Motion of a joint and contact of what it carries, contact of a fingertip or the object; of a joint whose fingertips'
    forces are not known, whether its motor pulls. Fingers that press hardly move: motion is compared among blocks of
    the same load, load among blocks of the same motion. Flags and strata are `(E, B)` and `(S, E, B)`.
    """
    touched: Flags = np.asarray(regime.tips.any(2))
    load = ("loaded", "free")
    out: dict[str, tuple[Flags, Flags]] = {}
    if channel.startswith("joint_") and element in scene.file.joints:
        j = scene.file.joints.index(element)
        if regime.carried[j].any():
            touched = np.asarray(regime.tips[..., regime.carried[j]].any(2))
        else:
            touched, load = regime.pulled[..., j], ("pulling", "idle")
        moved = {name: flags[..., j] for name, flags in regime.motion.items()}
        strata = np.stack([moved[name] for name in ("moving +", "moving -", "reversal", "still")])
        alike = np.stack([touched, ~touched]) & strata.any(0)
        out = {name: (flags, alike) for name, flags in moved.items()}
    else:
        strata = np.ones((1, *touched.shape), bool)
    if channel == "fingertip_force" and element is not None:
        touched = regime.tips[..., scene.file.fingertips.index(element.rsplit(" ", 1)[0])]
    return out | (dict(zip(load, ((touched, strata), (~touched, strata)), strict=True)) if touched.any() else {})


def with_regimes(found: Sequence[Symptom], problem: Problem) -> tuple[Symptom, ...]:
    """Return the symptoms, each with the regime in which its element's excess lies; None where it lies in all alike.

    For each element and regime: the loss of the recording less that of one null replay, within less that of the other
    blocks, as a mean by episode over all phases (one alone is often too short). Its sign is flipped by episode, and the
    largest studentised mean over all elements and regimes makes p family-wise (Westfall & Young 1993).

    Parameters
    ----------
    found : sequence of Symptom
        Those that are not sure keep no regime.
    problem : Problem
        What was recorded, how it is judged, and what the nominal replay left; its streams draw null replays and signs.
    """
    sure = list(dict.fromkeys((s.channel, s.element) for s in found if s.p <= LEVEL))
    scene, plan, level = problem.replayer.scene, problem.plan, problem.score
    known = regimes(scene, problem.recs, plan)
    episodes = np.arange(plan.phase.shape[0])
    rng = problem.stream("regimes")
    null = level.null[rng.integers(len(level.null), size=len(episodes)), episodes]
    shape = (*plan.phase.shape, len(plan.columns))
    excess = np.where(level.mask, rho(problem.nominal).astype(float) - rho(null), np.nan).reshape(shape)
    sides: dict[tuple[str, str | None, str], Array] = {}
    for channel, element in sure:
        column = [(c, e) for c, e, _ in plan.columns].index((channel, element or ""))
        for name, (flags, strata) in splits(scene, known, channel, element).items():
            both = within_and_beside(excess[..., column], flags, strata)
            if np.isfinite(both[0]).sum() >= EPISODES:
                sides[channel, element, name] = both
    best = _concentrated(sides, rng) if sides else {}
    return tuple(s.model_copy(update={"regime": best.get((s.channel, s.element))}) for s in found)


def _concentrated(
    sides: dict[tuple[str, str | None, str], Array], rng: np.random.Generator
) -> dict[tuple[str, str | None], str]:
    """Return the regime of each element whose excess is surely and clearly concentrated: the largest of these."""
    inside, outside = np.stack(list(sides.values()), axis=-1)
    p = max_test(np.nan_to_num(inside - outside), rng)
    clear = np.nanmean(inside, axis=0) > CONCENTRATED * np.maximum(np.nanmean(outside, axis=0), 0)
    size = np.nanmean(inside - outside, axis=0)
    best: dict[tuple[str, str | None], tuple[float, str]] = {}
    for k, (channel, element, name) in enumerate(sides):
        if p[k] <= LEVEL and clear[k]:
            best[channel, element] = max(best.get((channel, element), (0.0, "")), (float(size[k]), name))
    return {key: name for key, (_, name) in best.items()}


def within_and_beside(excess: Array, flags: Flags, strata: Flags) -> Array:
    """Return `(2, E)` the mean excess of blocks in a regime, and that of the others in the same strata.

    Strata count by the pairs that they offer (Mantel & Haenszel 1959), so none needs many blocks; NaN where an episode
    has too few on either side.

    Parameters
    ----------
    excess : (E, B) float64
        NaN where nothing was recorded.
    flags : (E, B) bool
    strata : (S, E, B) bool
    """
    sides = np.stack([np.isfinite(excess) & side & strata for side in (flags, ~flags)])
    count = sides.sum(3)
    mean = np.where(sides, excess, 0.0).sum(3) / np.maximum(count, 1)
    weight = count.prod(0) / np.maximum(count.sum(0), 1)
    total = weight.sum(0)
    return np.where(total >= BLOCKS, (weight * mean).sum(1) / np.maximum(total, 1e-9), np.nan)
