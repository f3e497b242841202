"""Joints that do not follow their commands: another zero, no motion, the wrong partner, or no stable servo."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.commands import Paired, enumeration, episode_spread, joint_and_command, moving
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.scenes import Scene

Index = NDArray[np.int64]
Array = NDArray[np.float64]
#: Rows below which stillness says nothing: motions begin at rest.
TOLD_ROWS = 16
#: A joint that moves by less than this share of what the scene's own moves is dead.
DEAD = 0.05
#: Constant [rad] between command and joint beyond which it is another zero: the bound of `joint_offset`.
ZERO_RAD = 0.3


def zero_findings(scene: Scene, p: Paired, nominal: Array) -> list[RecordingMismatch]:
    """Return joints that move with their command but far from it, by more than any effect; others far away as notes."""
    slope, r2 = p.at_best_lag(p.moments.slope()), p.at_best_lag(p.moments.r2())
    flat = (p.joint - nominal).reshape(-1, len(p.names))
    off = flat[np.isfinite(flat).all(1)]
    if not len(off):
        return []
    shift, nearest = off.mean(0), np.quantile(np.abs(off), 0.1, axis=0)
    hinge = scene.model.jnt_type[scene.joint_ids[p.drive.joints]] == mujoco.mjtJoint.mjJNT_HINGE
    far = hinge & (nearest > ZERO_RAD)
    moves = far & (r2 > 0.5) & (slope > 0.5) & (slope < 1.5)
    out = []
    for some, definite in ((moves, True), (far & ~moves, False)):
        names = joint_and_command(p, some)
        if names:
            out.append(
                RecordingMismatch(
                    "zero",
                    definite,
                    "joints stay far from their commands",
                    f"at most {ZERO_RAD:g} rad from where the scene's joints go",
                    ", ".join(f"{n} {s:+.2f} rad" for n, s in zip(names[:6], shift[some], strict=False)),
                    "give command and joint one zero and one sign",
                    "joint_position",
                    names,
                )
            )
    return out


def still_findings(recs: Recordings, p: Paired) -> list[RecordingMismatch]:
    """Return that nothing moves, where neither commands nor joints nor the object do."""
    commanded = episode_spread(p.target) > 1e-3
    moved = "object_pose" in recs.readings and bool(
        (np.nanstd(recs.readings["object_pose"][..., :3], axis=1) > 0.005).any()
    )
    if commanded.any() or moving(p).any() or moved or recs.lengths.max() < TOLD_ROWS:
        return []
    return [
        RecordingMismatch(
            "still",
            False,
            "nothing moves in these recordings",
            "commands that move the joints",
            "constant commands, still joints",
            "record motions, several of each",
            "action",
        )
    ]


def following_findings(p: Paired, nominal: Array) -> list[RecordingMismatch]:
    """Return joints that do not follow their commands, in the recording or in the scene.

    Parameters
    ----------
    nominal : (E, T, S) float64
        What the scene's own joints do under the recorded commands, open loop.
    """
    seen = np.isfinite(p.joint)
    asked, own = (episode_spread(np.where(seen, v, np.nan)) for v in (p.target, nominal))
    real = episode_spread(p.joint)
    commanded = asked > np.maximum(0.01, 10 * p.quiet)
    dead = commanded & (own > 0.3 * asked) & (real < np.maximum(DEAD * own, 1.5 * p.quiet))
    stuck = commanded & (own < 0.1 * asked) & (real > 0.5 * asked)
    both = commanded & (own < 0.1 * asked) & (real < 0.1 * asked)
    out = []
    if both.any():
        names = joint_and_command(p, both)
        out.append(
            RecordingMismatch(
                "scene_still",
                False,
                "neither the recorded joints nor the scene's follow their commands",
                "joints that move when commanded",
                f"still: {enumeration(names)}",
                "look at ranges, gains and links that collide; these joints tell nothing",
                "joint_position",
                names,
            )
        )
    if stuck.any():
        names = joint_and_command(p, stuck)
        out.append(
            RecordingMismatch(
                "scene_stuck",
                True,
                "joints of the scene do not follow their commands",
                "the scene's joints move as the recorded ones do",
                f"still: {enumeration(names)}",
                "look at the model: limits, gains, links that collide, equalities",
                "joint_position",
                names,
            )
        )
    if dead.any():
        names = joint_and_command(p, dead)
        most = bool(2 * dead.sum() > commanded.sum())
        out.append(
            RecordingMismatch(
                "dead_joint",
                most,
                "recorded joints do not follow their commands",
                "joints that move when commanded",
                f"still: {enumeration(names)}",
                "look at motor, wire and encoder"
                if most
                else "held where they were read and left out, not identifiable",
                "joint_position",
                names,
            )
        )
    return out


def unstable_findings(scene: Scene, recs: Recordings, failed: Index, many: float) -> list[RecordingMismatch]:
    """Return that MuJoCo cannot step the nominal scene through the recordings: it simulates nothing then.

    Parameters
    ----------
    scene : Scene
    recs : Recordings
        E episodes that were played.
    failed : (E,) int64
        Row before which it gave each of them up; all rows where it did not.
    many : float
        Share of such episodes from which nothing is diagnosed.
    """
    bad = np.flatnonzero(failed < recs.lengths)
    if not len(bad):
        return []
    when = f"{recs.ids[bad[0]]} after {failed[bad[0]] / scene.file.rate_hz:.2f} s"
    return [
        RecordingMismatch(
            "scene_unstable",
            len(bad) >= many * len(recs),
            "the nominal simulation is unstable under the recorded commands",
            f"a finite state after every step of {1000 * scene.model.opt.timestep:g} ms",
            f"none in {len(bad)} of {len(recs)} episodes that were looked at, first in {when}",
            "give the model a smaller time step, more damping or armature, until it plays these commands; look whether "
            "they are in its order and unit",
            "commands",
        )
    ]
