"""Commands that do not match the joints: in another unit, another multiple or another sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from candata.gap.data.lag import Drives, Lagged, at_best, centred, drives, lag_moments, own_lag
from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.scenes import Scene
from candata.statistics import noise_sd

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: A joint is looked for in commands of up to this long before [s]: twice the longest `actuation_delay`.
REACH_S = 0.3
#: Squared correlation above which a joint is said to follow a command.
FOLLOWS = 0.8
#: Factors between units that people mix up.
UNITS = {"degrees": 180 / np.pi, "thousandths (mm, mrad)": 1e3, "hundredths (cm, per cent)": 1e2}
#: What map.yaml calls them.
MAPPED = {"degrees": "deg", "thousandths (mm, mrad)": "mrad, or mm of slides", "hundredths (cm, per cent)": "cm"}
#: A slope this many times off the nearest unit's factor still counts as that unit: servos sag, fingers are stopped.
UNIT_WITHIN = 1.7
#: Times its command by which a joint moves in no scene, whatever its servo, unless the scene says so. Chosen.
MULTIPLE = 3.0


@dataclass(frozen=True)
class Paired:
    """Recorded joints of the servos beside their commands.

    Attributes
    ----------
    drive : Drives
        S servos.
    names : tuple of str
        Joints they drive.
    target : (E, T, S) float64
        Where they would rest.
    joint : (E, T, S) float64
        What was recorded of these joints, NaN where not seen.
    moments : Lagged
        Joints against all targets, at lags from 0 up to `REACH_S`.
    """

    drive: Drives
    names: tuple[str, ...]
    target: Array
    joint: Array
    moments: Lagged

    def at_best_lag(self, values: Array) -> Array:
        """Return `(S,)` of values `(L, S, S)`: each joint with its own command at the lag of most correlation."""
        best = np.abs(self.moments.r2()).argmax(0)
        return np.diag(at_best(values, best))

    def moved_as(self, joint: Array) -> Paired:
        """Return the same commands beside other joints `(E, T, S)`."""
        return replace(self, joint=joint, moments=lag_moments(joint, self.target, self.moments.lags))

    @property
    def quiet(self) -> Array:
        """`(S,)` spread of each joint's readings from row to row, by second differences (white noise: its sd)."""
        return noise_sd(self.joint, 1, axes=(0, 1))


def paired(scene: Scene, recs: Recordings) -> Paired | None:
    """Return joints beside commands; None where the scene has no position servos or no joints were recorded."""
    drive = drives(scene)
    if not len(drive.joints) or "joint_position" not in recs.readings:
        return None
    target, joint = drive.targets(recs.commands), recs.readings["joint_position"][..., drive.joints]
    lags = np.arange(min(int(REACH_S * scene.file.rate_hz), target.shape[1] // 3) + 1)
    names = tuple(scene.file.joints[j] for j in drive.joints)
    return Paired(drive, names, target, joint, lag_moments(joint, target, lags))


def unit_findings(scene: Scene, p: Paired) -> list[RecordingMismatch]:
    """Return joints that follow their command at the factor of another unit."""
    slope, r2 = p.at_best_lag(p.moments.slope()), np.abs(p.at_best_lag(p.moments.r2()))
    follows = (r2 > FOLLOWS) & moving(p)
    commanded, out = episode_spread(p.target) > 1e-3, []
    factors = np.array([1 / f for f in UNITS.values()] + list(UNITS.values()))
    ratio = np.abs(np.log(np.maximum(np.abs(slope), 1e-9)[:, None] / factors))
    for k, unit in enumerate([*UNITS, *UNITS]):
        channel = "action" if k < len(UNITS) else "joint_position"
        near = follows & (ratio.argmin(1) == k) & (ratio[:, k] < np.log(UNIT_WITHIN))
        if near.any() and (2 * near.sum() >= commanded.sum() or _beyond(scene, p, near, channel)):
            out.append(_unit(p, near, unit, channel, slope))
    return out


def slope_findings(p: Paired, nominal: Array) -> list[RecordingMismatch]:
    """Return joints that follow their command by a multiple of it, or against its sign, where the scene's do not.

    A weak joint that contact or its neighbours carry along may run against its command in the scene as well.

    Parameters
    ----------
    nominal : (E, T, S) float64
        Joints of the servos in a nominal replay.
    """
    follows = (np.abs(p.at_best_lag(p.moments.r2())) > FOLLOWS) & moving(p)
    slope, scene = p.at_best_lag(p.moments.slope()), p.moved_as(nominal)
    scene_slope = scene.at_best_lag(scene.moments.slope())
    most = np.maximum(np.abs(slope), np.abs(scene_slope))
    follows &= (slope * scene_slope <= 0) | (most > MULTIPLE * np.minimum(np.abs(slope), np.abs(scene_slope)))
    large = follows & (np.abs(slope) > MULTIPLE)
    against = follows & (slope < -1 / MULTIPLE) & ~large
    return [finding(p, some, slope) for finding, some in ((_factor, large), (_reversed, against)) if some.any()]


def moving(p: Paired) -> NDArray[np.bool_]:
    """Return `(S,)` whether a joint moves within episodes by clearly more than its noise."""
    return episode_spread(p.joint) > 5 * p.quiet + 1e-6


def _beyond(scene: Scene, p: Paired, some: NDArray[np.bool_], channel: str) -> bool:
    """Tell whether values of some joints lie more than two ranges of the joint away from it."""
    limited = some & (scene.model.jnt_limited[scene.joint_ids[p.drive.joints]] > 0)
    low, high = scene.model.jnt_range[scene.joint_ids[p.drive.joints]].T
    size = np.nanmax(np.abs(p.target if channel == "action" else p.joint), axis=(0, 1))
    return bool((limited & (size > 2 * (high - low) + np.maximum(np.abs(low), np.abs(high)))).any())


def _unit(p: Paired, some: NDArray[np.bool_], unit: str, channel: str, slope: Array) -> RecordingMismatch:
    """Return the finding that a channel is in another unit."""
    names = joint_and_command(p, some)
    return RecordingMismatch(
        "command_unit" if channel == "action" else "joint_unit",
        True,
        f"{channel} looks like {unit}",
        "rad, or m for slides: a joint moves by about 1 when its command does",
        f"it moves by {np.median(slope[some]):.3g} ({enumeration(names)}), "
        f"as if {channel} were {UNITS[unit]:.4g} times as large",
        f"give the unit of these columns in map.yaml: {MAPPED[unit]}",
        channel,
        names,
    )


def _factor(p: Paired, some: NDArray[np.bool_], slope: Array) -> RecordingMismatch:
    """Return the finding that joints move by a multiple of their commands."""
    names = joint_and_command(p, some)
    return RecordingMismatch(
        "command_unit",
        True,
        "commands are not in the joints' unit",
        "about 1 rad of motion for 1 rad of command",
        f"{np.median(slope[some]):.3g} ({enumeration(names)})",
        "scale the commands to joint targets in rad (m for slides)",
        "action",
        names,
    )


def _reversed(p: Paired, some: NDArray[np.bool_], slope: Array) -> RecordingMismatch:
    """Return the finding that joints run against their commands."""
    names = joint_and_command(p, some)
    return RecordingMismatch(
        "reversed_commands",
        True,
        "joints run against their commands",
        "one sign for command and joint",
        f"a joint moves by {np.median(slope[some]):.2g} when its command moves by 1 ({enumeration(names)})",
        "turn the sign of the command or of the joint",
        "action",
        names,
    )


def late(p: Paired, nominal: Array) -> Array:
    """Return `(S,)` rows by which each recorded joint comes after the scene's own; NaN where it does not follow."""
    reach = min(max(4, p.moments.lags[-1]), p.joint.shape[1] // 4)
    rows = own_lag(p.joint, nominal, int(reach))
    return np.where((np.abs(p.at_best_lag(p.moments.r2())) > FOLLOWS) & moving(p), rows, np.nan)


def episode_spread(values: Array) -> Array:
    """Return `(S,)` the standard deviation within episodes of `values (E, T, S)`, 0 where nothing was seen."""
    own = centred(values)
    count = np.isfinite(own).sum((0, 1))
    return np.sqrt(np.nansum(own**2, axis=(0, 1)) / np.maximum(count, 1))


def joint_and_command(p: Paired, some: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the names of some joints."""
    return tuple(n for n, s in zip(p.names, some, strict=True) if s)


def enumeration(names: Sequence[str], most: int = 6) -> str:
    """Return names as text, the first few."""
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + rest
