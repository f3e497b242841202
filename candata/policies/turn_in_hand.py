"""Turn the object about the vertical between the fingers: close, stroke, open, come back, again and again."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from candata.policies import _clear as clear
from candata.policies import _drive as d
from candata.policies import _grasps as g
from candata.policies import _postures as p
from candata.policies._carrier import carrier
from candata.policies._contract import Array, Goal, Plan, Policy
from candata.policies._trials import object_motion
from candata.rotation import difference
from candata.scenes import Scene

#: Angle that the object is meant to turn by [rad].
TURN_RAD = np.deg2rad(45.0)
#: Length of a stroke and the way back in trials [s], the least in a plan, and what comes before and after [s].
CYCLE_S, AROUND_S = 1.0, 1.6
#: Shares of a cycle at which the fingers close, stroke, open and come back, and how long each takes.
CLOSES, STROKES, OPENS, BACK = (0.0, 0.25), (0.25, 0.29), (0.54, 0.21), (0.75, 0.25)
#: Largest random stroke: share of each joint's range, and of the hand along each level direction [m]. Chosen.
SWING_SHARE, SWING_M = 0.3, 0.02
#: Grip of a stroke: loose, so that the object turns between the fingers.
GRIP = (0.8, 1.05)
#: By how much the strokes of episodes differ in length and grip. Chosen.
SIZES, FIRMER = (0.92, 1.08), (0.97, 1.03)
#: Strokes drawn and tried once; the best of them, and random neighbours of each, are tried; how far those are off, as a
#: share of the largest stroke; how often in a row each generation of them is tried. Chosen for 5 s of CPU time.
DRAWN, BEST, NEIGHBOURS, NEAR_SHARE, GENERATIONS = 48, 6, 3, 0.2, (1, 3)
#: The best are tried so many times more, so often in a row, with the object off its place; those are kept whose
#: worst turn is this share of the best.
TIMES, LASTING, GOOD_SHARE = 4, 6, 0.95
#: A tilt takes so many times as much from the worth of a turn; the object may move so far in each stroke [m], and loses
#: so much a metre beyond [rad/m].
TILT_WEIGHT, MOVE_M, MOVE_WEIGHT = 3.0, 0.005, 10.0


class Stroke(NamedTuple):
    """A stroke of closed fingers: the grasp, what is added to its commands `(A,)` and its path `(6,)`, and the grip."""

    grasp: g.Grasp
    fingers: Array
    path: Array
    grip: float


def _plan(scene: Scene, rng: np.random.Generator, duration_s: float) -> Plan:
    """Return the plan; which stroke, its size and the grip are random."""
    t, strokes = p.times(scene, duration_s), _strokes(g.SameScene(scene.digest, scene))
    stroke = _varied(strokes[int(rng.integers(len(strokes)))], rng)
    around_s = AROUND_S * min(1.0, duration_s / (AROUND_S + CYCLE_S))
    cycles = int(np.clip((duration_s - around_s) / CYCLE_S, 1, LASTING))
    cycle_s = (duration_s - around_s) / cycles
    closing, swing = _profiles(t - around_s / 2, cycles, cycle_s)
    way_in = p.blend(t, 0.1 * around_s, 0.4 * around_s) - p.blend(t, duration_s - 0.4 * around_s, 0.4 * around_s)
    path = stroke.grasp.way_in(way_in) + swing[:, None] * stroke.path
    commands = stroke.grasp.commands(stroke.grip * closing) + swing[:, None] * stroke.fingers
    plan = p.finish(scene, commands, rng, path=path)
    return g.with_heading(scene, plan, stroke.grasp.heading_rad, Goal(turn_rad=TURN_RAD))


def _profiles(time_s: Array, cycles: int, cycle_s: float) -> tuple[Array, Array]:
    """Return how far the fingers are closed `(T,)`, and how far along the stroke `(T,)`, in cycles from time 0 on."""
    closing, swing = np.zeros(len(time_s)), np.zeros(len(time_s))
    for k in range(cycles):
        shares = time_s / cycle_s - k
        closing += p.blend(shares, *CLOSES) - p.blend(shares, *OPENS)
        swing += p.blend(shares, *STROKES) - p.blend(shares, *BACK)
    return closing, swing


@lru_cache(maxsize=128)
def _strokes(key: g.SameScene) -> list[Stroke]:
    """Return the strokes that turn the object most in trials."""
    scene, rng = key.scene, np.random.default_rng(0)
    drawn = [_drawn(scene, rng) for _ in range(DRAWN)]
    best = [drawn[i] for i in np.argsort(-np.abs(_worth(scene, drawn, 1)))[:BEST]]
    for cycles in GENERATIONS:
        near = best + [_neighbour(scene, stroke, rng) for stroke in best for _ in range(NEIGHBOURS)]
        best = [near[i] for i in np.argsort(-np.abs(_worth(scene, near, cycles)))[:BEST]]
    again = [_varied(stroke, rng) for stroke in best for _ in range(TIMES)]
    off = rng.standard_normal((len(again), 3)) * (g.OFF_SD_M, g.OFF_SD_M, g.OFF_SD_RAD)
    worth = np.abs(_worth(scene, again, LASTING, off)).reshape(-1, TIMES).min(1)
    return [best[i] for i in np.argsort(-worth) if worth[i] >= GOOD_SHARE * worth.max()]


def _varied(stroke: Stroke, rng: np.random.Generator) -> Stroke:
    """Return the stroke, a little longer or shorter and firmer or looser."""
    size, grip = rng.uniform(*SIZES), stroke.grip * rng.uniform(*FIRMER)
    return stroke._replace(fingers=size * stroke.fingers, path=size * stroke.path, grip=grip)


def _drawn(scene: Scene, rng: np.random.Generator) -> Stroke:
    """Return a random stroke."""
    hand, spans = carrier(scene), _finger_spans(scene)
    fingers = SWING_SHARE * rng.uniform(-1, 1, len(spans)) * spans
    path = np.concatenate([SWING_M * rng.uniform(-1, 1, len(hand.level)) @ hand.level, np.zeros(3)])
    return Stroke(g.chosen_grasp(scene, rng), fingers, path, float(rng.uniform(*GRIP)))


def _neighbour(scene: Scene, stroke: Stroke, rng: np.random.Generator) -> Stroke:
    """Return a stroke near another, a little shorter or up to half as long again."""
    off, factor = _drawn(scene, rng), rng.uniform(0.8, 1.5)
    fingers = factor * stroke.fingers + NEAR_SHARE * off.fingers
    return Stroke(stroke.grasp, fingers, factor * stroke.path + NEAR_SHARE * off.path, stroke.grip)


def _finger_spans(scene: Scene) -> Array:
    """Return `(A,)` the range of each servo of a finger; 0 for the others."""
    low, high = d.useful_range(scene).T
    is_finger = d.servos(scene) & ~np.isin(np.arange(len(low)), list(d.carriers(scene)))
    return np.where(is_finger, high - low, 0.0)


def _worth(scene: Scene, strokes: list[Stroke], cycles: int, off: Array | None = None) -> Array:
    """Return `(n,)` by how much each stroke turns the object about the vertical [rad], less what tilts and moves it.

    The object may be off its place by `off (n, 3)` [m, m, rad of heading].
    """
    hand, t = carrier(scene), p.times(scene, cycles * CYCLE_S)
    closing, swing = _profiles(t, cycles, CYCLE_S)
    path = np.concatenate([stroke.grasp.path + swing[:, None] * stroke.path for stroke in strokes])
    carried = (hand.commands(hand.start, path) - hand.start).reshape(len(strokes), len(t), -1)
    fingers = [s.grasp.commands(s.grip * closing) + swing[:, None] * s.fingers for s in strokes]
    commands = np.clip(np.array(fingers) + carried, *d.command_range(scene).T)
    off = np.zeros((len(strokes), 3)) if off is None else off
    headings = [s.grasp.heading_rad + each for s, each in zip(strokes, off[:, 2], strict=True)]
    poses = np.array([clear.turned(scene, g.object_pose(scene), heading) for heading in headings])
    poses[:, :2] += off[:, :2]
    places, attitudes = object_motion(scene, commands, poses)
    turn = difference(attitudes[:, -1], attitudes[:, 0])
    moved_m = np.linalg.norm(places[:, -1] - places[:, 0], axis=1)
    loss = TILT_WEIGHT * np.linalg.norm(turn[:, :2], axis=1) + MOVE_WEIGHT * np.maximum(moved_m - cycles * MOVE_M, 0)
    return np.sign(turn[:, 2]) * np.maximum(np.abs(turn[:, 2]) - loss, 0)


POLICY = Policy("turn the object between the fingers by 45 degrees", g.can_carry, _plan, on_request=True)
