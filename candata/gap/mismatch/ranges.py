"""Joints, commands and poses far outside what the scene allows, in all episodes or in some: another unit or zero."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.data.lag import at_best, drives, lagged
from candata.gap.data.recordings import Recordings
from candata.gap.mismatch.commands import UNIT_WITHIN, Paired
from candata.gap.mismatch.recording_mismatch import RecordingMismatch
from candata.gap.mismatch.swaps import AT_LEAST, in_episodes
from candata.scenes import Scene
from candata.scenes.motors import affine_law, has_affine_law
from candata.units import TO_SI

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Ranges by which a value lies beyond its joint's own range before it is far from it. Chosen: limits give by hundredths
#: of a radian, and a model's range is seldom short by as much as its width.
RANGES = 1.0
#: Least distance from its range at which a hinge [rad] or a slide [m] is far from it, however narrow the range is.
#: Chosen: half a turn, and more than a hand travels; of degrees and millimetres they are next to nothing.
LEAST_RAD, LEAST_M = np.pi, 0.5
#: Share of the rows of an episode, and number, of which more must be as far: spikes of an encoder are fewer. Chosen.
ROWS, FEW_ROWS = 0.1, 2
#: Share of a joint's range by which values brought to another unit may still lie beyond it. Chosen.
SLACK = 0.25
#: Share of the episodes in which it must be seen to be sure, beside `AT_LEAST`; in fewer it is a note. Chosen.
SHARE = 0.05
#: Share of its squared correlation with any command that a joint's with its own must reach to be its own. Chosen.
STEADY = 0.9
#: Units that hinges and slides, and velocity servos and motors of both, are recorded in by mistake; the smallest factor
#: first.
TURNS, LENGTHS, RATES, SPEEDS, TORQUES = ("deg", "mrad"), ("cm", "mm"), ("deg/s",), ("mm/s",), ("mN m",)
LEAST: dict[tuple[str, ...], float] = {TURNS: LEAST_RAD, LENGTHS: LEAST_M}
#: Units in words.
WORDS = {
    "deg": "degrees",
    "mrad": "milliradians",
    "cm": "centimetres",
    "mm": "millimetres",
    "deg/s": "degrees a second",
    "mm/s": "millimetres a second",
    "mN m": "thousandths of a newton metre",
}


@dataclass(frozen=True)
class Beyond:
    """Columns of a channel beside the range that the scene gives them.

    Attributes
    ----------
    channel : str
        `joint_position` or `action`.
    names : tuple of str
        C columns.
    values : (E, T, C) float64
        Recorded [rad or m; of a motor in its own unit].
    low, high : (C,) float64
        Range; infinite where the scene gives none.
    units : tuple of tuple of str
        What each column may be in by mistake.
    mixed : bool
        Whether the channel has columns of other kinds beside these.
    """

    channel: str
    names: tuple[str, ...]
    values: Array
    low: Array
    high: Array
    units: tuple[tuple[str, ...], ...]
    mixed: bool = False

    @property
    def kinds(self) -> tuple[tuple[str, ...], ...]:
        """Kinds of columns, by what they may be in, of which some lie far outside; hinges first."""
        far = dict.fromkeys(self.units[c] for c in np.flatnonzero(self.far.any(0)))
        return tuple(sorted(far, key=lambda kind: kind != TURNS))

    def of(self, kind: tuple[str, ...]) -> Beyond:
        """Return the columns of one kind."""
        some = [c for c, u in enumerate(self.units) if u == kind]
        return replace(
            self,
            names=tuple(self.names[c] for c in some),
            values=self.values[..., some],
            low=self.low[some],
            high=self.high[some],
            units=(kind,) * len(some),
            mixed=len(some) < len(self.units),
        )

    @property
    def far(self) -> Mask:
        """`(E, C)` whether more than a few rows of an episode lie far outside."""
        least = np.array([LEAST.get(u, 0.0) for u in self.units])
        beyond = np.maximum(self.values - self.high, self.low - self.values)
        rows = (beyond > np.maximum(RANGES * (self.high - self.low), least)).sum(1)
        return np.asarray(rows > np.maximum(ROWS * np.isfinite(self.values).sum(1), FEW_ROWS))


def joints_beyond(scene: Scene, recs: Recordings) -> Beyond | None:
    """Return the recorded joints beside their ranges; None where none were recorded.

    A range is as wide as the model's limits or as what the joint's servo may be commanded, whatever is wider: a joint
    that the model locks is no unit.
    """
    if "joint_position" not in recs.readings:
        return None
    low, high = _joint_ranges(scene)
    servo, limited = drives(scene), _command_ranges(scene)
    for column, joint, slope, offset in zip(servo.columns, servo.joints, servo.slope, servo.offset, strict=True):
        ends = np.sort(np.array([v[column] for v in limited]) * slope + offset)
        low[joint], high[joint] = min(low[joint], ends[0]), max(high[joint], ends[1])
    return Beyond("joint_position", scene.file.joints, recs.readings["joint_position"], low, high, _joint_units(scene))


def commands_beyond(scene: Scene, recs: Recordings) -> Beyond | None:
    """Return the commands beside the ranges of their actuators; None without actuators."""
    ids = scene.actuator_ids
    if not len(ids):
        return None
    low, high = _command_ranges(scene)
    units = tuple(_command_units(scene, int(a)) for a in ids)
    servo = drives(scene)
    ranges = _joint_ranges(scene)
    for column, joint, slope, offset in zip(servo.columns, servo.joints, servo.slope, servo.offset, strict=True):
        if not np.isfinite(low[column]):
            low[column], high[column] = np.sort((np.array([v[joint] for v in ranges]) - offset) / slope)
    return Beyond("action", scene.file.actuator_names, recs.commands, low, high, units)


def _command_units(scene: Scene, actuator: int) -> tuple[str, ...]:
    """Return what the commands of an actuator may be recorded in by mistake."""
    joint, (_, ((_, place, speed),)) = scene.driven_joints.get(actuator), affine_law(scene.model, [actuator])
    slide = joint is not None and scene.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    if not has_affine_law(scene.model, [actuator])[0]:
        return TORQUES
    if place == 0 and speed != 0:
        return SPEEDS if slide else RATES
    return LENGTHS if slide else TURNS


def _command_ranges(scene: Scene) -> tuple[Array, Array]:
    """Return the range of each actuator's commands `(A,)`; infinite where the model gives none."""
    model, ids = scene.model, scene.actuator_ids
    limited = model.actuator_ctrllimited[ids] > 0
    low, high = np.asarray(model.actuator_ctrlrange[ids], float).reshape(-1, 2).T
    return np.where(limited, low, -np.inf), np.where(limited, high, np.inf)


def _joint_ranges(scene: Scene) -> tuple[Array, Array]:
    """Return the range of each joint `(J,)`; infinite where the model gives none."""
    model, ids = scene.model, scene.joint_ids
    limited = model.jnt_limited[ids] > 0
    low, high = np.asarray(model.jnt_range[ids], float).reshape(-1, 2).T
    return np.where(limited, low, -np.inf), np.where(limited, high, np.inf)


def _joint_units(scene: Scene) -> tuple[tuple[str, ...], ...]:
    """Return what each joint may be recorded in by mistake."""
    kinds = scene.model.jnt_type[scene.joint_ids]
    return tuple(LENGTHS if kind == mujoco.mjtJoint.mjJNT_SLIDE else TURNS for kind in kinds)


@dataclass(frozen=True)
class _Following:
    """How recorded joints follow commands in some episodes.

    Attributes
    ----------
    servos : (S,) bool
        Servos whose column of the channel lies far outside.
    steady : (S,) bool
        Whether a joint follows its own command about as closely as any other.
    slope : (S,) float64
        By how much a joint moves when its command moves by 1.
    """

    servos: Mask
    steady: Mask
    slope: Array


def range_findings(scene: Scene, recs: Recordings, pairs: Paired | None) -> list[RecordingMismatch]:
    """Return joints and commands that lie far outside their ranges, with the unit that would bring them back.

    Nothing where joints follow another command than their own: then it is the order that is wrong.

    Parameters
    ----------
    pairs : Paired, optional
        The same recordings, joints beside the commands of their servos.
    """
    channels = [b for b in (joints_beyond(scene, recs), commands_beyond(scene, recs)) if b is not None]
    episodes: dict[str, Mask] = {b.channel: np.asarray(b.far.any(1)) for b in channels}
    out = []
    for b in channels:
        some = episodes[b.channel]
        alone = not any((some & e).any() for name, e in episodes.items() if name != b.channel)
        follows = None if pairs is None or not some.any() else _following(b, pairs, some)
        if follows is None or 2 * follows.steady[follows.servos].sum() >= follows.servos.sum():
            out += [_outside(b.of(kind), recs, follows, alone) for kind in b.kinds]
    return out


def _following(b: Beyond, p: Paired, episodes: Mask) -> _Following:
    """Return how joints follow commands in some episodes."""
    found = lagged(p.joint[episodes], p.target[episodes], p.found.lags)
    r2 = np.abs(found.r2())
    best = r2.argmax(0)
    each = at_best(r2, best)
    columns = p.drive.joints if b.channel == "joint_position" else p.drive.columns
    far = np.asarray(b.far[episodes].any(0))[columns]
    return _Following(far, np.diag(each) >= STEADY * each.max(1), np.diag(at_best(found.slope(), best)))


def _outside(b: Beyond, recs: Recordings, follows: _Following | None, alone: bool) -> RecordingMismatch:
    """Return the finding that columns of a channel lie far outside in some episodes.

    Parameters
    ----------
    alone : bool
        Whether the other channel is where it should be in these episodes: then joints tell the factor.
    """
    episodes: Mask = np.asarray(b.far.any(1))
    columns = np.flatnonzero(b.far.any(0))
    slope = np.abs(follows.slope[follows.servos]) if follows is not None and follows.servos.any() and alone else None
    shifted = slope is not None and bool((slope > 1 / 3).all() and (slope < 3).all())
    unit = "" if shifted else _unit(b, columns, slope)
    names = tuple(b.names[c] for c in columns)
    sure = bool(episodes.all() or episodes.sum() >= max(AT_LEAST, SHARE * len(episodes)))
    text = _reach(b, columns) + ("" if episodes.all() else f", at least {in_episodes(recs, episodes)}")
    kind = {"joint_position": "joint_unit", "action": "command_unit"}[b.channel]
    expected = f"{b.channel} in rad (m for slides), within the range that the scene gives"
    if shifted:
        return RecordingMismatch(
            "zero",
            sure,
            f"{b.channel} lies far outside its range, though it moves as it should",
            expected,
            text,
            "give command and joint one zero",
            b.channel,
            names,
        )
    if not unit:
        return RecordingMismatch(
            kind,
            sure and b.channel == "joint_position",
            f"{b.channel} lies far outside the range of the scene",
            expected,
            f"{text}; no known unit brings it back",
            "give its unit or scale in map.yaml, mend the range in the model, or put its columns in order",
            b.channel,
            names,
        )
    other = "" if alone else f", and look at {'action' if b.channel == 'joint_position' else 'joint_position'} too"
    where = "" if episodes.all() else " of these episodes"
    columns_of = mapped(b.channel, unit, b.names if b.mixed else ())
    return RecordingMismatch(
        kind,
        sure,
        f"{b.channel} looks like {WORDS[unit]}",
        expected,
        f"{text}: {1 / TO_SI[unit]:.4g} times what fits",
        f"give its unit in map.yaml{where}: {columns_of}{other}",
        b.channel,
        names,
    )


def _reach(b: Beyond, columns: NDArray[np.int64]) -> str:
    """Return how far the farthest column reaches, its range, and how many columns lie outside."""
    size = np.nanmax(np.abs(b.values[..., columns]), axis=(0, 1))
    c = columns[size.argmax()]
    names = [b.names[k] for k in columns]
    others = f" ({len(names)} of {len(b.names)} such columns)" if len(names) > 1 else ""
    return f"{b.names[c]} reaches {size.max():.4g}, its range is {b.low[c]:.4g} to {b.high[c]:.4g}{others}"


def mapped(channel: str, unit: str, columns: tuple[str, ...] = ()) -> str:
    """Return how map.yaml says that a channel is in a unit, or some of its columns."""
    if not columns:
        return f"`units: {{{channel}: {unit}}}`"
    more = f" and {len(columns) - 4} more" if len(columns) > 4 else ""
    return f"`units: {{COLUMN: {unit}}}` for the columns of {', '.join(columns[:4])}{more}"


def _unit(b: Beyond, columns: NDArray[np.int64], slope: Array | None) -> str:
    """Return the unit that brings the columns back into their ranges, by the joints' own motion where that tells."""
    choices = b.units[columns[0]]
    if slope is not None:
        factor = float(np.median(slope)) ** (1 if b.channel == "joint_position" else -1)
        near = min(choices, key=lambda u: abs(np.log(factor * TO_SI[u])))
        if abs(np.log(factor * TO_SI[near])) < np.log(UNIT_WITHIN):
            return near
    return next((u for u in choices if _fits(b, columns, TO_SI[u])), "")


def _fits(b: Beyond, columns: NDArray[np.int64], factor: float) -> bool:
    """Tell whether columns lie in their ranges when they are taken times a factor, but for a few rows."""
    values, slack = b.values[..., columns] * factor, SLACK * (b.high - b.low)[columns]
    outside = (values > b.high[columns] + slack) | (values < b.low[columns] - slack)
    return bool((outside.sum((0, 1)) <= ROWS * np.isfinite(values).sum((0, 1))).all())
