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
from candata.checks._signal import noise, smooth
from candata.checks._view import View, rounded
from candata.checks.velocities import OVER_S, turning
from candata.rotation import conjugate, normalise, rotate
from candata.schema.channels import QUATERNION

Array = NDArray[np.float64]
#: Columns of a quaternion as stored, when it is read as x y z w.
OTHER = [3, 0, 1, 2]
#: By how much the other reading must fit better, and how well at least [rad for directions, share for velocities].
BETTER, WELL, WELL_RATE = 4.0, 0.06, 0.5
#: Turn of the up direction [rad] at one height that is worth a look.
TURNS = 0.2
#: Least height of the up direction on the object's own z while it stands.
UPRIGHT = 0.7
#: Heights [m] that are one height.
LEVEL_M = 0.0015
#: Angle [rad] to the identity within which an orientation is the identity; share of episodes that must begin there.
IDENTITY, MOST = 0.06, 0.8
#: Fewest episodes at rest that show clusters, how steady they must lie [rad], and how far sides must be apart [rad].
FEWEST, STEADY, APART = 5, 0.03, 0.1
REMEDY = "list the columns in the map as px py pz qw qx qy qz"


@dataclass(frozen=True)
class _Turns:
    """What an episode tells of one pose channel, as stored (0) and read as x y z w (1); NaN where it tells nothing.

    Attributes
    ----------
    rate : (2,) float64
        Misfit of the angular velocity.
    up : (2,) float64
        Spread of the up direction at one height [rad].
    first : (2,) float64
        Angle of the first orientation to the identity [rad].
    rest : (2, 3) float64
        Up direction at rest at the end.
    """

    id: str
    channel: str
    rate: Array
    up: Array
    first: Array
    rest: Array


def _gather(view: View) -> list[_Turns] | None:
    """Return what an episode tells of each of its pose channels."""
    found = []
    for channel in sorted(QUATERNION.keys() & view.raw.arrays.keys()):
        pose = view.whole(channel)
        if pose is None or len(pose) < 4:
            continue
        both = [normalise(pose[:, 3:]), normalise(pose[:, 3:][:, OTHER])]
        first = both[0][np.isfinite(both[0][:, 0])][0]
        angles = 2 * np.arccos(np.clip(np.abs([first[0], first[3]]), 0, 1))
        rates = np.array([np.nan, np.nan])
        if channel == "object_pose":
            rates = np.array([_rate_misfit(view, q) for q in both])
        up = np.stack([rotate(conjugate(q), np.broadcast_to([0.0, 0.0, 1.0], (len(q), 3))) for q in both])
        found.append(_Turns(view.id, channel, rates, _spreads(pose, up), angles, _rest(view, pose, up)))
    return found or None


def _rate_misfit(view: View, quaternion: Array) -> float:
    """Return the rms difference of differenced and stated angular velocity over the latter; NaN without one."""
    velocity = view.whole("object_velocity")
    if velocity is None or velocity.shape != (len(quaternion), 6):
        return np.nan
    found = turning(view, quaternion)
    spin = smooth(0.5 * (velocity[1:, 3:] + velocity[:-1, 3:]), max(3, round(OVER_S * view.rate_hz)))
    seen = np.isfinite(found).all(axis=1) & np.isfinite(spin).all(axis=1)
    size = float(np.sqrt((spin[seen] ** 2).mean())) if seen.sum() > 10 else 0.0
    return float(np.sqrt(((found - spin)[seen] ** 2).mean()) / size) if size > 0.05 else np.nan


def _spreads(pose: Array, up: Array) -> Array:
    """Return how far the up direction strays while the object stays at its most common height [rad], both readings.

    A push or a turn on a table keeps up where it is; read in the wrong order, yaw becomes tilt.
    """
    z = pose[:, 2]
    quiet = float(noise(z[:, None])[0])
    within = max(LEVEL_M, 4 * quiet)
    ordered = np.sort(z[np.isfinite(z)])
    counts = np.searchsorted(ordered, ordered + 2 * within, side="right") - np.arange(len(ordered))
    low = ordered[int(np.argmax(counts))]
    level = np.isfinite(z) & (z >= low) & (z <= low + 2 * within)
    if level.sum() < 10:
        return np.array([np.nan, np.nan])
    # Read as x y z w, a roll about x at one height looks like an object that stands on its head: that tells nothing.
    if up[1][level][:, 2].mean() < UPRIGHT:
        return np.array([np.nan, np.nan])
    return np.array([_stray(u[level]) for u in up])


def _stray(directions: Array) -> float:
    """Return the 0.9 quantile of the angles to the mean direction [rad]."""
    mean = directions.mean(axis=0)
    size = float(np.linalg.norm(mean))
    if size < 1e-9:
        return float(np.pi)
    return float(np.quantile(np.arccos(np.clip(directions @ mean / size, -1, 1)), 0.9))


def _rest(view: View, pose: Array, up: Array) -> Array:
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
    turned = 2 * np.arccos(np.clip(np.abs(quaternion @ quaternion[rows // 2]), 0, 1))
    return up[:, -rows:].mean(axis=1) if np.quantile(turned, 0.9) < STEADY else np.full((2, 3), np.nan)


def _judge(seen: Sequence[list[_Turns]]) -> Iterator[Finding]:
    """Yield channels, or single episodes, that fit better when read as x y z w."""
    flat = [one for some in seen for one in some]
    for channel in sorted({one.channel for one in flat}):
        mine = [one for one in flat if one.channel == channel]
        told = {one.id for one in mine if _turned(one)}
        for one in mine:
            if one.id in told:
                yield _finding("error", one, *_turned(one))
        yield from _clusters([one for one in mine if one.id not in told or len(told) < len(mine) / 2])
        begin = np.array([one.first for one in mine])
        if (begin[:, 1] < IDENTITY).mean() >= MOST and not (begin[:, 0] < IDENTITY).any():
            problem = "quaternions may be x y z w"
            yield Finding(
                "warning", "quaternion_order", f"{problem}: nearly every episode begins at 0 0 0 1, the identity in "
                "that order", None, channel, None, problem, (), rounded({"episodes": len(mine)}), REMEDY,
            )  # fmt: skip
        else:
            yield from _single([one for one in mine if one.id not in told])


def _turned(one: _Turns) -> tuple[float, float, str] | tuple[()]:
    """Return the misfits as stored and read the other way, and of what; nothing where it is in order."""
    given, other = one.rate
    if other < WELL_RATE and given > max(BETTER * other, 0.8):
        return given, other, "the angular velocity beside them (misfit)"
    given, other = one.up
    if other < WELL and given > max(TURNS, BETTER * other):
        return given, other, "standing upright at one height (tilt in rad)"
    return ()


def _finding(level: str, one: _Turns, given: float, other: float, what: str) -> Finding:
    """Return the finding of one episode."""
    problem = "quaternions are x y z w"
    return Finding(
        "error" if level == "error" else "warning", "quaternion_order",
        f"{problem}: {what} is {other:.2g} when they are read so, {given:.2g} as w x y z", one.id, one.channel, None,
        problem, (), rounded({"as_stored": given, "as_xyzw": other, "sign": what}), REMEDY,
    )  # fmt: skip


def _single(mine: Sequence[_Turns]) -> Iterator[Finding]:
    """Yield episodes that begin at 0 0 0 1 where nearly all others begin at 1 0 0 0."""
    begin = np.array([one.first for one in mine]).reshape(-1, 2)
    usual, odd = begin[:, 0] < IDENTITY, begin[:, 1] < IDENTITY
    if usual.sum() < 3 or usual.sum() < MOST * (~odd).sum():
        return
    for k in np.flatnonzero(odd).tolist():
        yield _finding(
            "warning", mine[k], begin[k, 0], begin[k, 1], "the turn at the beginning, zero in other episodes,"
        )


def _clusters(mine: Sequence[_Turns]) -> Iterator[Finding]:
    """Yield that the sides on which an object comes to rest are few only when read as x y z w."""
    resting = [one for one in mine if np.isfinite(one.rest[1]).all()]
    if len(resting) < FEWEST:
        return
    sides = np.array([one.rest for one in resting])
    # Read as x y z w, every turn about x stands on its head: what rolled there by any angle seems to repeat.
    if sides[:, 1, 2].mean() < -UPRIGHT:
        return
    given, other = (_repeat(sides[:, k]) for k in (0, 1))
    if other < WELL and given > max(APART, BETTER * other):
        problem = "quaternions are x y z w"
        yield Finding(
            "error", "quaternion_order", f"{problem}: the sides on which objects come to rest repeat within "
            f"{other:.2g} rad when they are read so, {given:.2g} rad as w x y z", None, mine[0].channel, None, problem,
            (),
            rounded({"as_stored": given, "as_xyzw": other, "episodes": len(resting)}), REMEDY,
        )  # fmt: skip


def _repeat(directions: Array) -> float:
    """Return the median angle of directions `(N, 3)` to the nearest other one [rad]."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    cosines = unit @ unit.T
    np.fill_diagonal(cosines, -1.0)
    return float(np.median(np.arccos(np.clip(cosines.max(axis=1), -1, 1))))


RULE = Rule(meaning="quaternions are w x y z", gather=_gather, judge=_judge, idle="no poses")
