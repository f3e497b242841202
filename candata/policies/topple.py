"""Strike the object near its top with a fingertip, so that it falls over, and draw back."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from candata.errors import ReachError, Where
from candata.policies import _clear as clear
from candata.policies import _grasps as g
from candata.policies import _postures as p
from candata.policies._carrier import can_follow, carrier
from candata.policies._contract import Array, Goal, Plan, Policy
from candata.policies._trials import object_motion
from candata.rotation import conjugate, rotate
from candata.scenes import Scene
from candata.scenes.clouds import surface_cloud

#: Length for which the times below are written [s]; others stretch them, the stroke excepted.
USUAL_S = 6.0
#: How far the fingertip reaches below the object's top, which is tried one after the other [m], and greatest speed of
#: the stroke [m/s]. An object whose foot would rather slide than stick falls only if it is struck: slowly pushed, it
#: slides.
BELOW_TOP_M, SPEED_MPS = (0.012, 0.02, 0.03), (0.8, 1.2)
#: How far the stroke leads beyond the object's middle, and how far before touching it the hand starts [m].
THROUGH_M, RUN_UP_M = 0.06, 0.05
#: Greatest speed of a minimum-jerk motion over its mean. Source: Flash & Hogan 1985.
PEAK = 1.875
#: Steps in which it is looked for where the hand is clear of the object [m], and how far away at most.
STEP_M, FARTHEST_M = 0.01, 0.2
#: What lies this near to an end of the object is its foot, or its top [m]; headings that are compared, and how far the
#: object is turned from the one that falls most easily (1 sd) [rad].
END_M, HEADINGS, HEADING_SD_RAD = 0.01, 24, 0.1
#: How far the object must tilt in a trial to count as fallen [rad], and how long a trial goes on after the stroke [s].
FALLEN_RAD, FALL_S = np.deg2rad(45.0), 0.6
#: Trials of each stroke.
TRIALS = 4


class Strike(NamedTuple):
    """A stroke of the open hand: two ends `(2, 6)` of its path, and the object's heading [rad]."""

    ends: Array
    heading_rad: float

    def path(self, share: Array) -> Array:
        """Return the path `(T, 6)` at shares `(T,)` of the stroke."""
        return self.ends[0] + share[:, None] * (self.ends[1] - self.ends[0])

    @property
    def length_m(self) -> float:
        """Length of the stroke [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; which stroke, its speed and the object's heading are random."""
    hand, t, strikes = carrier(scene), p.times(scene, duration_s), _strikes(g.SameScene(scene.digest, scene))
    unit = duration_s / USUAL_S
    strike = strikes[int(rng.integers(len(strikes)))]
    stroke_s = PEAK * strike.length_m / rng.uniform(*SPEED_MPS)
    share = p.blend(t, 1.5 * unit, stroke_s) - p.blend(t, 3.0 * unit + stroke_s, 1.5 * unit)
    commands = np.repeat(hand.start[None], len(t), axis=0)
    plan = p.finish(scene, commands, rng, path=strike.path(share))
    heading_rad = strike.heading_rad + HEADING_SD_RAD * rng.standard_normal()
    return g.with_heading(scene, plan, heading_rad, Goal(topple=True))


@lru_cache(maxsize=128)
def _strikes(key: g.SameScene) -> list[Strike]:
    """Return the strokes that topple the object in the most trials.

    Raises
    ------
    ReachError
        When the hand cannot make any.
    """
    scene = key.scene
    possible = [strike for strike in _candidates(scene) if can_follow(scene, strike.ends)]
    if not possible:
        raise ReachError(
            "the hand cannot strike the object near its top",
            expected=f"a stroke of {1000 * (THROUGH_M + RUN_UP_M):.0f} mm or more at the height of the object's top",
            found="none within the reach of what carries the hand",
            where=Where(path=scene.name),
            fix="begin with the hand farther within its reach (keyframe `open`)",
        )
    shares = _fallen(scene, possible).mean(1)
    return [strike for strike, share in zip(possible, shares, strict=True) if share == shares.max()]


def _fallen(scene: Scene, strikes: list[Strike]) -> NDArray[np.bool_]:
    """Return `(n, TRIALS)` whether each stroke topples the object, at low to high speeds and other headings."""
    hand, speeds_mps = carrier(scene), np.linspace(*SPEED_MPS, TRIALS)
    headings_off = HEADING_SD_RAD * np.random.default_rng(0).standard_normal(TRIALS)
    longest_m = max(strike.length_m for strike in strikes)
    t = p.times(scene, PEAK * longest_m / SPEED_MPS[0] + FALL_S)
    shares = [[p.blend(t, 0.0, PEAK * strike.length_m / speed) for speed in speeds_mps] for strike in strikes]
    paths = [strike.path(share) for strike, each in zip(strikes, shares, strict=True) for share in each]
    commands = hand.commands(hand.start, np.concatenate(paths)).reshape(len(paths), len(t), -1)
    headings = [strike.heading_rad + off for strike in strikes for off in headings_off]
    poses = np.array([clear.turned(scene, g.object_pose(scene), heading) for heading in headings])
    attitudes = object_motion(scene, commands, poses)[1]
    ups = rotate(attitudes[:, -1], rotate(conjugate(poses[:, 3:]), np.array([0.0, 0.0, 1.0])))
    return (ups[:, 2] < np.cos(FALLEN_RAD)).reshape(len(strikes), TRIALS)


def _candidates(scene: Scene) -> list[Strike]:
    """Return strokes both ways along each level direction, at several heights, with the lowest fingertip."""
    hand, data = carrier(scene), mujoco.MjData(scene.model)
    out = []
    for forward in [sign * axis for axis in hand.level for sign in (1.0, -1.0)]:
        heading_rad = _easiest_heading(scene, forward)
        pose = clear.turned(scene, g.object_pose(scene), heading_rad)
        points = _surface(scene, pose)
        clear.put(scene, data, hand.start, pose)
        top_m = points[:, 2].max()
        tip, height_m = clear.lowest_fingertip(scene, data)
        middle = points[points[:, 2] > top_m - END_M].mean(0)
        to_middle = middle - data.geom_xpos[tip]
        to_middle[2] = top_m - points[:, 2].min() - height_m
        for below_m in BELOW_TOP_M:
            over = np.concatenate([to_middle - [0, 0, below_m], np.zeros(3)])
            outward = np.concatenate([forward, np.zeros(3)])
            back_m = RUN_UP_M + _clear_from(scene, data, pose, over, outward)
            out.append(Strike(over + np.array([[-back_m], [THROUGH_M]]) * outward, heading_rad))
    return out


def _clear_from(scene: Scene, data: mujoco.MjData, pose: Array, over: Array, outward: Array) -> float:
    """Return how far back [m] the hand must be to be clear of the object."""
    hand, back_m = carrier(scene), np.arange(0.0, FARTHEST_M, STEP_M)
    try:
        all_commands = hand.commands(hand.start, over - back_m[:, None] * outward)
    except ReachError:
        return FARTHEST_M
    for distance_m, commands in zip(back_m[::-1], all_commands[::-1], strict=True):
        clear.put(scene, data, commands, pose)
        if clear.touches(scene, data):
            return float(distance_m + STEP_M)
    return 0.0


def _surface(scene: Scene, pose: Array) -> Array:
    """Return points `(N, 3)` [m] on the object's surface, in the world."""
    return pose[:3] + rotate(pose[3:], surface_cloud(scene).astype(np.float64))


def _easiest_heading(scene: Scene, forward: Array) -> float:
    """Return the heading [rad] at which the foot reaches least far beyond the mass centre along the stroke."""
    headings = 2 * np.pi * np.arange(HEADINGS) / HEADINGS
    reaches = []
    for heading in headings:
        pose = clear.turned(scene, g.object_pose(scene), float(heading))
        points = _surface(scene, pose)
        foot = points[points[:, 2] < points[:, 2].min() + END_M]
        centre = pose[:3] + rotate(pose[3:], scene.model.body_ipos[scene.object_id])
        reaches.append(float(((foot - centre) @ forward).max()))
    return float(headings[int(np.argmin(reaches))])


POLICY = Policy("strike the object over", g.can_carry, _plan, on_request=True)
