"""Residuals: recorded minus replayed, in the tangent space, as block means by element and phase."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.errors import DataError
from candata.gap.data.recordings import BLOCK_S, Recordings, block_rows
from candata.gap.data.sample_hold import held_readings
from candata.gap.replay.effort import foretold_effort
from candata.gap.replay.starts import Starts, reach
from candata.rotation import difference
from candata.scenes import Scene
from candata.scenes.traits import is_toss, support_height
from candata.schema.contact import fingertip_contact
from candata.schema.phases import contact_phases

Array = NDArray[np.float64]
#: Units of what joints read, of hinges and of slides.
JOINT_UNITS = {"joint_position": ("rad", "m"), "joint_velocity": ("rad/s", "m/s"), "joint_effort": ("N m", "N")}
#: Channels that say what was in the step before a row: the first row holds none.
OF_THE_STEP = ("joint_effort", "fingertip_force")
HAND_PHASES = ("free", "onset", "sustained", "release")
TOSS_PHASES = ("flight", "impact", "rest")
#: A tossed object counts as resting below this speed [m/s] until the end.
REST_SPEED_MPS = 0.05
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Layout:
    """What the columns and rows of a residual mean.

    Attributes
    ----------
    columns : tuple of (channel, element, unit)
        D columns.
    phases : tuple of str
        P phases.
    phase : (E, B) int64
        Phase of each block, -1 where the episode has ended or not begun.
    rows : int
        Rows a block.
    """

    columns: tuple[tuple[str, str, str], ...]
    phases: tuple[str, ...]
    phase: NDArray[np.int64]
    rows: int

    def take(self, index: NDArray[np.int64]) -> Layout:
        """Return the layout of some episodes."""
        return replace(self, phase=self.phase[index])


def layout(scene: Scene, recs: Recordings, begin: Starts, nominal: dict[str, Array]) -> Layout:
    """Return the layout of a set of recordings.

    Parameters
    ----------
    nominal : dict of str to ndarray
        Readings of the nominal replay: its contact decides where recorded contact flags cannot be trusted.
    """
    columns: list[tuple[str, str, str]] = []
    for channel, units in JOINT_UNITS.items():
        if channel in recs.readings:
            sides = scene.sliding.astype(int)
            columns += [(channel, j, units[s]) for j, s in zip(scene.file.joints, sides, strict=True)]
    if "object_pose" in recs.readings:
        columns += [("object_pose", f"position {a}", "m") for a in _AXES]
        columns += [("object_pose", f"rotation {a}", "rad") for a in _AXES]
    if "fingertip_force" in recs.readings:
        columns += [("fingertip_force", f"{f} {a}", "N") for f in scene.file.fingertips for a in _AXES]
    rows = block_rows(scene.file.rate_hz)
    if recs.lengths.max() < rows:
        raise DataError(
            "episodes are too short to compare",
            expected=f"at least {rows} rows ({1e3 * BLOCK_S:g} ms)",
            found=f"{recs.lengths.max()}",
        )
    phases = TOSS_PHASES if is_toss(scene) else HAND_PHASES
    labels = _toss_labels(scene, recs) if is_toss(scene) else _hand_labels(scene, recs, nominal)
    live = np.arange(labels.shape[1])[None] < recs.lengths[:, None]
    live &= np.arange(labels.shape[1])[None] >= begin.rows[:, None]
    code = np.select([labels == p for p in phases], range(len(phases)), -1)
    blocks = np.where(live, code, -1)[:, : code.shape[1] // rows * rows].reshape(len(recs), -1, rows)
    return Layout(tuple(columns), phases, np.where((blocks >= 0).all(2), blocks[:, :, rows // 2], -1), rows)


def _hand_labels(scene: Scene, recs: Recordings, nominal: dict[str, Array]) -> NDArray[np.str_]:
    """Return `(E, T)` phases by contact: the recorded one where it can be trusted, else the simulated one."""
    simulated = nominal["touch"] > 0
    flags = simulated
    if "fingertip_force" in recs.readings:
        tips = np.stack([fingertip_contact(f) for f in recs.readings["fingertip_force"]])
        # A bias keeps a flag on where the simulation is free: such a fingertip tells nothing about phases.
        free = ~simulated[:, :, None]
        stuck = (tips & free).sum((0, 1)) > 0.5 * np.maximum(free.sum((0, 1)), 1)
        recorded = np.asarray(tips[:, :, ~stuck].any(2))
        flags = recorded if (~stuck).any() else simulated
    return np.stack([contact_phases(c, scene.file.rate_hz) for c in flags])


def _toss_labels(scene: Scene, recs: Recordings) -> NDArray[np.str_]:
    """Return `(E, T)` flight, impact, rest by height and speed."""
    pose = recs.readings["object_pose"]
    low = pose[:, :, 2] - support_height(scene) < reach(scene)
    hit = np.logical_or.accumulate(np.nan_to_num(low).astype(bool), axis=1)
    window = max(1, round(0.05 * scene.file.rate_hz))
    speed = np.full(pose.shape[:2], np.inf)
    moved = np.linalg.norm(pose[:, window:, :3] - pose[:, :-window, :3], axis=2)
    speed[:, window:] = moved * scene.file.rate_hz / window
    fast = ~(np.nan_to_num(speed, nan=0.0) < REST_SPEED_MPS)
    resting = ~np.logical_or.accumulate(fast[:, ::-1], axis=1)[:, ::-1]
    return np.where(resting & hit, "rest", np.where(hit, "impact", "flight"))


def row_residual(recs: Recordings, plan: Layout, readings: dict[str, Array]) -> Array:
    """Return recorded minus replayed, `(E, T, D)` row by row; NaN where either is missing.

    Joints in rad or m, their velocities in rad/s or m/s and efforts in N m or N, positions in m, rotations as
    world-frame rotation vectors in rad (Sola 2018, eq. 105), forces in N in the fingertip's frame. Both sides of a
    sensor slower than the log are taken where its reading was new.
    """
    parts: list[Array] = []
    compared = recs.compared
    for channel in dict.fromkeys(c for c, _, _ in plan.columns):
        recorded, replayed = compared[channel], readings[channel]
        if channel == "object_pose":
            some = [recorded[..., :3] - replayed[..., :3], difference(recorded[..., 3:], replayed[..., 3:])]
        elif channel == "joint_effort" and recs.unscaled_effort:
            some = [recorded - foretold_effort(recorded, replayed, readings["joint_position"])]
        else:
            some = [(recorded - replayed).reshape(*recorded.shape[:2], -1)]
        slow = recs.sources.get(channel)
        parts += (
            some if slow is None else [np.where(np.isfinite(part), held_readings(part, slow), np.nan) for part in some]
        )
    joined = np.concatenate(parts, axis=-1)
    joined[:, 0, [c in OF_THE_STEP for c, _, _ in plan.columns]] = np.nan
    return joined


def residual(recs: Recordings, plan: Layout, readings: dict[str, Array]) -> Array:
    """Return recorded minus replayed as `row_residual` has it, `(E, B, D)` block means; NaN where either is missing."""
    joined = row_residual(recs, plan, readings)
    count = joined.shape[1] // plan.rows
    blocks = joined[:, : count * plan.rows].reshape(len(recs), count, plan.rows, -1)
    finite = np.isfinite(blocks)
    n = finite.sum(2)
    mean = np.where(finite, blocks, 0.0).sum(2) / np.maximum(n, 1)
    # A block counts when at least half of it was seen.
    seen = (2 * n >= plan.rows) & (plan.phase >= 0)[:, :, None]
    return np.where(seen, mean, np.nan)
