"""Rule: quaternions are w x y z.

Three signs, each compared with what is seen when the same numbers are read as x y z w: the angular velocity beside
them; the direction that is up in the object while it stands at one height; the first orientation of each episode.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candata.checks._finding import Finding, Rule
from candata.checks._signal import moving_mean, noise
from candata.checks._view import EpisodeView, round_evidence
from candata.checks.velocities import OVER_S, angular_velocity
from candata.rotation import conjugate, normalise, rotate
from candata.schema.channels import QUATERNION

Array = NDArray[np.float64]
#: Columns of a quaternion as stored, when it is read as x y z w.
XYZW_COLUMNS = [3, 0, 1, 2]
#: By how much the other reading must fit better, and how well at least [rad for directions, share for velocities].
BETTER_TIMES, WELL_RAD, WELL_RATE = 4.0, 0.06, 0.5
#: Turn of the up direction [rad] at one height that is worth a look.
TURNS = 0.2
#: Least height of the up direction on the object's own z while it stands.
UPRIGHT = 0.7
#: Heights [m] that are one height.
LEVEL_M = 0.0015
#: Angle [rad] to the identity within which an orientation is the identity; share of episodes that must begin there.
IDENTITY, IDENTITY_SHARE = 0.06, 0.8
#: Fewest episodes at rest that show clusters, how steady they must lie [rad], and how far sides must be apart [rad].
FEWEST, STEADY_RAD, APART_RAD = 5, 0.03, 0.1
REMEDY = "list the columns in the map as px py pz qw qx qy qz"


@dataclass(frozen=True)
class _Turns:
    """Signs of the order in one pose channel, as stored (0) and read as x y z w (1); NaN where there is none.

    Attributes
    ----------
    id, channel : str
    rate : (2,) float64
        Misfit of the angular velocity.
    up_spread : (2,) float64
        Spread of the up direction at one height [rad].
    first_angle : (2,) float64
        Angle of the first orientation to the identity [rad].
    rest : (2, 3) float64
        Up direction at rest at the end.
    """

    id: str
    channel: str
    rate: Array
    up_spread: Array
    first_angle: Array
    rest: Array


def _gather(view: EpisodeView) -> list[_Turns] | None:
    """Return what an episode tells of each of its pose channels."""
    channel_turns = []
    for channel in sorted(QUATERNION.keys() & view.raw.arrays.keys()):
        pose = view.complete_values(channel)
        if pose is None or len(pose) < 4:
            continue
        readings = [normalise(pose[:, 3:]), normalise(pose[:, 3:][:, XYZW_COLUMNS])]
        first_orientation = readings[0][np.isfinite(readings[0][:, 0])][0]
        angles = 2 * np.arccos(np.clip(np.abs([first_orientation[0], first_orientation[3]]), 0, 1))
        rates = np.array([np.nan, np.nan])
        if channel == "object_pose":
            rates = np.array([_rate_misfit(view, q) for q in readings])
        up_directions = np.stack(
            [rotate(conjugate(q), np.broadcast_to([0.0, 0.0, 1.0], (len(q), 3))) for q in readings]
        )
        channel_turns.append(
            _Turns(view.id, channel, rates, _spreads(pose, up_directions), angles, _rest(view, pose, up_directions))
        )
    return channel_turns or None


def _rate_misfit(view: EpisodeView, quaternion: Array) -> float:
    """Return the rms difference of differenced and stated angular velocity over the latter; NaN without one."""
    velocity = view.complete_values("object_velocity")
    if velocity is None or velocity.shape != (len(quaternion), 6):
        return np.nan
    differenced_spin = angular_velocity(view, quaternion)
    spin = moving_mean(0.5 * (velocity[1:, 3:] + velocity[:-1, 3:]), max(3, round(OVER_S * view.rate_hz)))
    has_both = np.isfinite(differenced_spin).all(axis=1) & np.isfinite(spin).all(axis=1)
    size = float(np.sqrt((spin[has_both] ** 2).mean())) if has_both.sum() > 10 else 0.0
    return float(np.sqrt(((differenced_spin - spin)[has_both] ** 2).mean()) / size) if size > 0.05 else np.nan


def _spreads(pose: Array, up_directions: Array) -> Array:
    """Return how far the up direction strays while the object stays at its most common height [rad], both readings.

    A push or a turn on a table keeps up where it is; read in the wrong order, yaw becomes tilt.
    """
    z = pose[:, 2]
    height_noise = float(noise(z[:, None])[0])
    tolerance = max(LEVEL_M, 4 * height_noise)
    sorted_heights = np.sort(z[np.isfinite(z)])
    counts = np.searchsorted(sorted_heights, sorted_heights + 2 * tolerance, side="right") - np.arange(
        len(sorted_heights)
    )
    low = sorted_heights[int(np.argmax(counts))]
    level = np.isfinite(z) & (z >= low) & (z <= low + 2 * tolerance)
    if level.sum() < 10:
        return np.array([np.nan, np.nan])
    # Read as x y z w, a roll about x at one height looks like an object that stands on its head: that tells nothing.
    if up_directions[1][level][:, 2].mean() < UPRIGHT:
        return np.array([np.nan, np.nan])
    return np.array([_stray(u[level]) for u in up_directions])


def _stray(directions: Array) -> float:
    """Return the 0.9 quantile of the angles to the mean direction [rad]."""
    mean = directions.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size < 1e-9:
        return float(np.pi)
    return float(np.quantile(np.arccos(np.clip(directions @ mean / size, -1, 1)), 0.9))


def _rest(view: EpisodeView, pose: Array, up_directions: Array) -> Array:
    """Return the up directions at the end, where the object rests for a tenth of a second; NaN where it does not.

    What rests keeps its numbers, whatever their order; what sways may do so about an axis that one reading hides.
    """
    rows = max(4, round(0.1 * view.rate_hz))
    z, quaternion = pose[-rows:, 2], normalise(pose[-rows:, 3:])
    if (
        len(pose) < 2 * rows
        or not np.isfinite(pose[-rows:]).all()
        or np.ptp(z) > max(8 * noise(pose[:, 2:3])[0], LEVEL_M)
    ):
        return np.full((2, 3), np.nan)
    turn_angles = 2 * np.arccos(np.clip(np.abs(quaternion @ quaternion[rows // 2]), 0, 1))
    return (
        up_directions[:, -rows:].mean(axis=1) if np.quantile(turn_angles, 0.9) < STEADY_RAD else np.full((2, 3), np.nan)
    )


def _judge(episodes: Sequence[list[_Turns]]) -> Iterator[Finding]:
    """Yield channels, or single episodes, that fit better when read as x y z w."""
    all_turns = [turns for episode in episodes for turns in episode]
    for channel in sorted({turns.channel for turns in all_turns}):
        channel_turns = [turns for turns in all_turns if turns.channel == channel]
        misread_ids = {turns.id for turns in channel_turns if _misfits(turns)}
        for turns in channel_turns:
            if turns.id in misread_ids:
                yield _finding("error", turns, *_misfits(turns))
        yield from _clusters(
            [
                turns
                for turns in channel_turns
                if turns.id not in misread_ids or len(misread_ids) < len(channel_turns) / 2
            ]
        )
        begin = np.array([turns.first_angle for turns in channel_turns])
        if (begin[:, 1] < IDENTITY).mean() >= IDENTITY_SHARE and not (begin[:, 0] < IDENTITY).any():
            problem = "quaternions may be x y z w"
            yield Finding(
                "warning",
                "quaternion_order",
                f"{problem}: nearly every episode begins at 0 0 0 1, the identity in that order",
                channel=channel,
                problem=problem,
                evidence=round_evidence({"episodes": len(channel_turns)}),
                remedy=REMEDY,
            )
        else:
            yield from _odd_episode_findings([turns for turns in channel_turns if turns.id not in misread_ids])


def _misfits(turns: _Turns) -> tuple[float, float, str] | tuple[()]:
    """Return the misfits as stored and read the other way, and of what; nothing where it is in order."""
    as_stored, as_xyzw = turns.rate
    if as_xyzw < WELL_RATE and as_stored > max(BETTER_TIMES * as_xyzw, 0.8):
        return as_stored, as_xyzw, "the angular velocity beside them (misfit)"
    as_stored, as_xyzw = turns.up_spread
    if as_xyzw < WELL_RAD and as_stored > max(TURNS, BETTER_TIMES * as_xyzw):
        return as_stored, as_xyzw, "standing upright at one height (tilt in rad)"
    return ()


def _finding(level: str, turns: _Turns, as_stored: float, as_xyzw: float, sign: str) -> Finding:
    """Return the finding of one episode."""
    problem = "quaternions are x y z w"
    return Finding(
        "error" if level == "error" else "warning",
        "quaternion_order",
        f"{problem}: {sign} is {as_xyzw:.2g} when they are read so, {as_stored:.2g} as w x y z",
        episode=turns.id,
        channel=turns.channel,
        problem=problem,
        evidence=round_evidence({"as_stored": as_stored, "as_xyzw": as_xyzw, "sign": sign}),
        remedy=REMEDY,
    )


def _odd_episode_findings(channel_turns: Sequence[_Turns]) -> Iterator[Finding]:
    """Yield episodes that begin at 0 0 0 1 where nearly all others begin at 1 0 0 0."""
    begin = np.array([turns.first_angle for turns in channel_turns]).reshape(-1, 2)
    is_usual, is_odd = begin[:, 0] < IDENTITY, begin[:, 1] < IDENTITY
    if is_usual.sum() < 3 or is_usual.sum() < IDENTITY_SHARE * (~is_odd).sum():
        return
    for k in np.flatnonzero(is_odd).tolist():
        yield _finding(
            "warning", channel_turns[k], begin[k, 0], begin[k, 1], "the turn at the beginning, zero in other episodes,"
        )


def _clusters(channel_turns: Sequence[_Turns]) -> Iterator[Finding]:
    """Yield that the sides on which an object comes to rest are few only when read as x y z w."""
    resting_turns = [turns for turns in channel_turns if np.isfinite(turns.rest[1]).all()]
    if len(resting_turns) < FEWEST:
        return
    sides = np.array([turns.rest for turns in resting_turns])
    # Read as x y z w, every turn about x stands on its head: what rolled there by any angle seems to repeat.
    if sides[:, 1, 2].mean() < -UPRIGHT:
        return
    as_stored, as_xyzw = (_repeat(sides[:, k]) for k in (0, 1))
    if as_xyzw < WELL_RAD and as_stored > max(APART_RAD, BETTER_TIMES * as_xyzw):
        problem = "quaternions are x y z w"
        yield Finding(
            "error",
            "quaternion_order",
            f"{problem}: the sides on which objects come to rest repeat within "
            f"{as_xyzw:.2g} rad when they are read so, {as_stored:.2g} rad as w x y z",
            channel=channel_turns[0].channel,
            problem=problem,
            evidence=round_evidence({"as_stored": as_stored, "as_xyzw": as_xyzw, "episodes": len(resting_turns)}),
            remedy=REMEDY,
        )


def _repeat(directions: Array) -> float:
    """Return the median angle of directions `(N, 3)` to the nearest other one [rad]."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    cosines = unit @ unit.T
    np.fill_diagonal(cosines, -1.0)
    return float(np.median(np.arccos(np.clip(cosines.max(axis=1), -1, 1))))


RULE = Rule(meaning="quaternions are w x y z", gather=_gather, judge=_judge, idle_reason="no poses")
