"""What became of the object in an episode, told from its true motion and what the plan was meant to do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from candata.policies import Goal
from candata.rotation import conjugate, multiply, rotate
from candata.scenes import Scene
from candata.scenes.clouds import surface_cloud
from candata.schema.episode import ContactRule

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
#: Rise of the object's lowest point at which it is lifted free [m]. Chosen: the points on a surface lie up to 3 mm from
#: its edges, and a grasp presses an object up and down by as much.
LIFTED_M = 0.01
#: Height of the lowest point above which an object that nothing touches has been dropped [m], and for how long [s].
#: Chosen: scripted hands let go up to 1 cm above the table, and in 0.03 s it falls by 4 mm.
DROP_M, FLIGHT_S = 0.02, 0.03
#: Depth of the lowest point under its first height at which the object has fallen off what it lay on [m]. Chosen.
FALLEN_M = 0.03
#: Fingertips that must press at once, where a hand has so many, and for how long, for the object to be held [s].
#: Chosen: strokes of `push` touch with two for less.
HELD_TIPS, HELD_S = 2, 0.2
#: Way along the support at which an object was moved [m]. Chosen: ten times the noise of a pose tracker.
MOVED_M = 0.01
#: Turn of the side that was up at which the object lies on another one [rad], and how much the height of its centre
#: must vary on the direct way there, as a share of its greatest radius: a ball and a lying can roll there without.
#: Chosen: half of a quarter turn; a scanned baseball varies by 4 %, a cube by 24 %.
TOPPLED_RAD, TIPPING_SHARE = np.pi / 4, 0.1
#: Attitudes looked at on the way from one side to another.
TIPPING_STEPS = 16


@dataclass(frozen=True)
class ObjectMotion:
    """True motion of the object in one episode, from row 0 on.

    Attributes
    ----------
    pose : (T, 7) float64 [m, quaternion w x y z]
        Pose of the object's body.
    touch : (T,) bool
        Whether anything but the support touched the object in the step before the row.
    tips : (T, F) bool
        Which fingertips pressed on anything in the step before the row.
    surface : (N, 3) float64 [m]
        Points on the object, in its frame.
    centre : (3,) float64 [m]
        Its centre of mass, in its frame.
    rate_hz : float
        Rows a second.
    """

    pose: Array
    touch: Flags
    tips: Flags
    surface: Array
    centre: Array
    rate_hz: float

    @cached_property
    def clearance(self) -> Array:
        """`(T,) [m]` how far the lowest point of the object is above the lowest point at row 0."""
        lowest = self.pose[:, 2] + (self.up @ self.surface.T).min(1)
        return lowest - lowest[0]

    @cached_property
    def up(self) -> Array:
        """`(T, 3)` the upward direction in the object's frame."""
        return rotate(conjugate(self.pose[:, 3:]), np.tile([0.0, 0.0, 1.0], (len(self.pose), 1)))

    @cached_property
    def turn(self) -> Array:
        """`(T,) [rad]` the angle by which the object is turned about the vertical from row 0.

        It is the twist of a swing-twist decomposition: P. Dobrowolski, "Swing-twist decomposition in Clifford algebra",
        2015, equation 12.
        """
        relative = multiply(self.pose[:, 3:], conjugate(self.pose[:1, 3:]))
        return 2 * np.arctan2(np.abs(relative[:, 3]), np.abs(relative[:, 0]))

    def lasts(self, flags: Flags, time_s: float) -> bool:
        """Tell whether flags `(T,)` stay set for at least a time, one row at least."""
        rows_needed = max(1, round(time_s * self.rate_hz))
        run = 0
        for flag in flags.tolist():
            run = run + 1 if flag else 0
            if run >= rows_needed:
                return True
        return False


def object_motion(scene: Scene, qpos: Array, touch: Flags, tip_force: Array) -> ObjectMotion:
    """Return the motion of a scene's object from true states `(T, nq)`, touch `(T,)` and tip forces `(T, F)` [N]."""
    at, body = scene.object_qpos, int(scene.object_id or 0)
    return ObjectMotion(
        pose=qpos[:, at : at + 7],
        touch=touch,
        tips=tip_force > ContactRule().threshold_n,
        surface=_surface(scene),
        centre=np.array(scene.model.body_ipos[body], float),
        rate_hz=scene.file.rate_hz,
    )


@lru_cache(maxsize=4)
def _surface(scene: Scene) -> Array:
    """Return the points `(N, 3)` on a scene's object [m], drawn once."""
    return surface_cloud(scene).astype(np.float64)


def outcome(goal: Goal, motion: ObjectMotion) -> str:
    """Return the word for what became of the object, one of `candata.schema.outcome.OUTCOMES`.

    - `drop`: it was lifted free and fell before it was put down, or it fell off what it lay on.
    - `topple`: it ended on another side, without that being meant.
    - `success`: it did all that was meant.
    - `slip`: it was held (pushed, where it was meant to be) and did less than was meant, as when it slides out of the
      fingers or sinks in the grasp.
    - `miss`: the fingertips never held it (never moved it, where it was meant to be pushed).

    The first that holds counts. An object that is meant to slip succeeds when it does not stay in the hand.
    """
    is_held = _was_held(motion)
    if goal.slip and is_held and not _has_toppled(motion) and motion.clearance[-1] < LIFTED_M and _is_met(goal, motion):
        return "success"
    if _was_dropped(motion):
        return "drop"
    if _has_toppled(motion) and not goal.topple:
        return "topple"
    if not goal.slip and _is_met(goal, motion):
        return "success"
    is_grasp = goal.lift_m > 0 or goal.turn_rad > 0 or goal.slip
    return "slip" if (is_held if is_grasp else _was_moved(motion)) else "miss"


def _was_held(motion: ObjectMotion) -> bool:
    """Tell whether enough fingertips pressed on the object at once."""
    enough_tips = motion.tips.sum(1) >= min(HELD_TIPS, motion.tips.shape[1])
    return motion.lasts(motion.touch & enough_tips, HELD_S)


def _was_moved(motion: ObjectMotion) -> bool:
    """Tell whether the object went some way along the support while it was touched."""
    way = np.linalg.norm(motion.pose[:, :2] - motion.pose[0, :2], axis=1)
    return bool((way > MOVED_M).any() and motion.touch.any())


def _was_dropped(motion: ObjectMotion) -> bool:
    """Tell whether the object flew after it was lifted free, or fell off what it lay on."""
    was_lifted = np.logical_or.accumulate(motion.touch & (motion.clearance > LIFTED_M))
    is_flying = was_lifted & ~motion.touch & (motion.clearance > DROP_M)
    return motion.lasts(is_flying, FLIGHT_S) or bool((motion.clearance < -FALLEN_M).any())


def _has_toppled(motion: ObjectMotion) -> bool:
    """Tell whether the object lies on another side at the end, and did not roll there at an even height."""
    first, last = motion.up[0], motion.up[-1]
    angle = float(np.arccos(np.clip(first @ last, -1.0, 1.0)))
    if angle < TOPPLED_RAD or motion.clearance[-1] > LIFTED_M:
        return False
    points = motion.surface - motion.centre
    normal = last - (first @ last) * first
    if np.linalg.norm(normal) < 1e-6:  # upside down: any way leads there
        normal = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    normal /= np.linalg.norm(normal)
    way = np.linspace(0.0, angle, TIPPING_STEPS)[:, None]
    heights = -((np.cos(way) * first + np.sin(way) * normal) @ points.T).min(1)
    return bool(np.ptp(heights) > TIPPING_SHARE * np.linalg.norm(points, axis=1).max())


def _is_met(goal: Goal, motion: ObjectMotion) -> bool:
    """Tell whether the object did everything that a goal asks for but slipping."""
    rise = motion.pose[:, 2] - motion.pose[0, 2]
    way = motion.pose[-1, :3] - motion.pose[0, :3]
    return all(
        (
            goal.lift_m <= 0 or motion.lasts(rise >= goal.lift_m, goal.held_s),
            goal.place_m is None or np.linalg.norm((way - goal.place_m)[:2]) <= goal.place_tolerance_m,
            goal.turn_rad <= 0 or bool((motion.tips.any(1) & (motion.turn >= goal.turn_rad)).any()),
            not goal.topple or _has_toppled(motion),
        )
    )
