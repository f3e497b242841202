"""Which joints and commands lie far beyond the scene's ranges, and in which units they would not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.gap.data.lag import drives
from candata.gap.data.recordings import Recordings
from candata.scenes import Scene
from candata.scenes.motors import affine_law, has_affine_law

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
#: Units that hinges and slides, and velocity servos and motors of both, are recorded in by mistake; the smallest factor
#: first.
TURNS, LENGTHS, RATES, SPEEDS, TORQUES = ("deg", "mrad"), ("cm", "mm"), ("deg/s",), ("mm/s",), ("mN m",)
LEAST: dict[tuple[str, ...], float] = {TURNS: LEAST_RAD, LENGTHS: LEAST_M}


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
