"""Faults of recordings: episodes that cannot be replayed, readings that jump out and back or to one value."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from candata.align import time_factor
from candata.errors import DataError, RateError, Where
from candata.gap.data.columns import ALONGSIDE, COMPARED, held_commands, recorded_columns
from candata.rotation import difference
from candata.scenes import Scene
from candata.schema.episode import Episode

Array = NDArray[np.float64]
#: How many times the usual bend of an episode's poses a spike is, and the least that it is [m, rad]. Chosen: an object
#: that bounces at 1 m/s turns round within 10 mm a row, but goes on from there.
TIMES, LEAST = 12.0, (0.005, 0.2)
#: Least jump of a joint that is a spike [rad, m]: a joint that runs at 2 rad/s and is stopped makes 0.04 rad less in a
#: row of 50 Hz, and goes on from there.
JOINT_LEAST = 0.05
#: Share of a spike's size that its neighbours may be apart. Chosen: of a motion that takes one row they are twice as
#: far from one another as that row is from their middle.
RETURNS = 0.5
#: Least jump to a value that stands for nothing [m], chosen: a finger's width; fewest rows that show it.
LOST_M, FEWEST = 0.02, 5


def without_jumps(readings: dict[str, Array], joints: Sequence[str]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return readings with NaN where poses or `joint_position (E, T, J)` jump out and back, and notes."""
    out, notes = dict(readings), []
    if "joint_position" in readings:
        out["joint_position"] = readings["joint_position"].copy()
        for j, name in enumerate(joints):
            column = readings["joint_position"][..., j]
            spike = np.stack([spike_rows(each[:, None], JOINT_LEAST) for each in column])
            out["joint_position"][spike, j] = np.nan
            if spike.any():
                notes.append(f"joint_position of {name} jumps out for one row and back {spike.sum()} times: left out")
    if "object_pose" in readings:
        for clean in (without_lost, without_spikes):
            out["object_pose"], told = clean(out["object_pose"])
            notes += told
    return out, tuple(notes)


def without_spikes(poses: Array) -> tuple[Array, tuple[str, ...]]:
    """Return poses `(E, T, 7)` with NaN in rows that fit neither what comes before nor what comes after, and a note.

    A row counts as a spike where position or rotation lies far from its neighbours' middle and from both straight
    lines, through the two rows before and through the two after.
    """
    if poses.shape[1] < 5:
        return poses, ()
    size = poses.shape[1]
    around = [poses[:, 2 + k : size - 2 + k] for k in (-2, -1, 1, 2)]
    at = poses[:, 2:-2]
    # Turns are told from each row itself: from the first row, a turn by pi would jump to and fro.
    moved = [some[..., :3] - at[..., :3] for some in around]
    turned = [difference(some[..., 3:], at[..., 3:]) for some in around]
    spike = np.pad(_spikes(moved, LEAST[0]) | _spikes(turned, LEAST[1]), ((0, 0), (2, 2)))
    if not spike.any():
        return poses, ()
    total = int(np.isfinite(poses).all(2).sum())
    note = f"object_pose: {spike.sum()} of {total} poses jump out for one row and back, and are left out"
    return np.where(spike[..., None], np.nan, poses), (note,)


def spike_rows(values: Array, least: float) -> NDArray[np.bool_]:
    """Return `(T,) bool`: rows of readings `(T, D)` that jump out for one row and back, by at least `least`.

    As for poses: far from the neighbours' middle and from both straight lines; and much farther than its neighbours are
    from one another, which a quick motion that stops is not.
    """
    if len(values) < 5:
        return np.zeros(len(values), bool)
    at = values[None, 2:-2]
    around = [values[None, 2 + k : len(values) - 2 + k] - at for k in (-2, -1, 1, 2)]
    before, after = around[1:3]
    returns = np.linalg.norm(after - before, axis=2) < RETURNS * np.linalg.norm(before + after, axis=2) / 2
    return np.pad((_spikes(around, least) & returns)[0], 2)


def without_lost(poses: Array) -> tuple[Array, tuple[str, ...]]:
    """Return poses `(E, T, 7)` with NaN in `lost_rows`, and a note."""
    lost = np.stack([lost_rows(pose) for pose in poses]) if len(poses) else np.zeros(poses.shape[:2], bool)
    if not lost.any():
        return poses, ()
    total = int(np.isfinite(poses).all(2).sum())
    note = (
        f"object_pose: {lost.sum()} of {total} poses stand at one value far from those around them, as where a tracker "
    )
    return np.where(lost[..., None], np.nan, poses), (f"{note}saw nothing, and are left out",)


def lost_rows(pose: Array) -> NDArray[np.bool_]:
    """Return `(T,) bool`: rows of poses `(T, 7)` whose place is one value to the last bit, to which they jump and back.

    The origin, or a value that comes again, in fewer rows than others have. What rests repeats its place without noise,
    but does not jump there.
    """
    place, out = pose[:, :3], np.zeros(len(pose), bool)
    seen = np.asarray(np.isfinite(place).all(1))
    while seen.sum() >= FEWEST and (rows := _jumped_to(place, seen)) is not None:
        out[rows], seen[rows] = True, False
    return out


def _jumped_to(place: Array, seen: NDArray[np.bool_]) -> NDArray[np.int64] | None:
    """Return the rows at the rarest value to which places `(T, 3)` jump and back; None where there is none."""
    rows = np.flatnonzero(seen)
    step = np.linalg.norm(np.diff(place[rows], axis=0), axis=1)
    edges = np.r_[0, np.flatnonzero(step > 0) + 1, len(rows)]
    # Into each run of equal places and out of it there is a jump, unless the episode begins or ends there.
    jumps = np.r_[True, step > max(TIMES * float(np.median(step)), LOST_M), True]
    runs: dict[bytes, list[NDArray[np.int64]]] = {}
    for start, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if jumps[start] and jumps[end] and end - start < len(rows):
            runs.setdefault(place[rows[start]].tobytes(), []).append(rows[start:end])
    # A value of one run alone may be where something lay: only the origin stands for nothing by itself.
    lost = [np.concatenate(spans) for spans in runs.values() if len(spans) > 1 or not place[spans[0][0]].any()]
    rarest = min(lost, key=len, default=None)
    return rarest if rarest is not None and 2 * len(rarest) < len(rows) else None


def _spikes(around: list[Array], least: float) -> NDArray[np.bool_]:
    """Return `(E, N)` which rows are spikes, by where the two rows before and after lie from each `(E, N, D)`."""
    first, before, after, last = around
    lines = (2 * before - first, 2 * after - last, (before + after) / 2)
    away = np.stack([np.sqrt((line**2).sum(2)) for line in lines])
    with np.errstate(invalid="ignore"):
        usual = np.array([[np.median(e[np.isfinite(e)]) if np.isfinite(e).any() else 0.0 for e in one] for one in away])
        return np.asarray((away > np.maximum(TIMES * usual, least)[..., None]).all(0))


#: Share of the usual length, and of a channel's rows, below which an episode is no use.
SHORT = 0.1
#: A stamp may lie this many rows, or this share of the episode, from where the rate puts it: jitter, a drifting clock.
STAMP_ROWS, STAMP_SHARE = 3, 0.03
#: Episodes that lack a channel are left out where this share and this many have it (fewer are not diagnosed);
#: else the channel is.
MOST, FEW = 2 / 3, 8


def whole_episodes(scene: Scene, episodes: list[Episode]) -> tuple[list[Episode], list[str], tuple[str, ...]]:
    """Return the episodes that can be replayed, the channels they share, and what was left out."""
    usual = float(np.median([len(e) for e in episodes])) if episodes else 0.0
    faults = [fault_of(scene, e, usual) for e in episodes]
    sound = [e for e, fault in zip(episodes, faults, strict=True) if fault is None]
    first = next((f for f in faults if f is not None), None)
    if first is not None and not sound:
        raise first
    broken = [(e.meta.id, f.problem) for e, f in zip(episodes, faults, strict=True) if f is not None]
    shared, notes = [], []
    for c in (c for c in COMPARED if _wanted(scene, c)):
        have = [e for e in sound if _seen(e, c)]
        if len(have) < len(sound) and len(have) >= max(FEW, MOST * len(sound)):
            broken += [(e.meta.id, f"without {c}") for e in sound if not _seen(e, c)]
            sound = have
        if len(have) == len(sound):
            shared += [c] * bool(have)
        elif have:
            notes.append(_not_compared(c, len(sound) - len(have), len(sound)))
    if "joint_position" in shared:
        for c in ALONGSIDE:
            lacking = sum(not _seen(e, c) for e in sound)
            shared += [c] * (not lacking)
            notes += [_not_compared(c, lacking, len(sound))] * (0 < lacking < len(sound))
    if broken:
        named = "; ".join(f"{name}: {why}" for name, why in broken[:10])
        more = f"; and {len(broken) - 10} more" if len(broken) > 10 else ""
        notes.append(f"{len(broken)} of {len(episodes)} episodes left out ({named}{more})")
    return sound, shared, tuple(notes)


def _not_compared(channel: str, lacking: int, count: int) -> str:
    """Return the note on a channel that some episodes lack."""
    return f"{channel} is not compared: {lacking} of {count} episodes lack it"


def fault_of(scene: Scene, episode: Episode, usual: float) -> DataError | None:
    """Return why an episode cannot be replayed in the scene, or None; `usual` is the usual number of rows."""
    if len(episode) < max(2.0, SHORT * usual):
        return DataError(
            "episodes are too short to replay",
            expected="at least 2 rows",
            found=f"{len(episode)}",
            where=Where(episode=episode.meta.id),
        )
    try:
        held_commands(scene, episode, recorded_columns(scene, episode))
    except DataError as fault:
        return fault
    return _off_beat(episode)


def _off_beat(episode: Episode) -> DataError | None:
    """Return that rows are missing: a stamp lies far from where the rate puts it. A replay takes one step a row."""
    step = 1 / episode.meta.rate_hz
    steps = np.diff(episode.time_s)
    ratio = float(np.median(steps) * episode.meta.rate_hz)
    if factor := time_factor(ratio) if steps.min() > 0 and ratio > 0 else "":
        return RateError(
            "the rate is another than that of the stamps",
            expected=f"stamps {step:.4g} s apart (rate_hz = {episode.meta.rate_hz:g})",
            found=f"{np.median(steps):.4g} s apart, {1 / np.median(steps):.4g} Hz{factor}",
            where=Where(episode=episode.meta.id, channel="time_ns"),
            fix="give the true rate_hz in map.yaml, or the unit of the time column",
        )
    off = np.abs(episode.time_s - step * np.arange(len(episode)))
    allowed = max(STAMP_ROWS * step, STAMP_SHARE * step * len(episode))
    if off.max() <= allowed:
        return None
    row = int(np.argmax(off > allowed))
    return RateError(
        "stamps do not keep the rate: rows are missing, or the clock jumps",
        expected=f"row {row} at {row * step:.3f} s ({episode.meta.rate_hz:g} Hz)",
        found=f"{episode.time_s[row]:.3f} s",
        where=Where(episode=episode.meta.id, channel="time_ns", index=row),
        fix="import it on a regular grid, or give the true rate",
    )


def _seen(episode: Episode, channel: str) -> bool:
    """Tell whether an episode holds a channel, and more than a few rows of it."""
    return channel in episode and bool(episode.valid(channel).mean() > SHORT)


def _wanted(scene: Scene, channel: str) -> bool:
    """Tell whether the scene can predict a channel."""
    return {
        "joint_position": len(scene.joint_ids) > 0,
        "object_pose": scene.object_id is not None,
        "fingertip_force": len(scene.force_sensors) > 0,
    }[channel]
