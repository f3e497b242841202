"""Grasps of any object: where opposing fingertips meet it, clear of all else, tried by lifting."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import mujoco
import numpy as np

from candata.errors import ReachError, SceneError, Where
from candata.policies import _clear as clear
from candata.policies import _drive as d
from candata.policies import _postures as p
from candata.policies._carrier import carrier
from candata.policies._closing import Pinch, pinches
from candata.policies._contract import Array, Goal, Plan
from candata.policies._grasp import Hand, hand_of
from candata.policies._opposing import chords
from candata.policies._trials import LIFT_M, Trial, lift_worths
from candata.rotation import conjugate, exp, multiply, rotate
from candata.scenes import Scene
from candata.scenes.clouds import surface_cloud

#: Lines through the object that are looked at, so many at once, until enough grasps are clear. Chosen: 0.1 s a round.
LINES, ROUNDS, SEED = 1500, 4, 0
#: Largest tilt of the hand, where what carries it can turn it [rad]. Chosen.
MOST_TILT_RAD = np.deg2rad(60.0)
#: Friction of a line through two opposing points: its angles to both normals lie within this cone. Chosen below the 0.8
#: of the built-in fingers, which leaves a margin.
FRICTION = 0.5
#: How far the fingertips' gap may be from the width between the points [m]: half a fingertip. And the largest angle
#: between their line and the points' [rad]. Chosen; trials show what holds.
FIT_M, FIT_RAD = 0.006, 0.35
#: Distance of the line from the mass centre that costs as much as the loss of all alignment [m]. Chosen: a finger's.
OFF_CENTRE_M = 0.05
#: Distance that the hand keeps from the support [m], and how much higher than the line it may grasp for that [m], if
#: that is not farther above the object's top than fingertips reach below the line.
CLEAR_M, MOST_RAISE_M, LOWER_M = 0.004, 0.03, 0.012
#: From how far the open hand comes to its grasp [m]: more than a finger's width.
APPROACH_M = 0.09
#: How far the fingers close beyond where they touch, as a share of the way from open to closed. Chosen: with the servos
#: of the built-in hand 0.1 to 0.5 N m at the finger's base.
SQUEEZE = (0.15, 0.6)
#: Grasps that are tried by one lift; the best of them that are tried again, so many times; the most that are kept, and
#: the least mean worth of their lifts, as a share of the best. Chosen for a second of CPU time.
TRIED, TRIED_AGAIN, TIMES, KEPT, GOOD_SHARE = 32, 8, 4, 4, 0.8
#: How the object stands off, is turned, and the grip differs when a grasp is tried again (1 sd, 1 sd, range): more than
#: policies do.
OFF_SD_M, OFF_SD_RAD, GRIP = 0.005, 0.05, (0.92, 1.1)


@dataclass(frozen=True, eq=False)
class Grasp:
    """A grasp of the object.

    Attributes
    ----------
    open, closed : (A,) float64
        Commands of the open and of the closed hand; alike for what carries the hand.
    path : (6,) float64
        Where the hand goes for it, see `Carrier.commands`.
    heading_rad : float
        How far the object is turned about the vertical through its mass centre, from its place in the model [rad].
    approach : (3,) float64
        Unit vector along which the open hand leaves the object without touching it; it comes the other way.
    """

    open: Array
    closed: Array
    path: Array
    heading_rad: float
    approach: Array

    def way_in(self, share: Array) -> Array:
        """Return the path `(T, 6)` of a hand that is away at share 0, at the object at share 1, `(T,)`."""
        path = np.repeat(self.path[None], len(share), axis=0)
        path[:, :3] += APPROACH_M * (1 - share)[:, None] * self.approach
        return path

    def commands(self, grip: Array) -> Array:
        """Return the commands `(T, A)` of fingers that grip so much `(T,)`: 0 is open, 1 closed."""
        return self.open + grip[:, None] * (self.closed - self.open)


def grasps(scene: Scene) -> tuple[Grasp, ...]:
    """Return a few grasps of the scene's object, the most reliable first; kept for scenes of the same digest.

    Lines through the object are matched with pairs of fingertips that close on each other: as far apart as the line is
    long inside the object, along it, at normals within the friction cone. The object's heading is chosen, and the
    hand's place, as far as what carries it can go. The hand stays clear of the support, and of the object until it
    closes. The likeliest grasps are tried in simulated lifts, the best of these again with the object off its place.

    Raises
    ------
    SceneError
        When nothing carries the hand up, or no grasp reaches the object.
    """
    return _kept(SameScene(scene.digest, scene))


def chosen_grasp(scene: Scene, rng: np.random.Generator) -> Grasp:
    """Return one of the grasps of `grasps`, at random."""
    kept = grasps(scene)
    return kept[int(rng.integers(len(kept)))]


def object_pose(scene: Scene) -> Array:
    """Return the pose `(7,)` of the object in the model."""
    return np.array(scene.model.qpos0[scene.object_qpos : scene.object_qpos + 7])


def can_carry(scene: Scene) -> bool:
    """Tell whether the scene has an object, two fingertips, and what carries the hand up and along the support."""
    if scene.object_id is None or len(scene.fingertip_bodies) < 2:
        return False
    hand = carrier(scene)
    return hand.lift is not None and len(hand.level) > 0


def with_heading(scene: Scene, plan: Plan, heading_rad: float, goal: Goal | None) -> Plan:
    """Return the plan with its object turned about the vertical through its mass centre, and what it is meant to do."""
    qpos, at = plan.qpos.copy(), scene.object_qpos
    qpos[at : at + 7] = clear.turned(scene, qpos[at : at + 7], heading_rad)
    return replace(plan, qpos=qpos, goal=goal)


@dataclass(frozen=True)
class SameScene:
    """A scene that equals others of its digest."""

    digest: str
    scene: Scene = field(compare=False)


@lru_cache(maxsize=128)
def _kept(key: SameScene) -> tuple[Grasp, ...]:
    """Return the grasps of a scene."""
    search = _Search(key.scene)
    candidates = search.candidates()
    trials = [search.trial(grasp, np.zeros(3), 1.0) for grasp in candidates]
    first_worths = lift_worths(key.scene, trials)
    best = [candidates[i] for i in np.argsort(-first_worths, kind="stable")[:TRIED_AGAIN]]
    rng = np.random.default_rng(SEED)
    off = rng.standard_normal((len(best) * TIMES, 3)) * (OFF_SD_M, OFF_SD_M, OFF_SD_RAD)
    grips = rng.uniform(*GRIP, len(off))
    again = [search.trial(best[i // TIMES], off[i], grips[i]) for i in range(len(off))]
    worths = lift_worths(key.scene, again).reshape(-1, TIMES).mean(1)
    order = np.argsort(-worths, kind="stable")[:KEPT]
    return tuple(best[i] for i in order if worths[i] >= GOOD_SHARE * worths.max())


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A line through the object and the fingertips that fit it: where hand and object go, and how good it looks."""

    score: float
    pinch: Pinch
    path: Array
    heading_rad: float
    headroom_m: float


class _Search:
    """What the search for grasps of one scene works on."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.model, self.carrier = scene, scene.model, carrier(scene)
        self.rng = np.random.default_rng(SEED)
        hand = hand_of(scene, self.carrier.start)
        if hand is None or self.carrier.lift is None:
            raise SceneError(
                f"scene {scene.name}: no hand that could lift the object",
                expected="fingertips on position servos, and position servos that carry the hand up",
                found="no fingertip on a servo" if hand is None else "nothing that carries the hand up",
                where=Where(path=scene.name),
                fix="choose a policy that needs no grasp",
            )
        self.hand: Hand = hand
        self.lift: Array = self.carrier.lift
        self.data = mujoco.MjData(self.model)
        self.limits = d.command_range(scene)
        at = scene.object_qpos
        self.object_pose = hand.qpos0[at : at + 7].copy()
        offset = scene.model.body_ipos[scene.object_id]
        self.mass_centre: Array = offset
        self.centre = self.object_pose[:3] + rotate(self.object_pose[3:], offset)
        hand.pose(self.carrier.start[hand.free])
        self.pivot = hand.data.xpos[scene.fingertip_bodies].mean(0)

    def candidates(self) -> list[Grasp]:
        """Return up to `TRIED` grasps that are clear of all else, the best first in each round of lines.

        Raises
        ------
        SceneError
            When there is none.
        """
        all_pinches = pinches(self.scene, self.hand)
        cloud = surface_cloud(self.scene).astype(np.float64)
        clear_grasps: list[Grasp] = []
        widths: list[float] = []
        fitting = 0
        for _ in range(ROUNDS if all_pinches else 0):
            found, round_widths = self._lines(all_pinches, cloud)
            widths += round_widths
            fitting += len(found)
            clear_grasps += self._clear(found[: 2 * TRIED])
            if len(clear_grasps) >= TRIED:
                break
        if clear_grasps:
            return clear_grasps[:TRIED]
        raise SceneError(
            "no grasp reaches the object",
            expected="two opposing points on it that the fingertips reach, clear of object and support",
            found=_why_none([pinch.gap_m for pinch in all_pinches], widths, fitting),
            where=Where(path=self.scene.name),
            fix="leave the object out, or put the hand where it reaches it",
        )

    def _lines(self, all_pinches: list[Pinch], cloud: Array) -> tuple[list[_Candidate], list[float]]:
        """Return the lines that fit fingertips, the best first, and the widths of all that could be pressed along."""
        rng, turns, zeros = self.rng, self._tilts(), np.zeros(LINES)
        gaps_m, tip_axes = (np.array([getattr(pinch, name) for pinch in all_pinches]) for name in ("gap_m", "axis"))
        axes = rotate(exp(turns), tip_axes[rng.integers(len(all_pinches), size=LINES)])
        headings = rng.uniform(0, 2 * np.pi, LINES)
        attitudes = multiply(exp(np.stack([zeros, zeros, headings], axis=1)), self.object_pose[3:])
        points = cloud[rng.integers(len(cloud), size=LINES)]
        lines = chords(self.scene, points, rotate(conjugate(attitudes), axes))
        middles = rotate(attitudes, (lines.first + lines.second) / 2 - self.mass_centre)
        off_m = np.linalg.norm(np.cross(middles, axes), axis=1)
        top_m = float(rotate(self.object_pose[3:], cloud - self.mass_centre)[:, 2].max())
        pressed = np.flatnonzero(lines.alignment > 1 / np.hypot(1, FRICTION))
        out = []
        for i in pressed:
            cosines = tip_axes @ rotate(exp(-turns[i]), axes[i])
            fits = np.flatnonzero((np.abs(gaps_m - lines.width_m[i]) < FIT_M) & (cosines > np.cos(FIT_RAD)))
            if not len(fits):
                continue
            pinch = all_pinches[int(rng.choice(fits))]
            between_tips = self.pivot + rotate(exp(turns[i]), pinch.ends.mean(0) - self.pivot)
            path = np.concatenate([self.centre + middles[i] - between_tips, turns[i]])
            score = float(lines.alignment[i] - off_m[i] / OFF_CENTRE_M)
            out.append(_Candidate(score, pinch, path, float(headings[i]), top_m - float(middles[i, 2])))
        return sorted(out, key=lambda candidate: -candidate.score), lines.width_m[pressed].tolist()

    def _tilts(self) -> Array:
        """Return rotation vectors `(LINES, 3)` [rad] of the hand: half of them zero, all where nothing can turn it."""
        axes = self.rng.standard_normal((LINES, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        tilts = np.maximum(self.rng.uniform(-MOST_TILT_RAD, MOST_TILT_RAD, (LINES, 1)), 0)
        return axes * tilts * self.carrier.reach[3:].all()

    def _clear(self, candidates: list[_Candidate]) -> list[Grasp]:
        """Return grasps of those candidates at which the hand is clear of support and object, and can get there."""
        low, high = d.useful_range(self.scene).T
        grasps_at = []
        for c in candidates:
            way, share = c.pinch.way, c.pinch.share + self.rng.uniform(*SQUEEZE)
            closed = np.where(way.travel != 0, np.clip(way.open + share * way.travel, low, high), way.open)
            grasps_at.append(Grasp(way.open, closed, c.path, c.heading_rad, self.lift))
        raised = []
        all_carried = self._carried([grasp.path[None] for grasp in grasps_at])
        for c, grasp, carried in zip(candidates, grasps_at, all_carried, strict=True):
            lack_m = np.inf if carried is None else CLEAR_M - self._height(grasp, carried[0])
            if lack_m < min(MOST_RAISE_M, c.headroom_m + LOWER_M):
                rise = max(0.0, float(lack_m)) * self.lift
                raised.append(replace(grasp, path=grasp.path + np.concatenate([rise, np.zeros(3)])))
        paths = [self._approaches(grasp) for grasp in raised]
        return [
            replace(grasp, approach=direction)
            for grasp, carried in zip(raised, self._carried(paths), strict=True)
            if carried is not None and (direction := self._way_out(grasp, carried)) is not None
        ]

    def _carried(self, paths: list[Array]) -> list[Array | None]:
        """Return the commands of each path; None where what carries the hand cannot go there."""
        if not paths:
            return []
        start = self.carrier.start
        try:
            ends = np.cumsum([len(path) for path in paths])[:-1]
            all_commands: list[Array | None] = [*np.split(self.carrier.commands(start, np.concatenate(paths)), ends)]
        except ReachError:
            all_commands = [self._reached(path) for path in paths]
        low, high = self.limits[:, 0] - 1e-9, self.limits[:, 1] + 1e-9
        return [c if c is not None and ((low <= c) & (c <= high)).all() else None for c in all_commands]

    def _reached(self, path: Array) -> Array | None:
        """Return the commands of a path; None where hinges cannot follow it."""
        try:
            return self.carrier.commands(self.carrier.start, path)
        except ReachError:
            return None

    def _directions(self) -> list[Array]:
        """Return the directions in which the open hand may leave."""
        away, up = self.carrier.away, self.lift
        if away is None or abs(away @ up) > 0.9:
            return [up]
        return [away, up, (away + up) / np.linalg.norm(away + up)]

    def _approaches(self, grasp: Grasp) -> Array:
        """Return the path `(2 + 3 D, 6)`: the lift, the grasp, and three places on the way out in each direction."""
        rows = [grasp.path + p.along(self.lift, np.array([LIFT_M]))[0], grasp.path]
        for direction in self._directions():
            outward = np.concatenate([APPROACH_M * direction, np.zeros(3)])
            rows += [grasp.path + share * outward for share in (0.2, 0.5, 1.0)]
        return np.array(rows)

    def _way_out(self, grasp: Grasp, carried: Array) -> Array | None:
        """Return a direction in which the open hand leaves the object without touching it; None where it touches."""
        if self._touches(grasp, carried[1]):
            return None
        for n, direction in enumerate(self._directions()):
            if not any(self._touches(grasp, row) for row in carried[2 + 3 * n : 5 + 3 * n]):
                return direction
        return None

    def _put(self, grasp: Grasp, carried: Array, fingers: Array) -> None:
        """Put the hand with given fingers, and the object turned, into `data`."""
        commands = fingers.copy()
        commands[self.carrier.columns] = carried[self.carrier.columns]
        clear.put(self.scene, self.data, commands, clear.turned(self.scene, self.object_pose, grasp.heading_rad))

    def _height(self, grasp: Grasp, carried: Array) -> float:
        """Return the least distance of the open and the closed hand from the support [m]."""
        heights = []
        for fingers in (grasp.open, grasp.closed):
            self._put(grasp, carried, fingers)
            heights.append(clear.height_m(self.scene, self.data))
        return min(heights)

    def _touches(self, grasp: Grasp, carried: Array) -> bool:
        """Tell whether the open hand overlaps the object."""
        self._put(grasp, carried, grasp.open)
        return clear.touches(self.scene, self.data)

    def trial(self, grasp: Grasp, off: Array, grip: float) -> Trial:
        """Return the trial of a grasp with the object off its place by `off (3,)` [m, m, rad of heading]."""
        pose = clear.turned(self.scene, self.object_pose, grasp.heading_rad + off[2])
        pose[:2] += off[:2]
        closed = grasp.open + grip * (grasp.closed - grasp.open)
        return Trial(grasp.open, closed, grasp.path, pose)


def _why_none(span_m: list[float], widths_m: list[float], fitting: int) -> str:
    """Return why no grasp reaches the object, in words."""
    if not span_m:
        return "no two fingertips that close on each other"
    reach = f"the fingertips open to {1000 * max(span_m):.0f} mm"
    if not widths_m:
        return f"no opposing points; {reach}"
    widths = f"opposing points {1000 * min(widths_m):.0f} to {1000 * max(widths_m):.0f} mm apart; {reach}"
    return f"{widths}; {fitting} places fit, none clear of object and support and within reach of what carries the hand"
